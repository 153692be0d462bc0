"""Stage `simulate`: true particles of random strokes; and, outside the pipeline, rendered recordings of them."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.environments.params import EnvironmentParams, SimulateParams
from piegraph_cli.recording.images import encode_masks
from piegraph_cli.recording.layout import write_cameras, write_frame, write_times
from piegraph_cli.workspace.artifact import read_key, write_artifact
from piegraph_cli.workspace.execute import Context, Output

RECORDING_VERSION = 2
JPEG_QUALITY = 82


def run(inputs: dict[str, Any], params: SimulateParams, context: Context) -> Output:
    """Simulate one sequence."""
    from piegraph_cli.environments import import_extra

    assert context.sequence is not None
    index = int(context.sequence.rsplit("_", 1)[1])
    environment = make_environment(params.environment, params.particles, params)
    recording = import_extra("piegraph_cli.environments.recording")
    tracks = recording.simulate_tracks(environment, sequence_seed(params, index), params.strokes, params.modes)
    frames, particles = tracks["positions"].shape[:2]
    arrays = tracks | {"residual": np.zeros(frames), "visibility": np.ones((frames, particles))}
    return Output(arrays, f"{frames} frames, {params.strokes} strokes, {particles} particles")


def make_environment(name: str, particles: int, params: EnvironmentParams) -> Any:
    """The environment of that name with the options that are given for it."""
    from piegraph_cli.environments import make

    options = dict(params.options)
    if name.startswith("daxbench-"):
        given = {"python": params.daxbench_python, "repo": params.daxbench_repo}
        options |= {k: str(v) for k, v in given.items() if v is not None}
    return make(name, particles, options)


def sequence_seed(params: SimulateParams, index: int) -> int:
    """The seed of one sequence, from (seed, index) alone."""
    return int(np.random.SeedSequence([params.seed, index]).generate_state(1)[0])


def record_sequences(out: Path, params: SimulateParams, *, jobs: int, force: bool) -> list[str]:
    """Render sequences into a recording folder (docs/formats.md), each with its truth.h5; finished ones are kept.

    A sequence is rendered into a hidden folder and renamed when it is whole, so that an interrupted one leaves nothing
    behind that could be taken for a recording.
    """
    import joblib
    from tqdm import tqdm

    from piegraph_cli.environments.hand import load_hand
    from piegraph_cli.environments.rig import camera_rig

    load_hand()  # fetched once, before several processes would fetch it
    write_cameras(out, camera_rig())
    names = [f"sequence_{i:04d}" for i in range(params.sequences)]
    work = joblib.Parallel(n_jobs=min(jobs, len(names)), return_as="generator")(
        joblib.delayed(_record_sequence)(out / name, params, i, force) for i, name in enumerate(names)
    )
    list(tqdm(work, total=len(names), desc="render", disable=None, leave=False))
    return names


def _record_sequence(folder: Path, params: SimulateParams, index: int, force: bool) -> None:
    from piegraph_cli.environments.hand import load_hand
    from piegraph_cli.environments.recording import record
    from piegraph_cli.environments.rig import camera_rig

    settings = params.model_dump(mode="json", exclude={"sequences"})
    key = f"{RECORDING_VERSION} {index} {settings}"
    if not force and read_key(folder / "truth.h5", "truth") == key:
        return
    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    cameras, times, truth = camera_rig(), [], []
    environment = make_environment(params.environment, params.particles, params)
    seed = sequence_seed(params, index)
    for number, frame in enumerate(record(environment, seed, params.strokes, cameras, load_hand(), params.modes)):
        for camera, color, depth in zip(cameras, frame.color, frame.depth, strict=True):
            write_frame(partial, camera, number, color, depth, JPEG_QUALITY)
        times.append(frame.stamps)
        truth.append(replace(frame, color=[], depth=[]))  # written already, and too large to keep
    for k, camera in enumerate(cameras):
        write_times(partial, camera, np.array(times)[:, k])
    write_artifact(
        partial / "truth.h5",
        "truth",
        truth_arrays(environment, truth),
        stage="simulate",
        stage_version=RECORDING_VERSION,
        key=key,
        params=settings,
        inputs={},
        quality="true values of a simulated recording: for scoring only",
    )
    if folder.exists():
        shutil.rmtree(folder)
    partial.rename(folder)


def truth_arrays(environment: Any, frames: list) -> dict[str, np.ndarray]:
    """The truth artifact of rendered frames: particles, surface mesh, masks, hand."""
    moments = [frame.moment for frame in frames]
    shapes = np.array([m.shape for m in moments])
    tips = [np.full(3, np.nan) if m.tip is None else m.tip for m in moments]
    objects, objects_offsets = encode_masks([mask for frame in frames for mask in frame.object_mask])
    hands, hands_offsets = encode_masks([mask for frame in frames for mask in frame.hand_mask])
    return {
        "particles": environment.particles(shapes),
        "vertices": environment.surface(shapes),
        "triangles": environment.triangles,
        "object_mask": objects,
        "object_mask_offsets": objects_offsets,
        "hand_mask": hands,
        "hand_mask_offsets": hands_offsets,
        "hand_keypoints": np.array([frame.landmarks for frame in frames]),
        "end_effector": np.array(tips),
        "stroke": np.array([m.stroke for m in moments]),
        "contact": np.array([m.stroke >= 0 for m in moments]),
        "time": np.array([m.time for m in moments]),
    }
