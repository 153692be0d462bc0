"""Object masks by Segment Anything: the official predictor on key frames, colour and GrabCut in between."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from piegraph_cli.errors import UsageError
from piegraph_cli.perception.hand_region import hand_region
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.sam_models import import_segment_anything
from piegraph_cli.perception.segmentation import check_seed, learn_object, lifted_to, segment_frame
from piegraph_cli.recording.camera import Camera

HAND_POINTS = (0, 5, 9, 17, 8, 12)
"""Landmarks given to the predictor as points that are not the object."""
BOX_MARGIN = 4
"""Pixels by which the box around a rough mask is widened."""


@dataclass(frozen=True)
class SamPrompt:
    """What a user points at in one camera's seed frame, in pixels (column, row)."""

    points: tuple[tuple[float, float], ...] = ()
    """Points on the object."""
    box: tuple[float, float, float, float] | None = None
    """Left, top, right, bottom."""


def segment_sequence(
    sam: Any,
    images: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    camera: Camera,
    hand_px: np.ndarray,
    workspace: np.ndarray,
    seed_frame: int,
    seed_mask: np.ndarray,
    params: SegmentParams,
    tips: np.ndarray | None = None,
    key_every: int = 10,
    prompt: SamPrompt | None = None,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
    within: range | None = None,
) -> np.ndarray:
    """Masks [F, H, W] bool of the object in one camera; arguments as in `segmentation.segment_sequence`.

    `sam` comes from `sam_models.load_sam`. The predictor runs on the seed frame and on every `key_every`-th from there,
    prompted by a box and points from the mask carried that far (in the seed frame by `prompt` where given; `seed_mask`
    may then be empty) and by the hand as what is not the object; frames in between are followed as without weights.
    Source: paper, section III-D (SAM).
    """
    predictor = import_segment_anything().SamPredictor(sam)
    first = images[seed_frame], depths[seed_frame], camera, hand_px[seed_frame]
    seed = _seed(predictor, *first, seed_frame, seed_mask, prompt)
    lifted = lifted_to(tips, len(hand_px))
    model = learn_object(images, depths, camera, hand_px, workspace, seed_frame, seed, lifted)
    masks = np.zeros((len(hand_px), *seed.shape), bool)
    masks[seed_frame] = seed
    begin, end = (0, len(hand_px)) if within is None else (within.start, within.stop)
    for frames in (range(seed_frame + 1, end), range(seed_frame - 1, begin - 1, -1)):
        previous, missed = seed, 0
        for f in progress(frames):
            given = images[f], depths[f], camera, hand_px[f], workspace, previous, model, params
            masks[f] = segment_frame(*given, lifted=lifted[f], missed=missed)
            if (f - seed_frame) % key_every == 0 and masks[f].any():
                masks[f] = _key_frame(predictor, images[f], depths[f], camera, hand_px[f], masks[f])
            previous, missed = (masks[f], 0) if masks[f].any() else (previous, missed + 1)
    return masks


def _seed(
    predictor: Any,
    image: np.ndarray,
    depth: np.ndarray,
    camera: Camera,
    hand_px: np.ndarray,
    frame: int,
    rough: np.ndarray,
    prompt: SamPrompt | None,
) -> np.ndarray:
    if prompt is None:
        check_seed(rough, camera, frame)
        prompt = automatic_prompt(rough)
    mask = predict_mask(predictor, image, prompt, _hand_points(hand_px, image.shape), rough)
    mask &= ~hand_region(hand_px, depth, camera, 0.5)
    check_seed(mask, camera, frame)
    return mask


def _key_frame(
    predictor: Any, image: np.ndarray, depth: np.ndarray, camera: Camera, hand_px: np.ndarray, rough: np.ndarray
) -> np.ndarray:
    mask = predict_mask(predictor, image, automatic_prompt(rough), _hand_points(hand_px, image.shape), rough)
    return mask & ~hand_region(hand_px, depth, camera, 0.5)


def automatic_prompt(mask: np.ndarray, points: int = 3) -> SamPrompt:
    """A box around a rough mask [H, W], and points on it that are far from its outline and from each other."""
    import cv2

    rows, columns = np.nonzero(mask)
    left, top = float(columns.min() - BOX_MARGIN), float(rows.min() - BOX_MARGIN)
    box = (left, top, float(columns.max() + BOX_MARGIN), float(rows.max() + BOX_MARGIN))
    padded = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    depth_inside = cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1]
    grid = np.stack(np.meshgrid(np.arange(mask.shape[1]), np.arange(mask.shape[0])), axis=-1)
    chosen: list[tuple[float, float]] = []
    apart = np.full(mask.shape, np.inf)
    for _ in range(points):
        row, column = np.unravel_index(np.argmax(np.minimum(depth_inside, apart / 4)), mask.shape)
        chosen.append((float(column), float(row)))
        apart = np.minimum(apart, np.linalg.norm(grid - [column, row], axis=-1))
    return SamPrompt(tuple(dict.fromkeys(chosen)), box)


def _hand_points(hand_px: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    points = hand_px[list(HAND_POINTS)]
    with np.errstate(invalid="ignore"):
        inside = ((points >= 0) & (points < [shape[1], shape[0]])).all(axis=1)
    return points[inside]


def predict_mask(
    predictor: Any, image: np.ndarray, prompt: SamPrompt, not_object: np.ndarray, rough: np.ndarray
) -> np.ndarray:
    """The predictor's mask [H, W] bool of an RGB image for a prompt and pixels [N, 2] that are not the object.

    Of its three proposals the one is taken whose predicted quality and overlap with `rough` [H, W] (may be empty)
    together are best. Raises UsageError for a prompt without points and box.
    """
    if not prompt.points and prompt.box is None:
        raise UsageError("a prompt needs points or a box", hint="give pixels of the seed frame, or no prompt at all")
    points = np.array([*prompt.points, *np.asarray(not_object).reshape(-1, 2)], float).reshape(-1, 2)
    labels = np.array([1] * len(prompt.points) + [0] * len(not_object))
    predictor.set_image(np.ascontiguousarray(image))
    masks, quality, _ = predictor.predict(
        point_coords=points if len(points) else None,
        point_labels=labels if len(points) else None,
        box=np.array(prompt.box, float) if prompt.box is not None else None,
    )
    overlap = (masks & rough).sum(axis=(1, 2)) / np.maximum((masks | rough).sum(axis=(1, 2)), 1)
    return masks[int(np.argmax(quality + overlap))]
