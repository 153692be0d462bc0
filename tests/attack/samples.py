"""A small valid artifact of every kind that the schema knows, made from the schema itself."""

from pathlib import Path

import numpy as np

from piegraph_cli.workspace.artifact import write_artifact
from piegraph_cli.workspace.schema import FIXED_AXES, SCHEMAS, Field

LENGTHS = {"frame": 6, "camera": 2, "image": 12, "particle": 5, "sequence": 2, "stroke": 3, "episode": 2, "vertex": 8}
OTHER = 4


def arrays_of(name: str, seed: int = 0) -> dict[str, np.ndarray]:
    """Arrays of an artifact that fit its schema."""
    rng = np.random.default_rng(seed)
    found = {}
    for dataset, field in SCHEMAS[name].items():
        for place in [dataset.replace("*", part) for part in "ab"] if "*" in dataset else [dataset]:
            found[place] = _array(field, rng)
    return found


def _array(field: Field, rng: np.random.Generator) -> np.ndarray:
    axes = [] if not field.axes else ["3", "4"] if field.axes == "*" else field.axes.split(",")
    shape = tuple(_length(axis) for axis in axes)
    if field.pose:
        return np.broadcast_to(np.eye(4), shape)
    if field.ends:
        return np.linspace(0, _length(SCHEMAS_OF_PARTS[field.ends]), shape[0]).astype(np.int64)
    if field.rises:
        return np.arange(shape[0], dtype=float)
    if field.index:
        return rng.integers(0, _length(field.index), shape)
    if field.dtype.startswith("S"):
        return np.array([f"text {k}" for k in range(int(np.prod(shape)))]).reshape(shape)
    low, high = field.bounds or (0.0, 10.0)
    low, high = max(low, -1.0), min(high, 1.0) if high < np.inf else 10.0
    dtype = "float64" if field.dtype == "*" else field.dtype
    return rng.uniform(low, max(high, low + 1), shape).astype(dtype)


def _length(axis: str) -> int:
    if axis.endswith("_edge"):
        return _length(axis.removesuffix("_edge")) + 1
    return int(axis) if axis.isdigit() else FIXED_AXES.get(axis) or LENGTHS.get(axis, 40 if "byte" in axis else OTHER)


SCHEMAS_OF_PARTS = {
    field.ends: fields[field.ends].axes.split(",")[0]
    for fields in SCHEMAS.values()
    for field in fields.values()
    if field.ends
}
"""The axis along which what offsets cut lies."""


def write_sample(path: Path, name: str) -> Path:
    """Write one of them."""
    rest = {"stage": "attack", "stage_version": 1, "key": "k", "inputs": {}, "quality": "made up"}
    write_artifact(path, name, arrays_of(name), params={"label": "piegraph", "seed": 0, "settings": {}}, **rest)
    return path
