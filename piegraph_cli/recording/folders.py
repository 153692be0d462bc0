"""The sequence folders of a recording. Nothing heavy is imported: whoever lists a run's sequences asks here first."""

import json
from pathlib import Path

from piegraph_cli.errors import DataError

PACKAGE = Path(__file__).resolve().parents[1]


def list_sequences(recording: Path) -> list[Path]:
    """The sequence folders of a recording, sorted by name: folders that hold at least one camera folder."""
    if not recording.is_dir() and recording.is_relative_to(PACKAGE):
        raise DataError(
            "the sample recording is not part of the installed package",
            str(recording),
            "get sample_data of the repository, then add --set ingest.recording=sample_data/tblock",
        )
    if not recording.is_dir():
        raise DataError("no such recording folder", str(recording), "give the folder that holds cameras.json")
    folders = [path for path in entries_of(recording) if path.is_dir()]
    sequences = sorted(p for p in folders if any((c / "color").is_dir() for c in entries_of(p)))
    if not sequences:
        raise DataError(
            "no sequence found",
            str(recording),
            "expected SEQUENCE/CAMERA/color/000000.jpg below it; see docs/formats.md",
        )
    return sequences


def entries_of(folder: Path) -> list[Path]:
    """What is in a folder; names that begin with a dot are nobody's: desktops and network disks leave them."""
    return [path for path in folder.iterdir() if not path.name.startswith(".")]


def calibration_sequences(sequences: list[Path]) -> set[str]:
    """Names of those of a recording's sequences that show the board, by every cameras.json that can be read."""
    found = set()
    for path in (sequences[0].parent / "cameras.json", *(s / "cameras.json" for s in sequences)):
        try:
            found.add(json.loads(path.read_text())["calibration_sequence"])
        except (OSError, ValueError, LookupError, TypeError, RecursionError):
            continue  # reading the sequence says what is wrong
    return {path.name for path in sequences} & {name for name in found if isinstance(name, str)}
