"""Stage `simulate`: true particles of random strokes; and, outside the pipeline, rendered recordings of them."""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.environments.params import RecordingParams, SequenceParams, SimulateParams
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.files import MAKE_ROOM
from piegraph_cli.stages.steps import check_environments, make_environment
from piegraph_cli.text import counted
from piegraph_cli.workspace.call import Call, Folder, Given, Instead, Told
from piegraph_cli.workspace.parallel import in_processes
from piegraph_cli.workspace.stage import Context, Output, Stage, Unit

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.workspace.run import Run

RECORDING_VERSION = 2
JPEG_QUALITY = 82


def _units(run: "Run") -> Sequence[Unit]:
    return [f"sequence_{i:04d}" for i in range(run.params(STAGE.name).sequences)]


def _settings(run: "Run", unit: str) -> SequenceParams:
    params = run.params(STAGE.name)
    usual, given = RecordingParams(), params.model_dump()
    only = [name for name in ("cameras", "trouble", "texture") if getattr(params, name) != getattr(usual, name)]
    if only:
        raise UsageError(f"simulate.{only[0]}: particles have no cameras", hint="add --render for a recording")
    return SequenceParams(**{name: given[name] for name in SequenceParams.model_fields})


def _check(run: "Run", units: Sequence[Unit], processes: int) -> list[str]:
    params = run.params(STAGE.name)
    return check_environments([(params.environment, params)], processes)


def _of_recording(params: SimulateParams) -> RecordingParams:
    return RecordingParams(**params.model_dump(exclude={"sequences"}))


def _folder(given: Given) -> Path:
    return Path("recordings" if given.get("render") else "runs") / given["environment"]


def _render(folder: Path, params: SimulateParams, jobs: int, force: bool) -> Told:
    names = record_sequences(folder, params, jobs=jobs, force=force)
    return {"recording": str(folder), "sequences": names}, [f"{folder}: {counted(len(names), 'sequence')}"]


STAGE = Stage(
    "simulate",
    "simulate true particles",
    (),
    "tracks",
    SimulateParams,
    version=1,
    run="piegraph_cli.stages.simulate:run",
    units=_units,
    settings=_settings,
    check=_check,
    call=Call(
        more="True particles of random strokes, as tracks of a run; with --render, a recording like one of real cameras.",
        argument="environment",
        first=("sequences", "strokes", "modes", "options", "particles", "seed"),
        folder=Folder("out", "folder [default: runs/ENVIRONMENT, or recordings/ENVIRONMENT with --render]", _folder),
        counts="strokes",
        instead=Instead("render", "record it with RGB-D cameras and a hand", _render),
    ),
)


def run(inputs: dict[str, Any], params: SequenceParams, context: Context) -> Output:
    """Simulate one sequence."""
    import numpy as np

    from piegraph_cli.environments import import_extra

    index = int(str(context.unit).rsplit("_", 1)[1])
    environment = make_environment(params.environment, params.particles, params)
    recording = import_extra("piegraph_cli.environments.recording")
    tracks = recording.simulate_tracks(environment, sequence_seed(params, index), params.strokes, params.modes)
    frames, particles = tracks["positions"].shape[:2]
    arrays = tracks | {"residual": np.zeros(frames), "visibility": np.ones((frames, particles))}
    return Output(arrays, f"{frames} frames, {counted(params.strokes, 'stroke')}, {particles} particles")


def sequence_seed(params: SequenceParams, index: int) -> int:
    """The seed of one sequence, from (seed, index) alone."""
    import numpy as np

    return int(np.random.SeedSequence([params.seed, index]).generate_state(1)[0])


def record_sequences(out: Path, params: SimulateParams, *, jobs: int, force: bool) -> list[str]:
    """Render sequences into a recording folder (docs/formats.md), each with its truth.h5; finished ones are kept.

    A sequence is rendered into a hidden folder and renamed when it is whole, so that an interrupted one leaves nothing
    behind that could be taken for a recording.
    """
    from tqdm import tqdm

    from piegraph_cli.environments.hand import load_hand
    from piegraph_cli.environments.rig import camera_rig
    from piegraph_cli.environments.trouble import told_cameras
    from piegraph_cli.recording.layout import write_cameras

    _check_out(out)
    load_hand()  # fetched once, before several processes would fetch it
    write_cameras(out, told_cameras(camera_rig(count=params.cameras), params.trouble))
    names = [f"sequence_{i:04d}" for i in range(params.sequences)]
    tasks = [partial(_record_sequence, out / name, _of_recording(params), i, force) for i, name in enumerate(names)]
    work = in_processes(tasks, min(jobs, len(names)), in_order=True)
    list(tqdm(work, total=len(names), desc="render", disable=None, leave=False))
    return names


def _check_out(out: Path) -> None:
    """Refuse a folder in which there is a sequence that was recorded: it would be replaced, and its cameras.json too."""
    from piegraph_cli.recording.folders import entries_of

    real = next((p for p in sorted(entries_of(out)) if p.is_dir() and not (p / "truth.h5").is_file()), None)
    if real:
        raise UsageError("holds what was not simulated", str(real), "render into a folder of its own: --out")


def _record_sequence(folder: Path, params: RecordingParams, index: int, force: bool) -> None:
    from piegraph_cli.workspace.artifact import read_key, write_artifact

    settings = params.content()
    key = f"{RECORDING_VERSION} {index} {settings}"
    if not force and read_key(folder / "truth.h5", "truth") == key:
        return
    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        arrays = _write_images(partial, params, sequence_seed(params, index))
        write_artifact(
            partial / "truth.h5",
            "truth",
            arrays,
            stage="simulate",
            stage_version=RECORDING_VERSION,
            key=key,
            params=settings,
            inputs={},
            quality="true values of a simulated recording: for scoring only",
        )
        _put_in_place(partial, folder)
    except OSError as error:
        raise DataError(f"cannot be written: {error}", str(folder), MAKE_ROOM) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _put_in_place(whole: Path, folder: Path) -> None:
    """Rename a folder that is whole; the one that was there stays until then."""
    before = folder.with_name(f".{folder.name}.before")
    shutil.rmtree(before, ignore_errors=True)
    if folder.exists():
        folder.rename(before)
    try:
        whole.rename(folder)
    except OSError:
        if before.exists():
            before.rename(folder)
        raise
    shutil.rmtree(before, ignore_errors=True)


def _write_images(folder: Path, params: RecordingParams, seed: int) -> "dict[str, np.ndarray]":
    """Render a sequence into a folder; returns the datasets of its truth."""
    import numpy as np

    from piegraph_cli.environments.hand import load_hand
    from piegraph_cli.environments.recording import record, truth_arrays
    from piegraph_cli.environments.rig import camera_rig
    from piegraph_cli.environments.trouble import trouble_arrays
    from piegraph_cli.recording.layout import write_frame, write_times

    cameras, truth = camera_rig(count=params.cameras), []
    environment = make_environment(params.environment, params.particles, params)
    frames = record(
        environment, seed, params.strokes, cameras, load_hand(), params.modes, params.trouble, params.texture
    )
    for number, frame in enumerate(frames):
        for camera, color, depth, lost in zip(cameras, frame.color, frame.depth, frame.lost, strict=True):
            if not lost:
                write_frame(folder, camera, number, color, depth, JPEG_QUALITY)
        truth.append(replace(frame, color=[], depth=[]))  # written already, and too large to keep
    stamps, kept = np.array([f.stamps for f in truth]), ~np.array([f.lost for f in truth])
    for k, camera in enumerate(cameras):
        write_times(folder, camera, stamps[kept[:, k], k])
    done = trouble_arrays(params.trouble, cameras, kept) if params.trouble != RecordingParams().trouble else {}
    return truth_arrays(environment, truth) | done
