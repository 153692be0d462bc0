"""Object masks without learned weights: colour and height told apart by models of the seed, refined by GrabCut."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.perception.clouds import flying_pixels, world_map
from piegraph_cli.perception.hand_region import hand_region
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.places import EDGE, inside, locate
from piegraph_cli.perception.windows import WHOLE, Window, window_around
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.colour import colour_model, lab_bins

INTRUDER_SAMPLES = 10
"""Frames from which the colours of hand and sleeve are learnt."""
ALIKE = 3.0
"""Log-likelihood ratio to the table from which a colour counts as the object's own."""
TABLE_LIKE, HAND_UNLIKE = -1.5, 0.5
"""Log-likelihood ratios to table and hand from which a colour is the object's where depth says that it is no table."""
ON_HAND = 1.5
"""Evidence against the object where the hand's landmarks say that the hand is."""
SURE_OBJECT, SURE_OTHER, EXCLUDED = 4.0, -4.0, -8.0
"""Evidence beyond which GrabCut may not decide otherwise; near the outline it may, short of exclusion."""
AGREEMENT = 0.3
"""Share of the rough mask that GrabCut must leave; below it the colours are too alike and the rough one stays."""
FEWEST = 10
"""Pixels of object and surroundings that GrabCut needs to learn their colours."""
BAND = 5
"""Width (px) of the outline within which GrabCut decides."""
REACH = 0.05
"""Distance (m) from the last mask at which a pixel needs clear evidence to belong to the object."""
FLAT = 1.5
"""Least heights that the object's top must have for its height to tell it."""
FARTHEST = 0.3
"""The same after frames without the object: it is looked for a reach farther with each of them, up to this."""
LIFT, HELD = 0.06, 0.03
"""How much (m) above its first height the object may rise, and above the end-effector, which may lift it."""
RIM = 8
"""Pixels around the rough mask that GrabCut looks at."""


@dataclass
class ObjectModel:
    """What one camera knows of the object: colours, also of what is not the object, height, and GrabCut's mixtures."""

    object: np.ndarray
    surroundings: np.ndarray
    intruder: np.ndarray
    """Log-likelihoods of `colour.lab_bins`."""
    height: float
    """Height (m) of the object's top above the table."""
    mixtures: np.ndarray | None = None
    """[2, 1, 65] GrabCut's colour mixtures of background and object, carried from frame to frame."""


def segment_sequence(
    images: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    camera: Camera,
    hand_px: np.ndarray,
    workspace: np.ndarray,
    seed_frame: int,
    seed_mask: np.ndarray,
    params: SegmentParams,
    tips: np.ndarray | None = None,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
    within: range | None = None,
) -> np.ndarray:
    """Masks [F, H, W] bool of the object in one camera, from its seed [H, W] in `seed_frame` (see `seeds.find_object`).

    `images` RGB uint8 [H, W, 3] and `depths` [H, W] in the camera's units (0 = no reading) are indexed by frame, in
    any order; `hand_px` [F, 21, 2] px (NaN where no hand is); `workspace` [3, 2] bounds (m); `tips` [F, 3] the
    end-effector (m; NaN where unknown), as high as which the object may be lifted; `progress` gives the frames it is
    given; `within` says how far it is followed, all the way by default. A frame in which the object is hidden has an
    empty mask. Raises DataError naming the camera where the object is never seen.
    """
    check_seed(seed_mask, camera, seed_frame)
    lifted = lifted_to(tips, len(hand_px))
    model = learn_object(images, depths, camera, hand_px, workspace, seed_frame, seed_mask, lifted)
    masks = np.zeros((len(hand_px), *seed_mask.shape), bool)
    first, end = (0, len(hand_px)) if within is None else (within.start, within.stop)
    for frames in (range(seed_frame, end), range(seed_frame - 1, first - 1, -1)):
        previous, missed = seed_mask if frames.step > 0 else masks[seed_frame], 0
        for f in progress(frames):
            given = images[f], depths[f], camera, hand_px[f], workspace, previous, model, params
            masks[f] = segment_frame(*given, lifted=lifted[f], missed=missed)
            previous, missed = (masks[f], 0) if masks[f].any() else (previous, missed + 1)
    return masks


def lifted_to(tips: np.ndarray | None, count: int) -> np.ndarray:
    """How high (m) [F] an end-effector [F, 3] may have lifted what it holds; 0 where it is unknown."""
    return np.zeros(count) if tips is None else np.nan_to_num(tips[:, 2] + HELD)


def check_seed(seed_mask: np.ndarray, camera: Camera, seed_frame: int) -> None:
    """Raise DataError naming the camera where its seed is empty."""
    if not seed_mask.any():
        raise DataError(
            "the object is not seen where the other cameras see it",
            f"camera {camera.name}, frame {seed_frame}",
            "check its calibration, --workspace and --min-height, or remove the camera from cameras.json",
        )


def learn_object(
    images: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    camera: Camera,
    hand_px: np.ndarray,
    workspace: np.ndarray,
    seed_frame: int,
    seed_mask: np.ndarray,
    lifted: np.ndarray | None = None,
) -> ObjectModel:
    """Learn the colours of object and table from the seed, those of hand and sleeve from frames spread over all.

    `lifted` [F] (m) as from `lifted_to`.
    """
    import cv2

    depth = depths[seed_frame]
    bins = lab_bins(images[seed_frame])
    core = cv2.erode(seed_mask.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    near = cv2.dilate(seed_mask.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
    around = inside(locate(depth, camera), workspace) & ~near & ~hand_region(hand_px[seed_frame], depth, camera, 1.4)
    heights = world_map(depth, camera)[..., 2][seed_mask]
    heights = heights[np.isfinite(heights)]
    top = float(np.percentile(heights, 90)) if len(heights) else 0.0
    ceilings = np.maximum(top + LIFT, np.zeros(len(hand_px)) if lifted is None else lifted)
    colours = colour_model(bins[core if core.any() else seed_mask])
    surroundings = colour_model(bins[around])
    alike = colours - surroundings > ALIKE
    return ObjectModel(
        object=colours,
        surroundings=surroundings,
        intruder=colour_model(_intruder_bins(images, depths, camera, hand_px, ceilings, alike)),
        height=top,
    )


def _intruder_bins(
    images: Sequence[np.ndarray],
    depths: Sequence[np.ndarray],
    camera: Camera,
    hand_px: np.ndarray,
    ceilings: np.ndarray,
    alike: np.ndarray,
) -> np.ndarray:
    """Colour bins [P] of what rises above `ceilings` [F] (m), and of the hand's bones except bins `alike` to the object."""
    samples = [np.zeros(0, np.int32)]
    for f in np.unique(np.linspace(0, len(hand_px) - 1, INTRUDER_SAMPLES).astype(int)):
        risen = (world_map(depths[f], camera)[..., 2] > ceilings[f]) & ~flying_pixels(depths[f], camera, EDGE)
        bins = lab_bins(images[f])
        samples.append(bins[risen | (hand_region(hand_px[f], depths[f], camera, 0.5) & ~alike[bins])])
    return np.concatenate(samples)


def segment_frame(
    image: np.ndarray,
    depth: np.ndarray,
    camera: Camera,
    hand_px: np.ndarray,
    workspace: np.ndarray,
    previous: np.ndarray,
    model: ObjectModel,
    params: SegmentParams,
    lifted: float = 0.0,
    missed: int = 0,
) -> np.ndarray:
    """The mask [H, W] bool of one frame, given the last one in which the object was seen; updates `model.mixtures`.

    `lifted` (m) as from `lifted_to`; `missed` counts the frames since the object was seen.
    """
    mask = np.zeros(depth.shape, bool)
    metres = min(REACH * (1 + missed), FARTHEST)
    reach = _pixels(metres, previous, depth, camera)
    margin = round(1.2 * reach) + 2 * RIM
    while True:
        window = window_around(previous, margin)
        given = image, depth, camera, hand_px, workspace, previous, model, params
        score, certain = object_score(*given, lifted, metres, window)
        near = _grown(previous[window], reach)
        parts, boxes = _parts_near(score > 0, near)
        if _lie_within(boxes, window, depth.shape):
            break
        margin *= 2
    fewest = previous.sum() * 0.02
    rough = _large(parts, boxes, fewest)
    if rough.any():
        refined = _grabcut(image[window], rough, score, certain & rough, model)
        mask[window] = _large(*_parts_near(refined, near), fewest)
    return mask


def _lie_within(boxes: np.ndarray, window: Window, shape: tuple[int, ...]) -> bool:
    """Whether boxes [N, 5] in a window lie clear of its rim, where that is not the image's."""
    left, top, width, height = boxes[boxes[:, 4] > 0, :4].T
    for axis, low, high in ((0, top, top + height), (1, left, left + width)):
        begin, end = window[axis].start, window[axis].stop
        if (begin > 0 and (low < RIM).any()) or (end < shape[axis] and (high > end - begin - RIM).any()):
            return False
    return True


def object_score(
    image: np.ndarray,
    depth: np.ndarray,
    camera: Camera,
    hand_px: np.ndarray,
    workspace: np.ndarray,
    previous: np.ndarray,
    model: ObjectModel,
    params: SegmentParams,
    lifted: float = 0.0,
    reach: float = REACH,
    window: Window = WHOLE,
) -> tuple[np.ndarray, np.ndarray]:
    """Evidence [H, W] float32 for the object, positive where it prevails: colour, height, hand and the last mask.

    Also where [H, W] bool it is certain, though the table may have the same colour. Of the window alone, in whose
    outermost pixels it is inexact.
    """
    import cv2

    hand = hand_region(hand_px, depth, camera)[window]
    pixels = _pixels(reach, previous, depth, camera)
    image, depth, previous = image[window], depth[window], previous[window]
    bins = lab_bins(image)
    height, standing = _height_score(depth, camera, model.height, max(model.height + LIFT, lifted), params, window)
    to_table, to_hand = model.object[bins] - model.surroundings[bins], model.object[bins] - model.intruder[bins]
    score = np.where(standing, to_hand, np.minimum(to_table, to_hand)).clip(-5, 5) + height
    certain = standing & ~hand & (to_table > TABLE_LIKE) & (to_hand > HAND_UNLIKE)
    score[hand] -= ON_HAND
    distance = cv2.distanceTransform((~previous).astype(np.uint8), cv2.DIST_L2, 3)
    score -= np.minimum(distance * (3 / pixels), 6)
    score = cv2.GaussianBlur(score.astype(np.float32), (3, 3), 0)
    score[~inside(locate(depth, camera, window), workspace)] = -10
    return score, certain & (score > 0)


def _height_score(
    depth: np.ndarray, camera: Camera, top: float, ceiling: float, params: SegmentParams, window: Window
) -> tuple[np.ndarray, np.ndarray]:
    """Evidence [H, W] from the height above the table, 0 where depth is missing or unsure; where it is no table."""
    z = world_map(depth, camera, window)[..., 2]
    score = np.zeros(depth.shape, np.float32)
    sure = (depth > 0) & ~flying_pixels(depth, camera, EDGE)
    standing = sure & (z > params.min_height) & (top > FLAT * params.min_height)
    score[standing & (z < top + params.min_height)] = 2
    if top > FLAT * params.min_height:
        score[sure & (z < params.min_height / 2)] = -3
    score[sure & (z > ceiling)] = -10
    return score, standing


def _pixels(metres: float, mask: np.ndarray, depth: np.ndarray, camera: Camera) -> float:
    """How many pixels a length at the mask's distance covers; at one metre where its depth is unknown."""
    window = window_around(mask, 0)
    mask, depth = mask[window], depth[window]
    readings = depth[mask & (depth > 0)]
    distance = np.median(readings) * camera.depth_scale if len(readings) else 1.0
    return max(1.0, metres * camera.K[0, 0] / distance)


def _grown(mask: np.ndarray, pixels: float) -> np.ndarray:
    import cv2

    return cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3) <= pixels


def _parts_near(mask: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The connected parts [H, W] of `mask` by number, and for each its box [N, 5]: left, top, width, height and area.

    Those that do not reach into `near`, and number 0, which is no part, have boxes of zeros.
    """
    import cv2

    _, parts, boxes, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    boxes[np.bincount(parts[near], minlength=len(boxes)) == 0] = 0
    boxes[0] = 0
    return parts, boxes


def _large(parts: np.ndarray, boxes: np.ndarray, fewest: float) -> np.ndarray:
    """Where [H, W] those of `_parts_near` are that are neither specks nor dwarfed by the largest."""
    area = boxes[:, 4]
    return (area >= max(fewest, area.max() * 0.04, 4))[parts]


def _grabcut(
    image: np.ndarray, rough: np.ndarray, score: np.ndarray, certain: np.ndarray, model: ObjectModel, margin: int = RIM
) -> np.ndarray:
    """Refine a rough mask inside its bounding box; what is certain, or the score is sure of, stays as it is."""
    import cv2

    crop = window_around(rough, margin)
    labels = np.where(rough, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)[crop]
    band = np.ones((BAND, BAND), np.uint8)
    deep = cv2.erode(rough[crop].astype(np.uint8), band) > 0
    away = cv2.dilate(rough[crop].astype(np.uint8), band) == 0
    labels[certain[crop] | (deep & (score[crop] > SURE_OBJECT))] = cv2.GC_FGD
    labels[(away & (score[crop] < SURE_OTHER)) | (score[crop] < EXCLUDED)] = cv2.GC_BGD
    counts = np.bincount(labels.ravel() % 2, minlength=2)  # GrabCut's odd labels are the object
    if counts.min() < FEWEST:
        return rough
    mixtures, steps, mode = np.zeros((2, 1, 65)), 3, cv2.GC_INIT_WITH_MASK
    if model.mixtures is not None:
        mixtures, steps, mode = model.mixtures.copy(), 1, cv2.GC_EVAL
    cv2.setRNGSeed(0)
    cv2.grabCut(np.ascontiguousarray(image[crop]), labels, (0, 0, 1, 1), mixtures[0], mixtures[1], steps, mode)
    refined = np.zeros_like(rough)
    refined[crop] = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    if (refined & rough).sum() < AGREEMENT * rough.sum():
        return rough
    model.mixtures = mixtures
    return refined
