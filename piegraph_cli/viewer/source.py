"""What the viewer shows: runs that are open, and one sequence of one, read by parts when it is looked at."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError, PiegraphError, command_line
from piegraph_cli.recording.camera import Camera
from piegraph_cli.stages import open_run, sequences
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.slices import Slices, Stamp, stamp_of

TIMED = ("frames", "tracks", "clouds", "hands", "masks")
"""Artifacts of a sequence with a row per frame; the first that there is gives the time line."""

OF_SEQUENCE = (*TIMED, "scores")

OF_RUN = ("dataset.h5", "model", "plan.h5")
"""Files of the run that panels show; a folder changes with what is put into it."""


@dataclass
class OpenRun:
    """A run folder: the run, the names of its sequences, and what is wrong with it, if anything."""

    folder: Path
    run: Run
    names: list[str]
    trouble: str = ""
    remedy: str = ""

    @classmethod
    def of(cls, folder: Path) -> "OpenRun":
        """Open a folder. One whose recording cannot be read has the sequences that it has artifacts of."""
        run = open_run(folder)
        try:
            return cls(folder, run, sequences(run))
        except PiegraphError as error:
            found = {path.stem for name in OF_SEQUENCE for path in (folder / name).glob("[!.]*.h5")}
            return cls(folder, run, sorted(found), error.message, error.hint)

    def command(self, artifact: str) -> str:
        """The command that makes an artifact; empty where this run makes none."""
        producer = self.run.producer(artifact)
        if self.trouble:
            return self.remedy
        return command_line("run", "--run", self.folder, "--until", producer.name) if producer else ""

    def absent(self, artifact: str) -> str:
        """What to say of an artifact that is not there, in Markdown."""
        command = self.command(artifact)
        return f"no {artifact} yet: `{command}`" if command else f"this run makes no {artifact}"


class Sequence:
    """One sequence of a run. What cannot be read is left out, and `missing` says why and what to do."""

    def __init__(self, opened: OpenRun, name: str):
        self.opened, self.name = opened, name
        self._open: dict[str, Slices] = {}
        self._missing: dict[str, str] = {}
        self._stamps = self._stamps_now()
        for artifact in OF_SEQUENCE:
            self._try(artifact)

    def _try(self, artifact: str) -> None:
        path = self.opened.run.path(artifact, self.name)
        if not path.exists():
            self._missing[artifact] = self.opened.absent(artifact)
            return
        try:
            found = Slices(path, artifact)
        except DataError as error:
            self._missing[artifact] = f"{artifact} cannot be shown: {error}"
            return
        clock = self._clock
        if artifact in TIMED and clock and len(found) != len(clock):
            found.close()
            why = f"it has {len(found)} frames, and {clock.name} has {len(clock)}"
            self._missing[artifact] = f"{artifact} is stale: {why}; `{self.opened.command(artifact)}`"
            return
        self._open[artifact] = found

    @property
    def _clock(self) -> Slices | None:
        return next((self._open[name] for name in TIMED if name in self._open), None)

    def get(self, artifact: str) -> Slices | None:
        """An artifact of this sequence, or None where there is none that can be read."""
        return self._open.get(artifact)

    def missing(self, *artifacts: str) -> str:
        """Why one of the artifacts is not there and the command that makes it; empty where all are there."""
        return next((self._missing[name] for name in artifacts if name in self._missing), "")

    def __len__(self) -> int:
        """Frames."""
        return len(self._clock) if self._clock else 0

    @cached_property
    def time(self) -> np.ndarray:
        """Seconds [F] since the first frame."""
        time = self._clock["time"] if self._clock else np.zeros(0)
        return time - time[:1]

    @cached_property
    def cameras(self) -> list[Camera]:
        """The cameras; none where there are no frames."""
        frames = self.get("frames")
        return list(_cameras(frames)) if frames else []

    def encoded(self, kind: str, frame: int, camera: int) -> np.ndarray | None:
        """The bytes of one image: `color` or `depth` of frames, or the `mask`; None where there is none."""
        held = self.get("masks" if kind == "mask" else "frames")
        if held is None:
            return None
        image = frame * len(self.cameras) + camera
        first, end = self._offsets(kind, held)[image : image + 2]
        return held.rows(kind, int(first), int(end)) if end > first else None

    def _offsets(self, kind: str, held: Slices) -> np.ndarray:
        if kind not in self._offsets_read:
            self._offsets_read[kind] = held[f"{kind}_offsets"]
        return self._offsets_read[kind]

    @cached_property
    def _offsets_read(self) -> dict[str, np.ndarray]:
        return {}

    def changed(self) -> bool:
        """Whether an artifact of the sequence or of the run came, went, or was made anew since this was opened."""
        return self._stamps != self._stamps_now()

    def _stamps_now(self) -> list[Stamp | None]:
        own = [self.opened.run.path(name, self.name) for name in OF_SEQUENCE]
        return [stamp_of(path) for path in (*own, *(self.opened.folder / name for name in OF_RUN))]

    def close(self) -> None:
        """Close its files."""
        for held in self._open.values():
            held.close()


def _cameras(frames: Slices) -> Iterator[Camera]:
    columns = (frames.texts("camera_name"), frames["image_size"], frames["K"], frames["distortion"])
    for name, size, K, distortion, T in zip(*columns, frames["T_world_camera"], strict=True):
        yield Camera(name, int(size[0]), int(size[1]), K, distortion, T)
