"""The layout of docs/formats.md."""

import unicodedata
from pathlib import Path

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.film import Film, ImageFiles
from piegraph_cli.recording.folders import entries_of
from piegraph_cli.recording.layout import frame_files, read_cameras, read_times
from piegraph_cli.recording.numbers import frame_numbers, match_stamps
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.timing import check_times


def read(folder: Path, params: ReadParams) -> tuple[list[Film], list[str]]:
    """The films of a sequence folder, one a camera, and warnings."""
    cameras = read_cameras(folder)
    others = sorted(p.name for p in entries_of(folder) if (p / "color").is_dir() or (p / "depth").is_dir())
    unknown = next((name for name in others if name not in {camera.name for camera in cameras}), None)
    if unknown:
        hint = "calibrate it, or leave it out: move its folder away, or begin its name with a dot"
        alike = next((camera.name for camera in cameras if _plain(camera.name) == _plain(unknown)), None)
        if alike:
            hint = f"rename the folder: cameras.json has {alike!a}, the folder is called {unknown!a}"
        raise DataError(f"camera {unknown} has a folder but is not in cameras.json", str(folder), hint)
    read = [read_film(folder, camera) for camera in cameras]
    return [film for film, _ in read], [gap for _, gaps in read for gap in gaps]


def _plain(name: str) -> str:
    """A name without regard to case, and to how its accents are encoded: macOS takes them apart."""
    return unicodedata.normalize("NFC", name).casefold()


def read_film(folder: Path, camera: Camera) -> tuple[Film, list[str]]:
    """One camera's images of a sequence folder with their checked time stamps, and warnings of gaps."""
    where = str(folder / camera.name)
    stamps, files = read_times(folder, camera), frame_files(folder, camera)
    if not files and not len(stamps):
        raise DataError(f"camera {camera.name} has no frames", str(folder), "see docs/formats.md for the layout")
    color = [path for path, _ in files]
    lines, gaps = match_stamps(color, len(stamps), where)
    gaps += check_times(stamps, str(folder / camera.name / "timestamps.txt"))
    return Film(camera, stamps[lines], ImageFiles(camera, files), frame_numbers(color)), gaps
