"""The hand: landmarks per camera (MediaPipe), and their merge over cameras and time into world keypoints.

Landmark numbering is MediaPipe's: 0 wrist, 4 thumb tip, 8 index tip, 12 middle tip, 16 ring tip, 20 little finger tip.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from piegraph_cli.errors import MissingError
from piegraph_cli.process import quiet_native
from piegraph_cli.recording.camera import Camera

if TYPE_CHECKING:
    import mediapipe as mp
    from mediapipe.tasks.python.vision import HandLandmarkerResult

LANDMARKS = 21
PUSHING_TIPS = (8, 12)
PALM = (0, 5, 9, 13, 17)

ATTEMPTS = 2
"""A hand that moved too far to be tracked is lost in the first attempt and searched for anew only in the next."""
CONFIDENCE = 0.3
"""What MediaPipe must be sure of; low, since the cameras check each other."""
FLESH = np.full(LANDMARKS, 0.009)
"""Depth (m) of each landmark below the skin that a depth camera sees."""
FLESH[0] = 0.018
FLESH[[4, 8, 12, 16, 20]] = 0.007

REACH = 0.13
"""Farthest (m) a landmark's depth may lie from the palm's: beyond it the camera looked past the hand."""
TABLE_MARGIN = 0.004
"""A landmark whose surface point is lower (m) than this above the table plane saw the table."""
RAY_SIGMA, DEPTH_SIGMA = 0.012, 0.012
"""Expected error (m) of a landmark across and along its viewing ray."""
CONSENSUS = 3.0
"""Errors above this many sigmas count as disagreement between cameras."""


@dataclass(frozen=True)
class HandTrack:
    """One hand followed through a sequence by all cameras."""

    keypoints: np.ndarray
    """[F, 21, 3] world positions (m), NaN where unknown."""
    pixels: np.ndarray
    """[F, C, 21, 2] (column, row): as detected, else `keypoints` projected into the camera, else NaN."""
    seen: np.ndarray
    """[F, C] bool: the camera detected the hand in this frame."""
    observed: np.ndarray
    """[F] bool: the keypoints are measured in this frame, neither filled from its neighbours nor unknown."""
    spread: np.ndarray
    """[F] median distance (m) of the cameras' viewing rays to the merged keypoints, NaN where not observed."""
    deep: np.ndarray
    """[F, C] share of the landmarks that have a plausible depth in a camera that saw the hand, NaN where it did not."""


def detect_hands(
    images: Iterable[np.ndarray], times: np.ndarray, model_path: Path, hands: int
) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks of up to N = `hands` hands of one camera: pixels [F, N, 21, 2] (column, row; NaN where unseen), score [F, N].

    `images` are RGB uint8 [H, W, 3] in order of `times` [F] (s). One hand is followed from frame to frame; several come in
    no lasting order. A score is 0 where no hand is seen. Raises MissingError where the model file is missing or unreadable.
    Source: paper, section III-D (MediaPipe Hands).
    """
    landmarks = np.full((len(times), hands, LANDMARKS, 2), np.nan)
    score = np.zeros((len(times), hands))
    stamp, seen = -1, False
    with _hand_landmarker(model_path, hands, "VIDEO") as landmarker:
        for f, image in enumerate(images):
            for _ in range(ATTEMPTS if seen else 1):
                stamp = max(stamp + 1, round((times[f] - times[0]) * 1000))
                with quiet_native() if f == 0 else nullcontext():
                    result = landmarker.detect_for_video(_frame(image), stamp)
                if result.hand_landmarks:
                    break
            seen = bool(result.hand_landmarks)
            _keep(result, image, landmarks[f], score[f])
    return landmarks, score


def find_hands(images: Iterable[np.ndarray], model_path: Path, hands: int) -> tuple[np.ndarray, np.ndarray]:
    """As `detect_hands`, of images [H, W, 3] that have nothing to do with each other."""
    landmarks, score = [], []
    with _hand_landmarker(model_path, hands, "IMAGE") as landmarker, quiet_native():
        for image in images:
            landmarks.append(np.full((hands, LANDMARKS, 2), np.nan))
            score.append(np.zeros(hands))
            _keep(landmarker.detect(_frame(image)), image, landmarks[-1], score[-1])
    return np.array(landmarks), np.array(score)


def _frame(image: np.ndarray) -> "mp.Image":
    import mediapipe as mp

    return mp.Image(image_format=mp.ImageFormat.SRGB, data=np.ascontiguousarray(image))


def _keep(result: "HandLandmarkerResult", image: np.ndarray, landmarks: np.ndarray, score: np.ndarray) -> None:
    """Write what was detected in an image into `landmarks` [N, 21, 2] and `score` [N]."""
    height, width = image.shape[:2]
    for n, points in enumerate(result.hand_landmarks):
        landmarks[n] = [(p.x * width - 0.5, p.y * height - 0.5) for p in points]
        score[n] = result.handedness[n][0].score


@contextmanager
def _hand_landmarker(model_path: Path, hands: int, mode: str) -> Iterator:
    from mediapipe.tasks.python import BaseOptions, vision

    hint = "run `piegraph doctor --fetch hand-landmarker`"
    if not model_path.is_file():
        raise MissingError("the hand landmark model is missing", str(model_path), hint)
    options = vision.HandLandmarkerOptions(
        base_options=BaseOptions(model_asset_buffer=model_path.read_bytes()),
        running_mode=vision.RunningMode[mode],
        num_hands=hands,
        min_hand_detection_confidence=CONFIDENCE,
        min_hand_presence_confidence=CONFIDENCE,
        min_tracking_confidence=CONFIDENCE,
    )
    try:
        with quiet_native():
            landmarker = vision.HandLandmarker.create_from_options(options)
    except (RuntimeError, ValueError) as error:
        raise MissingError(f"the hand landmark model cannot be loaded: {error}", str(model_path), hint) from None
    with landmarker:
        yield landmarker


def lift_hands(
    landmarks_px: np.ndarray,
    depth: Callable[[int, int], np.ndarray],
    cameras: Sequence[Camera],
    times: np.ndarray,
    max_gap: float = 0.5,
    max_speed: float = 1.5,
) -> HandTrack:
    """Merge the cameras' landmarks [F, C, 21, 2] (px, NaN where unseen) and depth into one hand in the world frame.

    `depth(frame, camera)` gives that depth image, [H, W] in units of the camera's depth scale, 0 = no reading; it is
    asked only for frames in which that camera saw the hand. `times` [F] in s. Landmarks that would have to move
    faster than `max_speed` (m/s) are dropped; gaps up to `max_gap` (s) between known positions are interpolated.
    A hand never seen gives NaN keypoints and no observed frame, not an error.
    """
    seen = np.isfinite(landmarks_px).all(axis=(2, 3))
    origins = np.array([camera.T_world_camera[:3, 3] for camera in cameras])
    rays, points = np.full((2, *landmarks_px.shape[:3], 3), np.nan)
    for f, c in np.argwhere(seen):
        rays[f, c], points[f, c] = lift(landmarks_px[f, c], depth(f, c), cameras[c])
    measured = merge_rays(origins, rays, points)
    for k in range(LANDMARKS):
        measured[~slow_chain(measured[:, k], times, max_speed), k] = np.nan
    observed = np.isfinite(measured).all(axis=2).mean(axis=1) >= 0.5
    keypoints = fill_gaps(np.where(observed[:, None, None], measured, np.nan), times, max_gap)
    across = _across(measured[:, None] - origins[:, None], rays)
    spread = np.full(len(times), np.nan)
    for f in np.flatnonzero(observed):
        spread[f] = np.nanmedian(np.linalg.norm(across[f], axis=-1))
    pixels = _complete_pixels(landmarks_px, keypoints, seen, cameras)
    deep = np.where(seen, np.isfinite(points).all(axis=3).mean(axis=2), np.nan)
    return HandTrack(keypoints, pixels, seen, observed, spread, deep)


def lift(pixels: np.ndarray, depth: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Unit world rays and points [21, 3] of one camera's landmarks; points are NaN where depth looks wrong."""
    rays = camera.rays(pixels) @ camera.T_world_camera[:3, :3].T
    length = np.linalg.norm(rays, axis=1, keepdims=True)
    surface = _patch_depth(pixels, depth) * camera.depth_scale
    palm = np.nanmedian(surface[list(PALM)]) if np.isfinite(surface[list(PALM)]).any() else np.nan
    surface[~(np.abs(surface - palm) < REACH)] = np.nan
    points = rays * surface[:, None] + camera.T_world_camera[:3, 3]
    points[~(points[:, 2] > TABLE_MARGIN)] = np.nan
    rays = rays / length
    return rays, points + rays * FLESH[:, None]


def _patch_depth(pixels: np.ndarray, depth: np.ndarray, radius: int = 2) -> np.ndarray:
    """Median of the non-zero depths around each pixel [N, 2]; NaN where there is none or outside the image."""
    height, width = depth.shape
    step = np.arange(-radius, radius + 1)
    columns = np.round(pixels[:, 0]).astype(int)[:, None, None] + step[None, None, :]
    rows = np.round(pixels[:, 1]).astype(int)[:, None, None] + step[None, :, None]
    columns, rows = np.broadcast_arrays(columns, rows)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    patch = np.where(inside, depth[rows.clip(0, height - 1), columns.clip(0, width - 1)], 0).reshape(len(pixels), -1)
    patch, count = np.sort(patch.astype(float), axis=1), (patch > 0).sum(axis=1)
    first, each = patch.shape[1] - count, np.arange(len(patch))  # the zeros come first
    middle = patch[each, first + (count - 1) // 2], patch[each, np.minimum(first + count // 2, patch.shape[1] - 1)]
    return np.where(count >= 3, (middle[0] + middle[1]) / 2, np.nan)


def merge_rays(origins: np.ndarray, rays: np.ndarray, points: np.ndarray, iterations: int = 8) -> np.ndarray:
    """The positions [F, N, 3] (m) on which most cameras agree; NaN with neither one depth nor two agreeing rays.

    `origins` [C, 3] (m) camera centres, `rays` [F, C, N, 3] unit viewing directions, `points` [F, C, N, 3] (m) what
    each camera's own depth says, both NaN where unknown. Weighted least squares of the distances across the rays and,
    where depth is known, along them, started from the best of all depth points and ray intersections; the weight of a
    camera that disagrees fades.
    """
    candidates = [points[:, c] for c in range(len(origins))]
    for a, b in combinations(range(len(origins)), 2):
        candidates.append(_intersection(origins[a], rays[:, a], origins[b], rays[:, b]))
    best = np.full(rays[:, 0].shape, np.nan)
    best_cost = np.full(best.shape[:2], np.inf)
    for candidate in candidates:
        cost = np.minimum(np.stack(_errors(candidate, origins, rays, points)), CONSENSUS**2).sum(axis=(0, 2))
        better = np.isfinite(candidate).all(axis=-1) & (cost < best_cost)
        best[better], best_cost[better] = candidate[better], cost[better]
    for _ in range(iterations):
        best = _reweighted_step(best, origins, rays, points)
    return best


def _across(offset: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """The part of `offset` [..., 3] at right angles to unit `rays` [..., 3]."""
    return offset - (offset * rays).sum(axis=-1, keepdims=True) * rays


def _errors(x: np.ndarray, origins: np.ndarray, rays: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared errors [F, C, N] in sigmas of x [F, N, 3] across and along every ray; infinite where unknown."""
    across = _across(x[:, None] - origins[:, None], rays)
    along = ((x[:, None] - points) * rays).sum(axis=-1)
    across, along = (across**2).sum(axis=-1) / RAY_SIGMA**2, along**2 / DEPTH_SIGMA**2
    return np.where(np.isfinite(across), across, np.inf), np.where(np.isfinite(along), along, np.inf)


def _intersection(origin_a: np.ndarray, rays_a: np.ndarray, origin_b: np.ndarray, rays_b: np.ndarray) -> np.ndarray:
    """Midpoint [F, N, 3] of the shortest link between two cameras' rays; NaN where they miss or run near parallel."""
    baseline = origin_b - origin_a
    cosine = (rays_a * rays_b).sum(axis=-1)
    sine2 = np.where(1 - cosine**2 > 0.03, 1 - cosine**2, np.nan)
    to_a, to_b = rays_a @ baseline, rays_b @ baseline
    on_a = origin_a + ((to_a - cosine * to_b) / sine2)[..., None] * rays_a
    on_b = origin_b + ((cosine * to_a - to_b) / sine2)[..., None] * rays_b
    apart = np.linalg.norm(on_a - on_b, axis=-1, keepdims=True)
    return np.where(apart < CONSENSUS * 2 * RAY_SIGMA, (on_a + on_b) / 2, np.nan)


def _reweighted_step(x: np.ndarray, origins: np.ndarray, rays: np.ndarray, points: np.ndarray) -> np.ndarray:
    across, along = _errors(x, origins, rays, points)
    w_across = 1 / (1 + across) ** 2 / RAY_SIGMA**2
    w_along = 1 / (1 + along) ** 2 / DEPTH_SIGMA**2
    rays, anchor = np.nan_to_num(rays), np.nan_to_num(np.where(np.isfinite(points), points, origins[:, None]))
    outer = rays[..., :, None] * rays[..., None, :]
    information = w_across[..., None, None] * (np.eye(3) - outer) + w_along[..., None, None] * outer
    total = information.sum(axis=1) + 1e-3 * np.eye(3)
    pull = (information @ (anchor - x[:, None])[..., None]).sum(axis=1)
    return x + np.linalg.solve(total, pull)[..., 0]


def slow_chain(positions: np.ndarray, times: np.ndarray, max_speed: float) -> np.ndarray:
    """The largest set of frames [F] bool whose positions [F, 3] can be visited one after another within `max_speed`."""
    known = np.flatnonzero(np.isfinite(positions).all(axis=1))
    length = np.ones(len(known), int)
    before = np.full(len(known), -1)
    for n in range(1, len(known)):
        i, j = known[:n], known[n]
        distance = np.linalg.norm(positions[j] - positions[i], axis=1)
        reachable = np.flatnonzero(distance <= max_speed * (times[j] - times[i]))
        if len(reachable):
            before[n] = reachable[np.argmax(length[reachable])]
            length[n] = length[before[n]] + 1
    keep = np.zeros(len(positions), bool)
    n = int(np.argmax(length)) if len(known) else -1
    while n >= 0:
        keep[known[n]] = True
        n = before[n]
    return keep


def fill_gaps(keypoints: np.ndarray, times: np.ndarray, max_gap: float) -> np.ndarray:
    """Interpolate NaN positions of [F, N, 3] linearly in time where both neighbours are at most `max_gap` (s) apart."""
    filled = keypoints.copy()
    times = np.asarray(times, float)
    for k in range(keypoints.shape[1]):
        known = np.flatnonzero(np.isfinite(keypoints[:, k]).all(axis=1))
        for i, j in pairwise(known):
            if j > i + 1 and times[j] - times[i] <= max_gap:
                share = ((times[i + 1 : j] - times[i]) / (times[j] - times[i]))[:, None]
                filled[i + 1 : j, k] = (1 - share) * keypoints[i, k] + share * keypoints[j, k]
    return filled


def _complete_pixels(
    landmarks_px: np.ndarray, keypoints: np.ndarray, seen: np.ndarray, cameras: Sequence[Camera]
) -> np.ndarray:
    pixels = np.where(seen[..., None, None], landmarks_px, np.nan)
    for c, camera in enumerate(cameras):
        known = np.isfinite(keypoints).all(axis=-1) & ~seen[:, c, None]
        projected, distance = camera.project(keypoints[known])
        pixels[:, c][known] = np.where(distance[:, None] > 0, projected, np.nan)
    return pixels


def end_effector(keypoints: np.ndarray) -> np.ndarray:
    """The point that pushes, [F, 3] (m): the centre between the index and the middle finger tip; NaN where unknown."""
    return keypoints[:, PUSHING_TIPS].mean(axis=1)
