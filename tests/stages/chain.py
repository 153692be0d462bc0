"""Stages called in-process on arrays in memory: what stands for artifacts and for the context, in one place."""

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from piegraph_cli.dynamics.params import DatasetParams, ModelParams, TrainParams
from piegraph_cli.evaluation.params import ModelEvaluateParams
from piegraph_cli.physics.params import TrackParams
from piegraph_cli.recording.images import encode_depth, encode_masks, join_images
from piegraph_cli.stages import dataset, evaluate, track, train
from piegraph_cli.workspace.artifact import Artifact

FRAMES = 6
"""Of a stroke, from rest to rest."""
PACE = 0.01
"""Metres between two frames in the first sequence, a millimetre more in each later one."""


def artifact(arrays: Mapping[str, Any], params: Mapping[str, Any] | None = None) -> Artifact:
    return Artifact(
        Path("memory.h5"), "", "", dict(params or {}), {}, "", {k: np.asarray(v) for k, v in arrays.items()}
    )


def context(folder: Path = Path("nowhere")) -> Any:
    """No progress, no checkpoint."""
    return SimpleNamespace(
        run=SimpleNamespace(folder=folder, producer=lambda artifact: None),
        unit="one",
        device="cpu",
        checkpoint=SimpleNamespace(load=lambda: None, save=lambda state: None),
        progress=lambda items, *_: iter(items),
        counting=lambda *_: iter,
    )


def tracks(index: int, strokes: int = 2, particles: int = 16, pick: bool = False) -> Artifact:
    """A sequence whose object goes with the hand, further in later ones: strokes in contact, a frame of rest after each."""
    rng, pace = np.random.default_rng(index), PACE + 0.001 * index
    state = np.concatenate([rng.uniform(-0.1, 0.1, (particles, 2)), np.full((particles, 1), 0.01)], 1)
    positions, hand, contact = [], [], []
    for _ in range(strokes):
        angle = rng.uniform(-np.pi, np.pi)
        along = np.array([np.cos(angle), np.sin(angle), 0])
        begin = state[0] - (0 if pick else 0.01) * along
        for frame in range(FRAMES):
            positions.append(state + pace * frame * along)
            hand.append(begin + pace * frame * along)
            contact.append(True)
        state = positions[-1]
        positions.append(state)
        hand.append(np.full(3, np.nan))
        contact.append(False)
    count = len(positions)
    return artifact(
        {
            "positions": np.array(positions, np.float32),
            "end_effector": np.array(hand, np.float32),
            "contact": contact,
            "mode": np.full(count, int(pick), np.uint8),
            "visibility": np.ones((count, particles), np.float32),
            "time": np.arange(count) / 5,
        }
    )


def make_dataset(count: int = 8, pick: bool = False, strokes: int = 2, **settings: Any) -> Artifact:
    """The dataset of `count` sequences, by the stage itself."""
    found = {f"sequence_{k:04d}": tracks(k, strokes=strokes, pick=pick) for k in range(count)}
    output = dataset.run({"tracks": found}, DatasetParams(**{"train": 4, "validation": 2} | settings), context())
    names = np.array([name.encode() for name in output.arrays["sequence_name"]])
    return artifact(dict(output.arrays) | {"sequence_name": names})


def make_model(data: Artifact, label: str, seed: int = 0, **settings: Any) -> Artifact:
    """What the stage `train` makes of one model."""
    name = label.partition("@")[0]
    params = TrainParams(**{name: settings})
    one = ModelParams(label=label, seed=seed, settings=params.of(label))
    output = train.run({"dataset": data}, one, context())
    return artifact(output.arrays, one.model_dump(mode="json"))


def make_metrics(
    data: Artifact, model: Artifact | None, label: str, scores=None, **settings: Any
) -> dict[str, np.ndarray]:
    """What the stage `evaluate` makes of one model."""
    inputs = {"dataset": data} | ({"model": model} if model else {}) | ({"scores": scores} if scores else {})
    params = ModelEvaluateParams(label=label, **{"horizons": (1, 2)} | settings)
    return dict(evaluate.run(inputs, params, context()).arrays)


def make_tracks(
    clouds: list[np.ndarray], hand: np.ndarray, contact: np.ndarray, **settings: Any
) -> dict[str, np.ndarray]:
    """What the stage `track` makes of clouds."""
    source = {
        "points": np.concatenate(clouds),
        "offsets": np.cumsum([0, *map(len, clouds)]),
        "end_effector": hand,
        "contact": contact,
        "time": np.arange(len(clouds)) / 5,
    }
    inputs = from_above(len(clouds)) | {"clouds": artifact(source)}
    return dict(track.run(inputs, TrackParams(**settings), context()).arrays)


def from_above(frames: int) -> dict[str, Artifact]:
    """Frames and masks of one camera, 1 m above the table, whose mask is everywhere and whose depth has no reading."""
    depth, offsets = join_images([encode_depth(np.zeros((64, 64), np.uint16))] * frames)
    mask, mask_offsets = encode_masks([np.ones((64, 64), bool)] * frames)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 1.0
    camera = {
        "camera_name": np.array([b"top"]),
        "image_size": np.array([[64, 64]]),
        "K": np.array([[[20.0, 0, 32], [0, 20, 32], [0, 0, 1]]]),
        "distortion": np.zeros((1, 5)),
        "depth_scale": np.array([0.001]),
        "T_world_camera": pose[None],
    }
    images = {"depth": depth, "depth_offsets": offsets, "time": np.arange(frames) / 5}
    return {"frames": artifact(camera | images), "masks": artifact({"mask": mask, "mask_offsets": mask_offsets})}
