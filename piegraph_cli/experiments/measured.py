"""Strokes that others measured in one file, as files for `import`: a sequence of two frames each; and an outline."""

import io
import logging
import os
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.files import atomic_file
from piegraph_cli.physics.rigid import planar_fit
from piegraph_cli.recording.motion import FEWEST
from piegraph_cli.recording.motion_doubts import STILL, find_torn
from piegraph_cli.recording.outline import checked_outline
from piegraph_cli.recording.points import read_arrays
from piegraph_cli.text import counted

log = logging.getLogger("piegraph")

NAMES = ("before", "after", "start", "end")
HEIGHT = 0.01
"""Metres above the table of what was measured in the plane."""
NEEDED = "before and after [S, N, 2 or 3], start and end [S, 2 or 3], metres"
MOVED, FEW_STROKES, ALONG = 0.005, 5, 0.3
"""Metres that a stroke has to move the object, strokes that have to, and how far along the push (cosine, median)."""
AWAY, ASIDE, ASIDE_SHARE = 0.1, 0.03, 0.1
"""Metres from where its stroke ends to the object, median, at which no pusher touches it; metres beyond the particles'
spacing, and a share of the strokes, from which that is said.
"""
TURNED, GROWN, ALIKE = 120.0, 0.03, 0.01
"""Degrees that no push turns things by (median); a share that all things are larger by, and how alike, where units differ."""
OUTLINE = "outline"
"""Array of corners [K, 2] (m) that a file may have, and the variant of rigid bodies that is given it."""

RIGID = ("rigid", "rigid-gp")
"""Models that take an outline."""


def write_strokes(file: Path | None, folder: Path) -> None:
    """Write each stroke of `file` into `folder`: particles `before` and `after` it, `start` and `end` of the pusher.

    Raises `UsageError` without a file and `DataError` for one that lacks something. Files that are there stay where they
    hold the same, so that what was made of them stays fresh; those of strokes that `file` lacks go. An outline that it has
    is written beside the folder.
    """
    if file is None:
        raise UsageError("whose strokes?", "pushes", f"--data FILE.npz with {NEEDED}")
    arrays = read_arrays(file, (*NAMES, OUTLINE))
    missing = [name for name in NAMES if name not in arrays]
    if missing:
        raise DataError(f"no array {missing[0]}", str(file), f"an .npz of {NEEDED}")
    before, after, start, end = (_in_space(arrays[name], name, file) for name in NAMES)
    if before.ndim != 3 or before.shape != after.shape or {start.shape, end.shape} != {(len(before), 3)}:
        raise DataError("arrays do not belong together", str(file), f"an .npz of {NEEDED}")
    if not len(before):
        raise DataError("holds no stroke", str(file), f"an .npz of {NEEDED}")
    _check_order(before, after, str(file))
    _check_way(before, after, start, end, str(file))
    for number in range(len(before)):
        _write(
            folder / f"{number:05d}.npz",
            particles=np.stack([before[number], after[number]]),
            end_effector=np.stack([start[number], end[number]]),
            times=np.array([0.0, 1.0]),
            contact=np.array([1, 1]),
        )
    for path in folder.glob("[0-9][0-9][0-9][0-9][0-9].npz"):
        if int(path.stem) >= len(before):
            path.unlink()
    if OUTLINE in arrays:
        _write(_outline_beside(folder), outline=checked_outline(arrays[OUTLINE], str(file)))
    else:
        _outline_beside(folder).unlink(missing_ok=True)


def _check_order(before: np.ndarray, after: np.ndarray, where: str) -> None:
    """Raise `DataError` where particles `after` [S, N, 3] (m) are not those `before`, one by one, or of another size."""
    if min(before.shape[1], len(before)) < FEWEST or not (np.isfinite(before).all() and np.isfinite(after).all()):
        return  # what is wrong with them is said of each stroke
    found = [find_torn(np.stack(pair)) for pair in zip(before, after, strict=True)]
    torn = [number for number, one in enumerate(found) if one]
    order = "in before and after of a stroke a particle has one index"
    if torn:
        text = f"particles leave those beside them in {len(torn)} of {counted(len(before), 'stroke')}"
        raise DataError(text, f"{where}, stroke {torn[0]}", f"are after's in another order? {order}")
    turns = [abs(planar_fit(a[:, :2], b[:, :2])[2]) for a, b in zip(before, after, strict=True)]
    turned = float(np.degrees(np.median(turns)))
    if turned > TURNED:
        text = f"strokes turn what they push by {turned:.0f} deg (median of {len(turns)})"
        raise DataError(text, where, f"are after's particles in another order, or mirrored? {order}")
    sizes = [np.sqrt(((side - side.mean(1, keepdims=True)) ** 2).sum((1, 2))) for side in (before, after)]
    low, grown, high = np.quantile(sizes[1] / np.maximum(sizes[0], 1e-9), [0.1, 0.5, 0.9])
    if abs(grown - 1) > GROWN and high - low < ALIKE:
        text = f"what is pushed is {grown:.3g} times as large after each stroke as before it"
        raise DataError(text, where, "give both in metres")


def _check_way(before: np.ndarray, after: np.ndarray, start: np.ndarray, end: np.ndarray, where: str) -> None:
    """Raise `DataError` where objects are not touched, or do not move the way they are pushed: arrays or axes are exchanged."""
    if len(end) < FEW_STROKES:
        return
    gaps = np.linalg.norm(after - end[:, None], axis=2).min(1)
    away = float(np.median(gaps))
    missed = gaps > ASIDE + float(np.median([np.median(cKDTree(p).query(p, k=2)[0][:, 1]) for p in before]))
    if away > AWAY:
        text = f"the pusher ends {away:.2g} m from the object (median of {len(end)} strokes)"
        raise DataError(text, where, "give both in metres, in one frame of reference")
    if missed.mean() > ASIDE_SHARE:
        log.warning(
            "%s: %d of %d strokes end %.0f mm and more from the object\n  try: are they of the pusher's tip, in its frame?",
            *(where, missed.sum(), len(end), 1000 * gaps[missed].min()),
        )
    moved, pushed = (after - before).mean(1), end - start
    lengths = np.linalg.norm(moved, axis=1), np.linalg.norm(pushed, axis=1)
    with np.errstate(invalid="ignore"):
        far = (lengths[0] > MOVED) & (lengths[1] > MOVED)
    if not (lengths[0] > STILL).any():
        raise DataError(f"none of {len(end)} strokes moves the object", where, "is after the same as before?")
    if far.sum() < FEW_STROKES:
        return
    along = float(np.median((moved * pushed).sum(1)[far] / (lengths[0] * lengths[1])[far]))
    if along < ALONG:
        text = f"objects do not move the way they are pushed (cosine {along:.2f}, median of {far.sum()} strokes)"
        raise DataError(text, where, "are before and after, start and end, or the axes of some exchanged?")


def with_outline(params: ExperimentParams, folder: Path) -> ExperimentParams:
    """The experiment with rows of rigid bodies that are given the outline, where strokes in `folder` have one beside them."""
    file = _outline_beside(folder)
    labels = {name: f"{name}:{OUTLINE}" for name in params.models if name in RIGID}
    if not labels or not file.is_file():
        return params
    models = [name for model in params.models for name in (model, labels.get(model, model))]
    variants = params.variants | {label: {"outline": os.path.realpath(file)} for label in labels.values()}
    return params.model_copy(update={"models": tuple(dict.fromkeys(models)), "variants": variants})


def _outline_beside(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}-{OUTLINE}.npz")


def _write(path: Path, **arrays: np.ndarray) -> None:
    """An .npz of arrays; one that holds the same stays as it is."""
    stream = io.BytesIO()
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    if path.is_file() and path.read_bytes() == stream.getvalue():
        return
    with atomic_file(path) as temporary:
        temporary.write_bytes(stream.getvalue())


def _in_space(array: np.ndarray, name: str, file: Path) -> np.ndarray:
    """Points [..., 3] of points [..., 2 or 3]."""
    if array.dtype.kind not in "fiu" or array.ndim < 2 or array.shape[-1] not in (2, 3):
        raise DataError(f"{name} is no array of points but {array.dtype} {list(array.shape)}", str(file), NEEDED)
    if array.shape[-1] == 3:
        return array
    return np.concatenate([array, np.full((*array.shape[:-1], 1), HEIGHT)], -1)
