"""Picks by hand: thumb and fingers that close on the object and lift a part of it."""

from collections.abc import Sequence

import numpy as np

THUMB, INDEX, MIDDLE, WRIST, KNUCKLE = 4, 8, 12, 0, 9
"""MediaPipe's numbers of the fingertips, the wrist and the middle finger's knuckle."""

TIPS, KNUCKLES = (THUMB, INDEX, MIDDLE), (5, 9, 13)
"""What pinches, and what of the hand is seen best meanwhile."""

CLEAREST = 3
"""One in so many frames of a pick tells where the fingertips are: those in which they are farthest from the knuckles, for
what is hidden is looked for on the hand."""

HALF_CLOSED = 0.345
"""Distance of thumb and fingertips over the palm's length that an open hand and a pinch are equally far from."""

SPREAD = 0.07
"""How far that ratio typically is from the one of its kind, in one frame."""

OPENS, CLOSES = 1.0, 2.0
"""What one frame tells at most of an open hand, and of a pinch, in `SPREAD`s: fingertips that hold something are hidden and
may look apart, those of an open hand hardly ever look closed."""

SWITCH = 2.0
"""What opening or closing must explain, in `SPREAD`s from `HALF_CLOSED`: a frame or two by themselves are errors."""

RISES = 0.008
"""Metres that what is under a pinching hand rises if the hand lifts it."""

SLIPS = 3
"""Frames that a hand may look open while what it lifted stays up, half as high or more: what it lets go of falls."""

CELL, HIGHER, MOVES = 0.01, 0.012, 20
"""Side (m) of the cells in which the object's top is looked at, by how much (m) that changes in one where the object moves,
and in how many cells: of cloths at rest in up to 14, of those that are picked in 15 to 250, mostly more than 20."""

LIFTS = 0.025
"""Metres that what is under a hand rises if the hand lifts it whose fingers are hidden for most of the pick."""

BENEATH = 0.03
"""Metres from the hand, seen from above, within which it lies."""


def openness(landmarks: np.ndarray) -> np.ndarray:
    """How far thumb and fingertips are apart, in lengths of the palm: [F] of landmarks [F, C, 21, 2] (px); NaN: unseen.

    The mean of index and middle finger, the median over cameras.
    """
    thumb = landmarks[:, :, THUMB, None]
    apart = np.linalg.norm(landmarks[:, :, [INDEX, MIDDLE]] - thumb, axis=-1).mean(-1)
    ratio = apart / np.linalg.norm(landmarks[:, :, WRIST] - landmarks[:, :, KNUCKLE], axis=-1)
    seen = np.isfinite(ratio).any(1)
    found = np.full(len(ratio), np.nan)
    found[seen] = np.nanmedian(ratio[seen], axis=1)
    return found


def pinches(apart: np.ndarray) -> np.ndarray:
    """Frames [F] bool in which the hand pinches, from its `openness` [F]: the likeliest course, of few changes.

    Source: Viterbi (1967), two states.
    """
    evidence = np.where(np.isfinite(apart), ((HALF_CLOSED - apart) / SPREAD).clip(-OPENS, CLOSES), 0.0)
    signed = np.array([-1.0, 1.0]) * evidence[:, None]
    score, came = np.zeros(2), np.zeros((len(apart), 2), np.int64)
    for f, gain in enumerate(signed):
        changed = score[::-1] - SWITCH
        came[f] = np.where(changed > score, [1, 0], [0, 1])
        score = np.maximum(score, changed) + gain
    course, state = np.zeros(len(apart), bool), int(score.argmax())
    for f in range(len(apart) - 1, -1, -1):
        course[f] = state
        state = came[f, state]
    return course


def picks(landmarks: np.ndarray, end_effector: np.ndarray, clouds: Sequence[np.ndarray], reach: float) -> np.ndarray:
    """Frames [F] bool in which a hand holds the object between thumb and fingers.

    It is open, closes within `reach` (m) of the object as seen from above, and lifts what is under it: a hand that pushes
    with closed fingers does not. `landmarks` [F, C, 21, 2] (px), `end_effector` [F, 3] (m), `clouds` [P, 3] (m), z up.
    """
    from scipy.ndimage import label

    closed, moving = pinches(openness(landmarks)), moves(clouds)
    runs, count = label(closed)
    holds, last, up = np.zeros_like(closed), -SLIPS - 2, np.inf
    tall = np.array([_height(tip, cloud) for tip, cloud in zip(end_effector, clouds, strict=True)])
    for n in range(1, count + 1):
        shut = np.flatnonzero(runs == n).tolist()
        heights = tall[shut][np.isfinite(tall[shut])]
        near = np.array([_gap(end_effector[f], clouds[f]) <= reach for f in shut])
        if not near[0] or near.mean() <= 0.5 or len(heights) == 0:
            continue
        first = _set_off(shut[0], moving)
        before = tall[first : shut[-1] + 1]
        before = before[np.isfinite(before)]
        rises = heights.max() - heights[0] >= RISES or before.max() - before[0] >= LIFTS
        half = (before[0] + before.max()) / 2
        half = half if heights[-1] >= half else np.inf
        frames = range(first, _laid_down(shut[-1], moving, tall, half) + 1)
        if shut[0] - last <= SLIPS + 1 and heights[0] >= up:  # it never opened
            holds[last : frames[-1] + 1], last = True, frames[-1]
        elif len(shut) > 1 and _came_open(landmarks, first, shut[0]) and rises:
            holds[frames], last, up = True, frames[-1], half
    return holds


def moves(clouds: Sequence[np.ndarray]) -> np.ndarray:
    """Frames [F] bool before which the object, of clouds [P, 3] (m, z up), moved: its top is higher or lower than it was.

    Only places are compared that both frames show: what an arm hides does not move.
    """
    tops = [_tops(cloud) for cloud in clouds]
    moved = np.zeros(len(clouds), bool)
    for f in range(1, len(clouds)):
        _, before, now = np.intersect1d(tops[f - 1][0], tops[f][0], assume_unique=True, return_indices=True)
        off = np.abs(tops[f][1][now] - tops[f - 1][1][before])
        moved[f] = np.count_nonzero(off > HIGHER) >= MOVES
    return moved


def _tops(cloud: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cells [K] that a cloud [P, 3] (m) has points in, numbered, and how high (m) it is in each [K]."""
    place = np.floor(cloud[:, :2] / CELL).astype(np.int64)
    cells, which = np.unique(place[:, 0] * 2**31 + place[:, 1], return_inverse=True)
    tops = np.full(len(cells), -np.inf)
    np.maximum.at(tops, which, cloud[:, 2])
    return cells, tops


def _set_off(shut: int, moving: np.ndarray) -> int:
    """The frame from which on the object was `moving` [F] until a hand was seen to be shut: it was held a frame earlier."""
    while shut > 0 and moving[shut]:
        shut -= 1
    return shut


def _laid_down(shut: int, moving: np.ndarray, tall: np.ndarray, up: float) -> int:
    """The last frame in which the object is still `moving` [F] after a hand was seen to be shut.

    What lies lower than `up` (m) under the hand, `tall` [F] (m, NaN: unknown), has fallen.
    """
    while shut + 1 < len(moving) and moving[shut + 1] and not tall[shut + 1] < up:
        shut += 1
    return shut


def _came_open(landmarks: np.ndarray, *firsts: int) -> bool:
    """Whether the hand was seen right before one of these frames, when it was still open."""
    return any(first > 0 and bool(np.isfinite(landmarks[first - 1]).any()) for first in firsts)


def _gap(tip: np.ndarray, cloud: np.ndarray) -> float:
    """How far (m) the hand [3] is from the cloud [P, 3] seen from above; infinite where there is none, NaN: no hand."""
    return float(np.linalg.norm(cloud[:, :2] - tip[:2], axis=1).min(initial=np.inf))


def _height(tip: np.ndarray, cloud: np.ndarray) -> float:
    """How high (m) the cloud [P, 3] reaches under the hand [3]; NaN where there is none."""
    under = np.linalg.norm(cloud[:, :2] - tip[:2], axis=1) <= BENEATH  # false where the hand is not known
    return float(np.percentile(cloud[under, 2], 90)) if under.any() else np.nan


def with_picks(touching: np.ndarray, holds: np.ndarray) -> np.ndarray:
    """Frames [F] bool in which the object is handled: `touching` [F] as pushes are found, and picks `holds` [F].

    What touches just before or after a pick is the open hand that comes for it or leaves it.
    """
    from scipy.ndimage import label

    runs, count = label(touching | holds)
    handled = touching.copy()
    for n in range(1, count + 1):
        run = runs == n
        if holds[run].any():
            handled[run] = holds[run]
    return handled


def held_points(keypoints: np.ndarray, end_effector: np.ndarray, holds: np.ndarray) -> np.ndarray:
    """The end-effector [F, 3] (m) with the point between thumb and fingertips while the hand holds something, `holds` [F].

    Fingertips are hidden then, by what they hold and by the hand itself: the knuckles carry that point through a pick, and
    it turns with them as seen from above. `keypoints` [F, 21, 3] (m), `end_effector` [F, 3] (m), NaN where unknown.
    """
    from scipy.ndimage import label

    found = end_effector.copy()
    knuckles = keypoints[:, KNUCKLES].mean(1)
    apart = keypoints[:, TIPS].mean(1) - knuckles
    ahead = (knuckles - keypoints[:, WRIST])[:, :2]
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    in_hand = np.column_stack([(apart[:, :2] * ahead).sum(1), (apart[:, :2] * aside).sum(1), apart[:, 2]])
    runs, count = label(holds)
    for n in range(1, count + 1):
        frames = np.flatnonzero((runs == n) & np.isfinite(in_hand).all(1))
        clear = frames[np.argsort(-np.linalg.norm(in_hand[frames], axis=1))[: max(2, len(frames) // CLEAREST)]]
        if len(clear) == 0:
            continue
        forth, side, up = np.median(in_hand[clear], axis=0)
        carried = knuckles + np.column_stack([forth * ahead + side * aside, np.full(len(found), up)])
        known = (runs == n) & np.isfinite(carried).all(1)
        found[known] = carried[known]
    return found
