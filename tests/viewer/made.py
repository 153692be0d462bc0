"""A made-up run: two cameras above a square of particles that is pushed along x, six frames."""

from pathlib import Path

import cv2
import numpy as np

from piegraph_cli.recording.images import encode_masks, join_images
from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.artifact import write_artifact

FRAMES, CAMERAS, WIDTH, HEIGHT = 6, 2, 64, 48
BLUE = (30, 60, 200)


def positions(frames: int = FRAMES) -> np.ndarray:
    """Particles [F, 16, 3] (m), 1 cm to the right each frame."""
    grid = np.stack(np.meshgrid(np.arange(4), np.arange(4), indexing="ij"), -1).reshape(-1, 2) * 0.02
    at_rest = np.column_stack([grid, np.full(len(grid), 0.01)])
    return (at_rest + np.arange(frames)[:, None, None] * [0.01, 0, 0]).astype(np.float32)


def hand(frames: int) -> dict[str, np.ndarray]:
    path = np.column_stack([np.arange(frames) * 0.01 - 0.01, np.full(frames, 0.03), np.full(frames, 0.02)])
    path[0] = np.nan
    contact = np.arange(frames) > 2
    return {"end_effector": path.astype(np.float32), "contact": contact, "time": 10 + np.arange(frames) / 5}


def frames_arrays(frames: int = FRAMES) -> dict[str, np.ndarray]:
    """Two cameras straight above, which see a blue image."""
    down = np.diag([1.0, -1, -1, 1])
    down[:3, 3] = 0.05, 0.03, 0.5
    image = cv2.imencode(".jpg", np.full((HEIGHT, WIDTH, 3), BLUE[::-1], np.uint8))[1].tobytes()
    color, color_offsets = join_images([image] * (frames * CAMERAS))
    text = {name: np.zeros(0, "S128") for name in ("check_name", "check_unit", "check_verdict")}
    text |= {name: np.zeros(0, "S512") for name in ("check_camera", "check_text", "check_cause", "check_remedy")}
    return {
        "color": color,
        "color_offsets": color_offsets,
        "depth": color,
        "depth_offsets": color_offsets,
        "time": hand(frames)["time"],
        "source_frame": np.zeros((frames, CAMERAS), int),
        "camera_name": np.array(["left", "right"]),
        "image_size": np.array([[WIDTH, HEIGHT]] * CAMERAS),
        "K": np.array([[[60.0, 0, WIDTH / 2], [0, 60, HEIGHT / 2], [0, 0, 1]]] * CAMERAS),
        "distortion": np.zeros((CAMERAS, 5)),
        "depth_scale": np.full(CAMERAS, 0.001),
        "T_world_camera": np.array([down] * CAMERAS),
        "stamp": np.zeros((frames, CAMERAS)),
        "check_figure": np.zeros(0),
        "check_threshold": np.zeros(0),
        **text,
    }


def arrays(artifact: str, frames: int = FRAMES) -> dict[str, np.ndarray]:
    """The arrays of one artifact of the made-up sequence."""
    particles = positions(frames)
    if artifact == "frames":
        return frames_arrays(frames)
    if artifact == "masks":
        mask, offsets = encode_masks([np.ones((HEIGHT, WIDTH), bool)] * (frames * CAMERAS))
        area = np.full((frames, CAMERAS), HEIGHT * WIDTH)
        return {"mask": mask, "mask_offsets": offsets, "area": area, "time": hand(frames)["time"]}
    if artifact == "clouds":
        offsets = np.arange(frames + 1) * particles.shape[1]
        return {"points": particles.reshape(-1, 3), "offsets": offsets, **hand(frames)}
    if artifact == "hands":
        joints = np.full((frames, 21, 3), np.nan)
        joints[1:] = np.arange(21)[:, None] * 0.004
        landmarks = {"landmarks": np.zeros((frames, CAMERAS, 21, 2)), "seen": np.ones((frames, CAMERAS), bool)}
        seen = {name: value for name, value in hand(frames).items() if name != "contact"}
        return {"keypoints": joints, "observed": np.ones(frames, bool), **landmarks, **seen}
    if artifact == "scores":
        return {"score_name": np.zeros(0, "S128"), "score_value": np.zeros(0), "true_positions": particles + 0.001}
    assert artifact == "tracks"
    residual, seen = np.full(frames, 0.002), np.ones(particles.shape[:2])
    return {
        "positions": particles,
        "residual": residual,
        "visibility": seen,
        "mode": np.zeros(frames, np.uint8),
        "trust/doubt": residual,
        "trust/misfit": residual,
        **hand(frames),
    }


def write(run: Path, artifact: str, sequence: str = "first", key: str = "k", **changed: np.ndarray) -> Path:
    """Write one artifact of the made-up sequence, with some arrays changed; returns its file."""
    stage = next(stage.name for stage in STAGES.values() if stage.writes == artifact)
    frames = len(changed["time"]) if "time" in changed else FRAMES
    path = run / artifact / f"{sequence}.h5"
    about = {"stage": stage, "stage_version": 1, "key": key, "params": {"recording": "/gone"}, "inputs": {}}
    write_artifact(path, artifact, arrays(artifact, frames) | changed, **about)
    return path


def make_run(folder: Path, *artifacts: str, sequences: tuple[str, ...] = ("first",)) -> Path:
    """A run whose recording was moved away, with some artifacts of each sequence."""
    folder.mkdir(parents=True)
    (folder / "recipe.toml").write_text('[ingest]\nrecording = "/gone"\n')
    for sequence in sequences:
        for artifact in artifacts:
            write(folder, artifact, sequence)
    return folder
