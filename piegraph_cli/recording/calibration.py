"""Where the cameras are: poses of cameras and of a board that lies in one place or several, fitted together to its corners."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.boards import Board
from piegraph_cli.recording.bundle import Bundle, project, refine
from piegraph_cli.recording.checks import listed

FEWEST_CORNERS = 8
STILL = 1.5
"""Pixels (median) that corners may move before the board is taken to lie elsewhere."""
OFF = 2.0
"""Pixels that an image's corners are off all images' before it is left out: blurred, or cameras at different times."""
NEAREST, FARTHEST = 0.1, 5.0
"""Metres between which a camera can be from its board."""
WRONG_SIZE, DOUBTFUL_SIZE = 0.10, 0.04
"""Share by which depth may differ from the board's distance before the size of its squares is refused, and doubted."""
POSES_FOR_LENS, UNSURE = 3, 0.01
"""Places of the board that intrinsics need, and the deviation of focal lengths, as a share, that is too much."""
SLIPPED = 2.0, 4.0, 0.2
"""A corner so many pixels and times the image's median off is left out, if these are no more than this share."""
AMBIGUOUS = 1.3
"""A board seen from afar fits two poses: they are told apart where one fits so many times better."""


@dataclass(frozen=True)
class Sightings:
    """Corners of one board in the images of several cameras."""

    names: Sequence[str]
    """Of the cameras."""
    pixels: np.ndarray
    """[camera, instant, corner, 2] px, NaN where a corner is not found."""
    sequence: np.ndarray
    """[instant] which sequence it is of: between two of them the board may have moved unseen."""
    K: np.ndarray
    """[camera, 3, 3]."""
    distortion: np.ndarray
    """[camera, coefficient]."""

    @property
    def seen(self) -> np.ndarray:
        """[camera, instant, corner] bool."""
        return np.isfinite(self.pixels).all(-1)


@dataclass(frozen=True)
class Solution:
    """What fits all corners best. The world is the board's frame as it lay first."""

    T_world_camera: np.ndarray
    """[camera, 4, 4]."""
    T_world_board: np.ndarray
    """[place, 4, 4]; the first one is the identity."""
    place: np.ndarray
    """[instant] in which of the places the board lay; -1 where that is not known."""
    K: np.ndarray
    distortion: np.ndarray
    errors: np.ndarray
    """[camera, instant] mean px between corners found and projected; NaN where none is found."""
    used: np.ndarray
    """[camera, instant] bool: what the fit is from."""

    def error(self, camera: int) -> float:
        """Mean reprojection error (px) of the images of a camera that were used."""
        return float(self.errors[camera][self.used[camera]].mean())


def solve(seen: Sightings, board: Board, lenses: bool = False) -> Solution:
    """Poses of all cameras, and of the board in each of its places; with `lenses` intrinsics too.

    Images that disagree with most are left out. Raises `DataError` naming the camera where too few corners are found, no
    pose fits, cameras share no place of the board, it would be too near or too far, or images do not determine a lens.
    """
    for name, corners in zip(seen.names, seen.seen, strict=True):
        if corners.any(0).sum() < FEWEST_CORNERS:
            raise DataError(
                f"camera {name} sees {corners.any(0).sum()} corners of the board, {FEWEST_CORNERS} are needed",
                hint="check --columns, --rows and --dictionary, move the board closer, light it evenly",
            )
    place = places(seen)
    points = board.corners()
    start = _start(seen, place, points, lenses)
    rows = seen.seen.any(-1) & (start.place >= 0)
    rough = refine(start, seen.pixels, points, rows, lenses, robust=True)
    seen = _without_slips(seen, rough, points)
    errors = _errors(rough, seen, points)
    used = rows & (errors <= max(OFF, 2 * float(np.median(errors[rows]))))
    for c in np.flatnonzero(~used.any(1)).tolist():
        raise DataError(
            f"camera {seen.names[c]}: its images fit no pose with those of the others, {np.nanmedian(errors[c]):.0f} px off",
            hint="hold the board still, with all cameras on one clock; check K and distortion in cameras.json",
        )
    fit = refine(rough, seen.pixels, points, used, lenses)
    if lenses:
        _check_lenses(fit, seen, points, used)
    _check_distances(fit, seen, board, used)
    return Solution(
        fit.T_world_camera,
        fit.T_world_board,
        fit.place,
        fit.K,
        fit.distortion,
        _errors(fit, seen, points),
        used,
    )


def places(seen: Sightings) -> np.ndarray:
    """Which place [instant] the board lay in: instants in a row in which no camera sees it moved are one; -1 unseen."""
    place, first = np.full(len(seen.sequence), -1), dict[int, int]()
    here = -1
    for i in np.flatnonzero(seen.seen.any((0, 2))).tolist():
        begin = first.get(here)
        if begin is None or seen.sequence[begin] != seen.sequence[i] or not _still(seen, place, here, i):
            here += 1
            first[here] = i
        place[i] = here
    return place


def _still(seen: Sightings, place: np.ndarray, here: int, instant: int) -> bool:
    """Whether the board lies at an instant where it lay in a place, as far as one camera can tell."""
    shifts = []
    for pixels in seen.pixels:
        there = pixels[place == here]
        both = np.isfinite(there).all(-1) & np.isfinite(pixels[instant]).all(-1)
        known = both[both.sum(1) >= 4][:1]
        if len(known):
            row = there[np.argmax(both.sum(1) >= 4)]
            shifts.append(float(np.median(np.linalg.norm(row - pixels[instant], axis=-1)[known[0]])))
    return bool(shifts) and max(shifts) < STILL


def _start(seen: Sightings, place: np.ndarray, points: np.ndarray, lenses: bool) -> Bundle:
    """First poses: the board's in each camera and place, joined from camera to camera over what they both see best."""
    cameras, count = len(seen.names), place.max() + 1
    lens = [_lens(seen, c, place, points, lenses) for c in range(cameras)]
    links: dict[tuple[int, int], tuple[float, np.ndarray]] = {}
    for c in range(cameras):
        for p in range(count):
            link = board_pose(_average(seen.pixels[c, place == p]), points, *lens[c])
            if link is not None:
                links[c, p] = link
        if not any(key[0] == c for key in links):
            raise DataError(
                f"camera {seen.names[c]}: no pose fits the {seen.seen[c].any(0).sum()} corners seen of the board",
                hint="show more of the board, and hold it still; check K and distortion in cameras.json",
            )
    origin = min(p for _, p in links)
    board, camera = {origin: np.eye(4)}, dict[int, np.ndarray]()
    while True:
        open_links = [(doubt, key) for key, (doubt, _) in links.items() if (key[0] in camera) != (key[1] in board)]
        if not open_links:
            break
        _, (c, p) = min(open_links)
        T_camera_board = links[c, p][1]
        if c in camera:
            board[p] = camera[c] @ T_camera_board
        else:
            camera[c] = board[p] @ np.linalg.inv(T_camera_board)
    _check_joined(seen, links, set(camera))
    known = sorted(board)
    number = np.full(count + 1, -1)
    number[known] = np.arange(len(known))
    return Bundle(
        np.array([camera[c] for c in range(cameras)]),
        np.array([board[p] for p in known]),
        number[place],
        np.array([K for K, _ in lens]),
        np.array([distortion for _, distortion in lens]),
    )


def _check_joined(seen: Sightings, links: dict[tuple[int, int], tuple[float, np.ndarray]], joined: set[int]) -> None:
    apart = [c for c in range(len(seen.names)) if c not in joined]
    if apart:
        them, others = (listed([seen.names[c] for c in group]) for group in (apart, sorted(joined)))
        raise DataError(
            f"{them} shared no place of the board with {others}",
            hint=f"hold it still where {seen.names[apart[0]]} and one of {others} see it at once; give all by --sequence",
        )


def _average(pixels: np.ndarray) -> np.ndarray:
    """The mean over images [image, corner, 2] of each corner [corner, 2]; NaN where it is in none."""
    known = np.isfinite(pixels)
    with np.errstate(invalid="ignore"):
        return np.where(known, pixels, 0).sum(0) / known.sum(0)


def board_pose(
    pixels: np.ndarray, points: np.ndarray, K: np.ndarray, distortion: np.ndarray
) -> tuple[float, np.ndarray] | None:
    """How doubtful it is, and `T_camera_board` [4, 4], from corners [N, 2] (px); None where there are too few."""
    import cv2

    known = np.isfinite(pixels).all(-1)
    spread = points[known] - points[known].mean(0) if known.any() else points[:0]
    size = np.linalg.svd(spread, compute_uv=False) if known.sum() >= FEWEST_CORNERS else np.zeros(3)
    if size[1] <= 0.02 * size[0] or size[0] == 0:
        return None  # all in a row
    count, turns, shifts, errors = cv2.solvePnPGeneric(
        points[known], pixels[known], K, distortion, flags=cv2.SOLVEPNP_IPPE
    )
    if not count:
        return None
    errors = np.ravel(errors)
    unsure = count > 1 and errors[1] < AMBIGUOUS * errors[0]
    # a pose that is one of two is used last, and then the better one
    doubt = 1 / size[1] + (1e6 if unsure else 0) + (1e3 * float(errors[0]) if errors[0] > OFF else 0)
    turn, shift = cv2.solvePnPRefineLM(points[known], pixels[known], K, distortion, turns[0], shifts[0])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(shift)
    return doubt, T


def _lens(
    seen: Sightings, c: int, place: np.ndarray, points: np.ndarray, lenses: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Intrinsics to begin with: those given or, where they are asked for, what one camera's images alone say."""
    import cv2

    K, distortion = seen.K[c], seen.distortion[c]
    if not lenses:
        return K, distortion
    views = [_average(seen.pixels[c, place == p]) for p in range(place.max() + 1)]
    views = [view for view in views if np.isfinite(view).all(-1).sum() >= FEWEST_CORNERS]
    if len(views) < POSES_FOR_LENS:
        raise DataError(
            f"camera {seen.names[c]} sees {len(views)} places of the board, {POSES_FOR_LENS} are needed for --intrinsics",
            hint="hold the board tilted in ten places, near and far, all over the image, each for a moment",
        )
    known = [np.isfinite(view).all(-1) for view in views]
    size = (int(2 * K[0, 2]), int(2 * K[1, 2]))
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_PRINCIPAL_POINT
    if len(distortion) > 5:
        return K, distortion  # OpenCV would take the longer models as free
    _, K, distortion, _, _ = cv2.calibrateCamera(
        [points[k].astype(np.float32) for k in known],
        [view[k].astype(np.float32) for view, k in zip(views, known, strict=True)],
        size,
        K.copy(),
        distortion.copy(),
        flags=flags,
    )
    return K, np.ravel(distortion)[: seen.distortion.shape[1]]


def _errors(fit: Bundle, seen: Sightings, points: np.ndarray) -> np.ndarray:
    """Mean distance [camera, instant] (px) of corners found from where they are projected; NaN where none is found."""
    errors = np.full(seen.pixels.shape[:2], np.nan)
    for c, i in np.argwhere(seen.seen.any(-1) & (fit.place >= 0)):
        off = np.linalg.norm(project(fit, points, c, fit.place[i]) - seen.pixels[c, i], axis=-1)
        errors[c, i] = np.nanmean(off)
    return errors


def _without_slips(seen: Sightings, fit: Bundle, points: np.ndarray) -> Sightings:
    """Without corners that are much further off than most of their image: found in the wrong place."""
    pixels = seen.pixels.copy()
    for c, i in np.argwhere(seen.seen.any(-1) & (fit.place >= 0)):
        off = np.linalg.norm(project(fit, points, c, fit.place[i]) - pixels[c, i], axis=-1)
        slipped = off > max(SLIPPED[0], SLIPPED[1] * float(np.nanmedian(off)))
        if slipped.sum() <= SLIPPED[2] * np.isfinite(off).sum():
            pixels[c, i][slipped] = np.nan
    return replace(seen, pixels=pixels)


def _check_lenses(fit: Bundle, seen: Sightings, points: np.ndarray, used: np.ndarray) -> None:
    """Refuse lenses that the images do not determine."""
    deviation = fit.deviation(seen.pixels, points, used)
    for c, share in enumerate(deviation):
        if not share < UNSURE:
            raise DataError(
                f"camera {seen.names[c]}: these images leave its focal length open by {share:.1%}",
                hint="hold the board tilted, each time in another direction, near and far, all over the image",
            )


def _check_distances(fit: Bundle, seen: Sightings, board: Board, used: np.ndarray) -> None:
    for c, name in enumerate(seen.names):
        first = fit.T_world_board[fit.place[np.argmax(used[c])]]
        distance = float(np.linalg.norm(fit.T_world_camera[c][:3, 3] - first[:3, 3]))
        if not NEAREST <= distance <= FARTHEST:
            in_mm = f"; {board.square:g} mm would put it {distance / 1000:.2f} m away" if distance > FARTHEST else ""
            raise DataError(
                f"camera {name} would be {distance:.3g} m from a board with squares of {board.square:g} m{in_mm}",
                hint="give --square and --marker in metres, as 0.04 and 0.03",
            )


def depth_factor(
    found: Solution, seen: Sightings, camera: int, depths: dict[int, np.ndarray], scale: float, board: Board
) -> float:
    """How many times as far as its squares say the board is, by depth images [H, W] in units of `scale` (m), by instant.

    NaN where too few corners have depth.
    """
    T_camera_world = np.linalg.inv(found.T_world_camera[camera])
    values = [np.zeros(0)]
    for i, depth in depths.items():
        T = T_camera_world @ found.T_world_board[found.place[i]]
        expected = board.corners() @ T[2, :3] + T[2, 3]
        pixels = seen.pixels[camera, i]
        known = np.flatnonzero(np.isfinite(pixels).all(-1))
        columns, rows = np.rint(pixels[known]).astype(int).T
        inside = (columns >= 0) & (columns < depth.shape[1]) & (rows >= 0) & (rows < depth.shape[0])
        readings = depth[rows[inside], columns[inside]]
        values.append((readings * scale / expected[known[inside]])[readings > 0])
    factors = np.concatenate(values)
    return float(np.median(factors)) if len(factors) >= FEWEST_CORNERS else float("nan")


def check_size(factor: float, board: Board, name: str) -> str:
    """A warning, or none, by `depth_factor`. Raises `DataError` where squares or depth have another size than said."""
    off = abs(factor - 1)
    if not off > DOUBTFUL_SIZE:
        return ""
    message = f"camera {name}: by its depth images the board is {factor:.4g} times as far as its squares say"
    if off > WRONG_SIZE:
        raise DataError(
            f"{message}: are they {board.square:g} m?",
            hint=f"squares of {board.square * factor:.4g} m would fit; otherwise correct depth_scale in cameras.json",
        )
    return message
