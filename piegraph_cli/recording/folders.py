"""The sequence folders of a recording. Nothing heavy is imported: whoever lists a run's sequences asks here first."""

import json
import os
import re
import stat
import unicodedata
from collections.abc import Callable
from pathlib import Path

from piegraph_cli.errors import DataError

STILL = re.compile(r"(?P<name>[^.].*?)[._-](?P<kind>(color|colour|rgb|depth)(?=\.(png|jpg|jpeg))|pose(?=\.txt))\.\w+")
"""What images and poses in a folder of single frames are called."""
BAGS = (".bag", ".db3", ".mcap")
"""Endings of ROS bags; a bag can be a sequence without a folder of its own."""
COMPRESSED_BAGS = (*BAGS, ".zstd")
"""With those of a file that ROS 2 compressed as a whole."""
PACKED = (".zip", ".7z", ".rar", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".zst")
"""Endings of archives."""
SYSTEM = ("@eaDir", "__MACOSX", "lost+found", "$RECYCLE.BIN", "System Volume Information")
"""Folders that network disks, archives and file systems put among others."""
LONGEST_NAME = 200
"""Bytes of a sequence's name."""
PACKAGE = Path(__file__).resolve().parents[1]


def list_sequences(recording: Path, layout: str = "auto") -> list[Path]:
    """The sequences of a recording, folders or bags, sorted by name, in a layout of `SIGNS`; by default the first that fits."""
    if not recording.is_dir() and recording.is_relative_to(PACKAGE):
        raise DataError(
            "the sample recording is not part of the installed package",
            str(recording),
            "get sample_data of the repository, then add --set ingest.recording=sample_data/tblock",
        )
    if recording.is_file():
        packed = recording.suffix.lower() in PACKED
        hint = (
            "unpack it, and give the folder that holds cameras.json"
            if packed
            else "give the folder that holds cameras.json"
        )
        raise DataError("is packed" if packed else "is a file, no recording folder", str(recording), hint)
    if not recording.is_dir():
        raise DataError("no such recording folder", str(recording), "give the folder that holds cameras.json")
    inside = [] if is_ros2_folder(recording) else entries_of(recording)
    folders = sorted(path for path in inside if path.is_dir() or path.suffix in BAGS)
    for name in _wanted(layout):
        sequences = [path for path in folders if fits(name, path)]
        if sequences:
            return _named(sequences)
    others = next((name for name in SIGNS if any(fits(name, path) for path in folders)), None)
    if others:
        message = f"no sequence found in the layout {layout}, but in the layout {others}"
        raise DataError(message, str(recording), "leave --layout out, and ingest.layout in the recipe")
    if any(fits(name, recording) for name in _wanted(layout)):
        hint = f"give the folder above it: {recording.resolve().parent}"
        raise DataError("this is one sequence, not a recording of sequences", str(recording), hint)
    holding = [folder for folder in folders if sequences_in(folder, layout)]
    if holding:
        message = f"no sequence found, but {len(holding)} recordings: {', '.join(f.name for f in holding[:3])}"
        raise DataError(message, str(recording), f"--recording once for each, as in --recording {holding[0]}")
    raise DataError(
        "no sequence found" + (f" in the layout {layout}" if layout != "auto" else ""),
        str(recording),
        "expected SEQUENCE/CAMERA/color/000000.jpg below it, or a layout of `piegraph list layouts`",
    )


def _named(sequences: list[Path]) -> list[Path]:
    """The sequences. Raises `DataError` where the name of one is no text, or too long: files are called after it."""
    for path in sequences:
        try:
            path.name.encode()
        except UnicodeEncodeError:
            shown = os.fsencode(path).decode("utf-8", "backslashreplace")
            raise DataError("its name is no UTF-8 text", shown, "rename the folder") from None
        if any(unicodedata.category(letter) == "Cc" for letter in path.name):
            raise DataError(
                "its name has a line break or another control character", repr(str(path)), "rename the folder"
            )
        if len(path.name.encode()) > LONGEST_NAME:
            raise DataError(
                "the name is too long for a sequence", str(path), f"rename it: at most {LONGEST_NAME} bytes"
            )
    return sequences


def sequences_in(folder: Path, layout: str = "auto") -> list[str]:
    """The names of the sequences that a folder holds; none where it is itself a sequence, or something else."""
    if any(fits(name, folder) for name in _wanted(layout)):
        return []
    folders = sorted(path for path in entries_of(folder) if path.is_dir())
    return [path.name for path in folders if any(fits(name, path) for name in _wanted(layout))]


def layout_of(sequence: Path, layout: str = "auto") -> str:
    """The layout of a sequence folder: the one given, or the first of `SIGNS` that fits."""
    return next((name for name in _wanted(layout) if fits(name, sequence)), _wanted(layout)[0])


def fits(layout: str, folder: Path) -> bool:
    """Whether a folder looks like a sequence in that layout."""
    try:
        return SIGNS[layout](folder)
    except OSError as error:
        raise unreadable(error, folder) from None


def _wanted(layout: str) -> list[str]:
    return list(SIGNS) if layout == "auto" else [layout]


def entries_of(folder: Path) -> list[Path]:
    """What is in a folder, nothing in a file; names that begin with a dot are nobody's, and such as `SYSTEM`: desktops, file
    systems and network disks leave them.

    Raises `DataError` where it cannot be read.
    """
    try:
        inside = folder.iterdir() if folder.is_dir() else ()
        return [path for path in inside if not path.name.startswith(".") and path.name not in SYSTEM]
    except OSError as error:
        raise unreadable(error, folder) from None


def check_files(folder: Path) -> None:
    """Refuse what would keep a reader waiting, or reading without end: pipes, devices and sockets, or links to them."""
    for place, _, names in os.walk(folder):
        for path in (Path(place, name) for name in names if not name.startswith(".")):
            try:
                mode = path.stat().st_mode
            except OSError:
                continue  # a link to nothing: whoever needs it says so
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                raise DataError("is no regular file but a pipe, a device or a socket", str(path), "remove it")


def unreadable(error: OSError, place: Path) -> DataError:
    """What to tell of a file or folder that the system keeps back."""
    hint = "give yourself the right to read it, or move it out of the recording"
    return DataError(f"cannot be read: {error.strerror or error}", str(error.filename or place), hint)


def calibration_sequences(sequences: list[Path]) -> set[str]:
    """Names of those of a recording's sequences that show the board, by every cameras.json that can be read."""
    found = set()
    for path in (sequences[0].parent / "cameras.json", *(s / "cameras.json" for s in sequences)):
        try:
            with path.open("rb") as file:
                noted = json.load(file)["calibration_sequence"]
            found |= set(noted if isinstance(noted, list) else [noted])
        except (OSError, ValueError, LookupError, TypeError, RecursionError):
            continue  # reading the sequence says what is wrong
    return {path.name for path in sequences} & {name for name in found if isinstance(name, str)}


def _is_ours(folder: Path) -> bool:
    return any((camera / "color").is_dir() for camera in entries_of(folder))


def _is_tum(folder: Path) -> bool:
    return all((folder / name).is_file() for name in ("rgb.txt", "depth.txt"))


def _is_gbnd(folder: Path) -> bool:
    return any((camera / "camera_params.npy").is_file() for camera in entries_of(folder))


def _is_phystwin(folder: Path) -> bool:
    return all((folder / name).is_file() for name in ("metadata.json", "calibrate.pkl"))


def _is_pgnd(folder: Path) -> bool:
    times = (folder / "timestamps.txt").is_file()
    return times and any((camera / "rgb").is_dir() for camera in entries_of(folder))


def _is_stills(folder: Path) -> bool:
    names = [path.name for path in entries_of(folder)]
    kinds = {told["kind"] for told in map(STILL.fullmatch, names) if told}
    return "depth" in kinds and bool(kinds & {"color", "colour", "rgb"})


def is_ros2_folder(folder: Path) -> bool:
    """Whether a folder is one bag, as ROS 2 writes them."""
    return (folder / "metadata.yaml").is_file() and any(path.suffix in COMPRESSED_BAGS for path in entries_of(folder))


def _is_ros(path: Path) -> bool:
    if path.is_file():
        return path.suffix in BAGS
    return any(entry.suffix in COMPRESSED_BAGS or is_ros2_folder(entry) for entry in entries_of(path))


SIGNS: dict[str, Callable[[Path], bool]] = {
    "piegraph": _is_ours,
    "tum": _is_tum,
    "gbnd": _is_gbnd,
    "phystwin": _is_phystwin,
    "pgnd": _is_pgnd,
    "stills": _is_stills,
    "ros": _is_ros,
}
"""How the folder of a sequence is told, by layout."""
