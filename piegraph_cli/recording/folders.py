"""The sequence folders of a recording. Nothing heavy is imported: whoever lists a run's sequences asks here first."""

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
    folders = (p for p in recording.iterdir() if p.is_dir() and not p.name.startswith("."))
    sequences = sorted(p for p in folders if any((c / "color").is_dir() for c in p.iterdir() if c.is_dir()))
    if not sequences:
        raise DataError(
            "no sequence found",
            str(recording),
            "expected SEQUENCE/CAMERA/color/000000.jpg below it; see docs/formats.md",
        )
    return sequences
