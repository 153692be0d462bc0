"""The seal of an artifact: a checksum of all its bytes, in a block of text in front of them that HDF5 leaves alone."""

import hashlib
import os
from pathlib import Path

from piegraph_cli.errors import DataError

BLOCK = 512
"""Bytes of the seal, the smallest block that HDF5 lets others have in front of its own ("user block")."""
_HDF5 = b"\x89HDF\r\n\x1a\n"
_READ = 1 << 20
AGAIN = "make it again, or copy it again from where it was made"


def seal_of(digest: str) -> bytes:
    """The block in front of an artifact whose bytes behind it have that BLAKE2b digest."""
    return f"piegraph artifact\nblake2b-256 {digest}\n".encode().ljust(BLOCK, b"\n")


def sealed(image: bytes) -> tuple[bytes, bytes]:
    """The seal of an HDF5 image and the image: written one after the other they are an artifact."""
    return seal_of(hashlib.blake2b(image, digest_size=32).hexdigest()), image


def check_seal(path: Path, verified: bool = False) -> bool:
    """Whether a file is sealed; one that is not is as old artifacts are, or no artifact.

    Raises `DataError` for what is no regular file or no HDF5, and where bytes and seal differ; of a file that was `verified`
    the bytes are not read again.
    """
    try:
        with open(
            os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb", buffering=0
        ) as file:  # a pipe would keep us waiting
            head = file.read(BLOCK) if path.is_file() else b""
            if head.startswith(_HDF5):
                return False
            if file.read(len(_HDF5)) != _HDF5:
                raise DataError("not a readable HDF5 file: it has no HDF5 signature", str(path), AGAIN)
            if not verified and head != seal_of(_digest(file)):
                raise DataError("its bytes are not those that were written: the checksum differs", str(path), AGAIN)
            return True
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror or error}", str(path), "give yourself the right") from None


def _digest(file) -> str:
    """Of everything from the end of the block on, with one buffer for all of it."""
    digest, buffer = hashlib.blake2b(digest_size=32), memoryview(bytearray(_READ))
    file.seek(BLOCK)
    while count := file.readinto(buffer):
        digest.update(buffer[:count])
    return digest.hexdigest()
