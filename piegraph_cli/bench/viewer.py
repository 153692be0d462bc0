"""Benchmark of the viewer: opening a long sequence, and drawing its frames, on the recording of a run repeated."""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from piegraph_cli.bench.measure import Row
from piegraph_cli.errors import UsageError
from piegraph_cli.stages import open_run, sequences
from piegraph_cli.workspace.artifact import Artifact, read_artifact, write_artifact
from piegraph_cli.workspace.schema import field_of

FRAMES = 6000
DRAWN = 100
"""Frames that are drawn of each kind."""

SHOWN = ("frames", "hands", "masks", "clouds", "tracks")
ROWS = ("frame", "point", "color_byte", "mask_byte")
"""Axes along which a sequence gets longer."""


def viewer_rows(folder: Path | None, frames: int = FRAMES) -> Iterator[Row]:
    """Processor seconds from a run folder to its first frame, and of a frame, one after the other and anywhere.

    What a browser takes to draw is not in it.
    """
    from piegraph_cli.viewer.layers import LAYERS
    from piegraph_cli.viewer.server import start_server
    from piegraph_cli.viewer.source import OpenRun
    from piegraph_cli.viewer.view import add_panels
    from piegraph_cli.viewer.viewer import Viewer

    assert folder is not None
    with tempfile.TemporaryDirectory(prefix="piegraph") as made:
        count = make_long_run(folder, Path(made), frames)
        begin = time.process_time()
        server, opened = start_server(0), OpenRun.of(Path(made))
        viewer = Viewer(server, [opened], LAYERS)
        try:
            add_panels(viewer)
            viewer.open(opened, opened.names[0])
            yield Row("view", f"open, {count} frames", time.process_time() - begin)
            anywhere = np.random.default_rng(0).integers(0, count, DRAWN)
            for case, shown in (("one after another", np.arange(DRAWN) % count), ("anywhere", anywhere)):
                yield Row("view", f"frame, {case}", float(np.median([_seconds(viewer, int(f)) for f in shown])))
        finally:
            viewer.close()
            server.stop()


def _seconds(viewer, frame: int) -> float:
    begin = time.process_time()
    viewer.draw_frame(frame)
    return time.process_time() - begin


def make_long_run(folder: Path, out: Path, frames: int) -> int:
    """The first sequence of a run, repeated to `frames` frames or more, in an empty folder; returns how many there are."""
    run = open_run(folder)
    name = next(iter(sequences(run)), "")
    gone = [artifact for artifact in SHOWN if not run.path(artifact, name).is_file()]
    if gone:
        raise UsageError(f"{folder} has no {gone[0]} to show", "bench view", f"piegraph run --run {folder}")
    (out / "recipe.toml").write_bytes((folder / "recipe.toml").read_bytes())
    count = 0
    for artifact in SHOWN:
        found = read_artifact(run.path(artifact, name), artifact)
        times = -(-frames // len(found["time"]))
        count = times * len(found["time"])
        write_artifact(
            out / artifact / f"{name}.h5",
            artifact,
            _repeated(found, times),
            stage=artifact,
            stage_version=1,
            key=found.key,
            params=found.params,
            inputs={},
        )
    return count


def _repeated(found: Artifact, times: int) -> dict[str, np.ndarray]:
    """The arrays of an artifact, a number of times after each other. Depth is not shown and left empty."""
    arrays = {}
    for dataset, value in found.arrays.items():
        field = field_of(found.name, dataset)
        assert field is not None
        if field.ends:
            value = np.concatenate([[0], *(value[1:] + k * value[-1] for k in range(times))])
        elif dataset == "time":
            value = np.concatenate([value + k * (value[-1] - value[0] + 0.1) for k in range(times)])
        elif field.axes.split(",")[0] in ROWS:
            value = np.concatenate([value] * times)
        arrays[dataset] = value
    if "depth" in arrays:
        arrays["depth"], arrays["depth_offsets"] = arrays["depth"][:0], np.zeros_like(arrays["color_offsets"])
    return arrays
