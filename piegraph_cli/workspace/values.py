"""Arrays of an artifact against the schema: their names, types and shapes first, then what values they hold."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from piegraph_cli.errors import DataError
from piegraph_cli.workspace.schema import FIXED_AXES, INF, SCHEMAS, Field, field_of
from piegraph_cli.workspace.structure import Found

if TYPE_CHECKING:
    import numpy as np

RIGID = 1e-2
"""How far the rotation of a pose may be from one."""


def check_shapes(path: str, name: str, found: Mapping[str, Found], hint: str = "") -> dict[str, int]:
    """Check names, types and shapes of an artifact's datasets against the schema and each other.

    Returns the lengths of axes by name. Raises `DataError` naming the dataset.
    """
    import numpy as np

    needed = (d for d, field in SCHEMAS[name].items() if not (d.endswith("/*") or field.optional))
    missing = next((d for d in needed if d not in found), None)
    if missing:
        raise DataError(f"dataset {missing} is missing", path, hint)
    lengths = dict(FIXED_AXES)
    for dataset, value in found.items():
        field, where = field_of(name, dataset), f"{path}, dataset {dataset}"
        if field is None:
            raise DataError("not a dataset of this artifact", where, hint)
        if field.dtype != "*" and value.dtype != np.dtype(field.dtype):
            raise DataError(f"type {value.dtype}, expected {field.dtype}", where, hint)
        if field.axes != "*":
            _check_axes(value.shape, field.axes.split(",") if field.axes else [], lengths, where, hint)
    if {"image", "frame", "camera"} <= lengths.keys() and lengths["image"] != lengths["frame"] * lengths["camera"]:
        message = f"{lengths['image']} images, expected {lengths['frame']} frames of {lengths['camera']} cameras"
        raise DataError(message, path, hint)
    return lengths


def _check_axes(shape: tuple[int, ...], axes: list[str], lengths: dict[str, int], where: str, hint: str) -> None:
    if len(shape) != len(axes):
        raise DataError(f"shape {shape}, expected axes {','.join(axes)}", where, hint)
    for axis, length in zip(axes, shape, strict=True):
        edge = int(axis.endswith("_edge"))
        expected = int(axis) if axis.isdigit() else lengths.setdefault(axis.removesuffix("_edge"), length - edge) + edge
        if length != expected:
            raise DataError(f"axis {axis} has length {length}, expected {expected}", where, hint)


def check_values(
    path: str,
    name: str,
    arrays: "Mapping[str, np.ndarray]",
    found: Mapping[str, Found],
    lengths: Mapping[str, int],
    hint: str = "",
    part: bool = False,
) -> None:
    """Check what arrays hold, all or some of those that were `found`, with the `lengths` of axes: see `schema.Field`.

    Of `part` of a dataset's rows what they mean together is left out.
    """
    for dataset, value in arrays.items():
        field = field_of(name, dataset)
        assert field is not None
        where = f"{path}, dataset {dataset}"
        _check_numbers(value, field, lengths, where, hint)
        if field.ends and value.ndim and not part:
            _check_offsets(value, found[field.ends], field.ends, where, hint)
        if field.rises and (value[1:] <= value[:-1]).any():
            raise DataError(f"does not rise at index {int((value[1:] <= value[:-1]).argmax()) + 1}", where, hint)
        if field.pose:
            _check_poses(value, where, hint)


def _check_numbers(value: "np.ndarray", field: Field, lengths: Mapping[str, int], where: str, hint: str) -> None:
    import numpy as np

    kind = value.dtype.kind
    if kind == "S":
        _check_texts(value, where, hint)
    elif kind == "b":
        if value.view(np.uint8).max(initial=0) > 1:
            raise DataError("holds what is neither true nor false", where, hint)
    elif kind == "f" and not field.nan and not np.isfinite(value).all():
        raise DataError(f"value that is not finite at index {_first(~np.isfinite(value))}", where, hint)
    bounds = (0, lengths[field.index] - 1) if field.index else field.bounds
    if bounds is not None and kind in "fiu":
        wrong = (value < bounds[0]) | (value > bounds[1])
        if field.nan and bounds[0] > -INF:  # NaN may be, infinity may not
            wrong |= np.isinf(value)
        if wrong.any():
            index, units = _first(wrong), "" if field.units == "1" else f" {field.units}"
            message = f"{value[index]:g} at index {index}, expected {bounds[0]:g} to {bounds[1]:g}{units}"
            raise DataError(message, where, hint)


def _first(wrong: "np.ndarray") -> tuple[int, ...]:
    import numpy as np

    return tuple(int(i) for i in np.unravel_index(int(np.argmax(wrong)), wrong.shape))


def _check_texts(texts: "np.ndarray", where: str, hint: str) -> None:
    for index, text in enumerate(texts.flat):
        try:
            text.decode()
        except UnicodeDecodeError:
            raise DataError(f"holds what is no text at index {index}", where, hint) from None


def _check_offsets(offsets: "np.ndarray", parts: Found, name: str, where: str, hint: str) -> None:
    """Check offsets [n + 1] against the dataset they cut."""
    rises = len(offsets) > 0 and offsets[0] == 0 and (offsets[1:] >= offsets[:-1]).all()
    if not rises or parts.shape[:1] != (offsets[-1],):
        message = f"offsets into {name} do not rise from 0 to its end: {name} is {parts.shape}"
        raise DataError(message, where, hint)


def _check_poses(poses: "np.ndarray", where: str, hint: str) -> None:
    import numpy as np

    turns = poses[:, :3, :3]
    off = np.abs(turns @ turns.swapaxes(1, 2) - np.eye(3)).max((1, 2), initial=0)
    wrong = (off > RIGID) | (np.linalg.det(turns) < 0) | (poses[:, 3] != [0, 0, 0, 1]).any(1)
    if wrong.any():
        raise DataError(f"no rotation and shift at index {int(wrong.argmax())}", where, hint)


def check_arrays(path: Path, name: str, arrays: "Mapping[str, np.ndarray]") -> None:
    """Check all arrays of an artifact against the schema. Raises `DataError` naming the dataset."""
    found = {dataset: Found(value.shape, value.dtype) for dataset, value in arrays.items()}
    check_values(str(path), name, arrays, found, check_shapes(str(path), name, found))


def groups_of(name: str) -> set[str]:
    """The groups that an artifact may have."""
    return {dataset.removesuffix("/*") for dataset in SCHEMAS[name] if dataset.endswith("/*")}
