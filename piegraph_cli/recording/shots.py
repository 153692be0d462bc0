"""Images of a board, read: which images of all cameras belong together, from one sequence or several."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording import layout
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.folders import list_sequences
from piegraph_cli.recording.images import decode_color
from piegraph_cli.recording.numbers import match_stamps, pair_files
from piegraph_cli.recording.registration import register_depth
from piegraph_cli.recording.timing import check_times, pair_frames

FRAMES = 24
"""Instants that are looked at, spread over each sequence."""
SKEW = 0.05
"""Seconds that the images of an instant may be apart."""


@dataclass(frozen=True)
class Shots:
    """Images of all cameras at some instants, of the chosen sequences."""

    cameras: list[Camera]
    sequences: list[Path]
    sequence: np.ndarray
    """[instant] number of the sequence."""
    files: list[list[Path]]
    """[camera][instant]."""
    notes: list[str]

    def image(self, camera: int, instant: int) -> np.ndarray:
        """RGB uint8 [H, W, 3]."""
        return decode_color(
            np.frombuffer(layout.read_color(self.files[camera][instant], self.cameras[camera]), np.uint8)
        )

    def images(self, camera: int) -> list[np.ndarray]:
        """All of one camera."""
        return [self.image(camera, k) for k in range(len(self.sequence))]

    def only(self, instants: Sequence[int]) -> "Shots":
        """These instants alone."""
        files = [[of[k] for k in instants] for of in self.files]
        return replace(self, sequence=self.sequence[list(instants)], files=files)

    def name(self, camera: int, instant: int) -> str:
        """What an image is called: by its file, and by its sequence where there are several."""
        stem = self.files[camera][instant].stem
        return f"{self.sequences[self.sequence[instant]].name}/{stem}" if len(self.sequences) > 1 else stem

    def depth(self, camera: int, instant: int) -> np.ndarray | None:
        """Depth uint16 [H, W] on colour's pixels; None where there is none, or it cannot be read: then it says nothing."""
        folder, of = self.sequences[self.sequence[instant]], self.cameras[camera]
        try:
            color, files = (layout.image_files(folder, of, kind) for kind in ("color", "depth"))
            depth = layout.read_depth(pair_files(color, files)[self.files[camera][instant]], of)
            return register_depth(depth, of) if of.depth_view else depth
        except (DataError, LookupError):
            return None


def read_shots(recording: Path, names: Sequence[str], most: int = FRAMES, posed: bool = False) -> Shots:
    """The images to look at, of sequences by name (the first where none is named), all with one cameras.json.

    Images belong together by time stamps where every camera has them, else by number.
    """
    folders = {folder.name: folder for folder in list_sequences(recording, "piegraph")}
    unknown = [name for name in names if name not in folders]
    if unknown:
        raise DataError(f"no sequence {unknown[0]}", str(recording), f"one of {', '.join(folders)}")
    chosen = [folders[name] for name in dict.fromkeys(names)] or [next(iter(folders.values()))]
    places = {layout.cameras_file(folder) for folder in chosen}
    if len(places) > 1:
        raise DataError(
            f"{' and '.join(f.name for f in chosen)} have cameras of their own: {', '.join(sorted(map(str, places)))}",
            str(recording),
            "calibrate them one by one",
        )
    cameras = layout.read_cameras(chosen[0], posed=posed)
    files: list[list[Path]] = [[] for _ in cameras]
    sequence, notes = [], []
    for s, folder in enumerate(chosen):
        rows, said = _instants(folder, cameras)
        rows = [rows[k] for k in np.unique(np.linspace(0, len(rows) - 1, min(most, len(rows))).round().astype(int))]
        for c in range(len(cameras)):
            files[c] += [row[c] for row in rows]
        sequence += [s] * len(rows)
        notes += said
    return Shots(cameras, chosen, np.array(sequence), files, notes)


def _instants(folder: Path, cameras: Sequence[Camera]) -> tuple[list[tuple[Path, ...]], list[str]]:
    """Files of all cameras [instant][camera], and notes."""
    files = [layout.image_files(folder, camera, "color") for camera in cameras]
    for camera, of in zip(cameras, files, strict=True):
        if not of:
            raise DataError(f"camera {camera.name} has no images", str(folder), "see docs/formats.md for the layout")
    notes: list[str] = []
    if len(cameras) > 1 and all((folder / camera.name / "timestamps.txt").is_file() for camera in cameras):
        try:
            times, ordered = {}, [list(of.values()) for of in files]
            for camera, images in zip(cameras, ordered, strict=True):
                stamps = layout.read_times(folder, camera)
                where = str(folder / camera.name)
                check_times(stamps, where)
                times[camera.name] = stamps[match_stamps(images, len(stamps), where)[0]]
            groups, _ = pair_frames(times, SKEW, str(folder))
            return [tuple(images[k] for images, k in zip(ordered, row, strict=True)) for row in groups], []
        except DataError as error:
            notes.append(f"images go together by number, not by time: {error.where}: {error.message}")
    shared = [number for number in files[0] if all(number in of for of in files)]
    if shared:
        return [tuple(of[number] for of in files) for number in shared], notes
    notes += [f"{folder.name}: no number is shared by all cameras' images: they go together in order"]
    return list(zip(*(of.values() for of in files), strict=False)), notes
