"""The seal of an artifact: a checksum of all its bytes, in a block of text in front of them that HDF5 leaves alone.

It tells damage, of any kind, from what was written; against somebody who makes both bytes and checksum it helps nothing. It is
the BLAKE2b of the CRC-32s of the pieces: of cryptographic hashes alone reading would be a third slower.
"""

import hashlib
import os
import stat
import zlib
from collections.abc import Iterable, Iterator
from io import BufferedReader
from pathlib import Path

from piegraph_cli.errors import DataError

BLOCK = 512
"""Bytes of the seal, the smallest block that HDF5 lets others have in front of its own ("user block")."""
_HDF5 = b"\x89HDF\r\n\x1a\n"
_PIECE = 1 << 16
AGAIN = "make it again, or copy it again from where it was made"


def sealed(image: bytes) -> tuple[bytes, bytes]:
    """The seal of an HDF5 image and the image: written one after the other they are an artifact."""
    view = memoryview(image)
    return _seal(view[start : start + _PIECE] for start in range(0, len(view), _PIECE)), image


def _seal(pieces: Iterable[memoryview]) -> bytes:
    digest, size = hashlib.blake2b(digest_size=16), 0
    for piece in pieces:
        digest.update(zlib.crc32(piece).to_bytes(4, "little"))
        size += len(piece)
    digest.update(size.to_bytes(8, "little"))
    return f"piegraph artifact\nblake2b of crc32 {digest.hexdigest()}\n".encode().ljust(BLOCK, b"\n")


def check_seal(path: Path, verified: bool = False) -> bool:
    """Whether a file is sealed; one that is not is as old artifacts are, or no artifact.

    Raises `DataError` for what is no regular file or no HDF5, and where bytes and seal differ; of a file that was `verified`
    the bytes are not read again.
    """
    try:
        place = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe would keep us waiting
        with open(place, "rb") as file:
            head = file.read(BLOCK) if stat.S_ISREG(os.fstat(place).st_mode) else b""
            if head.startswith(_HDF5):
                return False
            if file.read(len(_HDF5)) != _HDF5:
                raise DataError("not a readable HDF5 file: it has no HDF5 signature", str(path), AGAIN)
            if not verified and head != _seal(_pieces(file)):
                raise DataError("its bytes are not those that were written: the checksum differs", str(path), AGAIN)
            return True
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror or error}", str(path), "give yourself the right") from None


def _pieces(file: BufferedReader) -> Iterator[memoryview]:
    """Everything from the end of the block on, in one buffer, piece by piece."""
    buffer = memoryview(bytearray(_PIECE * min(16, 1 + os.fstat(file.fileno()).st_size // _PIECE)))
    file.seek(BLOCK)
    while count := file.readinto(buffer):
        yield from (buffer[start : min(start + _PIECE, count)] for start in range(0, count, _PIECE))
