"""Whether an end-effector that others measured is where the cameras see something move: its clock, units and frame."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from piegraph_cli.recording.camera import Camera

WIDTH, MOST = 160, 150
"""Depth images are looked at so wide, pixels, and so many of them."""
NEARER = 0.012
"""Metres by which what moves is nearer than the still scene."""
REACH, BESIDE = 2, 0.03
"""Pixels and metres from the tip within which something has to be there."""
MOVES, FEWEST = 0.02, 8
"""Speed (m/s) from which a tip moves, and frames in which it has to."""
STILL = 0.01
"""Metres: a tip that moves less was not moved."""
LATEST, STEP = 3.0, 0.1
"""Seconds by which clocks are tried, and how finely."""
SEEN, GAIN, ABSENT = 0.6, 0.15, 0.5
"""Shares of the frames: a clock that fits has so many, so many more than the one given; fewer than the last are no tip's.

On the sample the hand's tip has 0.81 to 0.93, 0.4 s aside at most 0.60, exchanged or mirrored axes at most 0.5.
"""

Change = Callable[[np.ndarray], np.ndarray]
HEIGHTS = (-0.3, -0.25, -0.2, -0.15, -0.12, -0.09, -0.06, 0.06, 0.09, 0.12, 0.15, 0.2, 0.25, 0.3)
"""Metres by which a tip may be too high or too low."""


def _lifted(by: float) -> Change:
    return lambda place: place + np.array([0, 0, by])


CHANGES: dict[str, Change] = {
    **{f"{abs(by) * 100:.0f} cm {'lower' if by < 0 else 'higher'}": _lifted(by) for by in HEIGHTS},
    "with x and y exchanged": lambda place: place[:, [1, 0, 2]],
    "with x turned over": lambda place: place * [-1, 1, 1],
    "with y turned over": lambda place: place * [1, -1, 1],
    "with x and y turned over": lambda place: place * [-1, -1, 1],
    "turned by 90 degrees": lambda place: place[:, [1, 0, 2]] * [-1, 1, 1],
    "turned by -90 degrees": lambda place: place[:, [1, 0, 2]] * [1, -1, 1],
    "with y and z turned over": lambda place: place * [1, -1, -1],
}
"""Other frames of reference of a tip [T, 3] (m), by what they are called."""

PLACE = "move a robot's path by T_world_robot; say with ingest.tool_point where the tip is"


def check_tip(
    tips: np.ndarray, times: np.ndarray, cameras: Sequence[Camera], depth: Sequence[Sequence[np.ndarray]]
) -> list[str]:
    """A warning where tips [F, 3] (m, world) at times [F] (s) are not where depth images [C][F] see something move."""
    frames = np.unique(np.linspace(0, len(times) - 1, min(MOST, len(times))).round().astype(int))
    looks = [
        (camera, *_near(camera, (images[int(f)] for f in frames)))
        for camera, images in zip(cameras, depth, strict=True)
    ]
    known = np.isfinite(tips).all(1)
    if known.sum() < FEWEST:
        return []
    if np.ptp(tips[known], axis=0).max() < STILL:
        return [f"the end-effector never moves by more than {STILL * 1000:g} mm"]

    def seen(late: float, change: Change = lambda place: place) -> float:
        at = times[frames] + late
        places, after = (
            np.stack([np.interp(t, times[known], axis, np.nan, np.nan) for axis in change(tips[known]).T], 1)
            for t in (at, at + STEP)
        )
        moves = np.linalg.norm(after - places, axis=1) > MOVES * STEP
        return _share(np.where(moves[:, None], places, np.nan), looks)

    given = seen(0.0)
    tried = np.arange(-round(LATEST / STEP), round(LATEST / STEP) + 1) * STEP
    shares = np.array([seen(late) for late in tried])
    if not np.isfinite(given) and not np.isfinite(shares).any():
        return [f"no camera sees the places where the end-effector moves\n  try: {PLACE}"]
    best = int(np.nanargmax(shares))
    late, share = float(tried[best]), float(shares[best])
    elsewhere = {name: seen(0.0, change) for name, change in CHANGES.items()}
    name = max(elsewhere, key=lambda name: np.nan_to_num(elsewhere[name]))
    if elsewhere[name] > max(share, SEEN, np.nan_to_num(given) + GAIN):
        return [
            f"at the end-effector's place something moves in {np.nan_to_num(given):.0%} of the frames, in "
            f"{elsewhere[name]:.0%} were it {name}: is it the tip, in the cameras' world?\n  try: {PLACE}"
        ]
    return _judged(float(np.nan_to_num(given)), share, late)


def _judged(given: float, share: float, late: float) -> list[str]:
    """A word on a tip that is where something moves in a share of the frames, and with a clock so late (s) in another."""
    told = f"at the end-effector's place something moves in {given:.0%} of the frames"
    if share > SEEN and share > given + GAIN:
        way = "ahead of" if late > 0 else "behind"
        return [
            f"{told}, in {share:.0%} were its clock not {abs(late):.1f} s {way} the cameras'\n"
            f"  try: {'subtract' if late > 0 else 'add'} {abs(late):.1f} s {'from' if late > 0 else 'to'} its times"
        ]
    if given < ABSENT:
        return [f"{told} only: is it the tip, in the cameras' world, in metres and on their clock?\n  try: {PLACE}"]
    return []


def _near(camera: Camera, images: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Depth [F, H', W'] (m), `WIDTH` wide, and what of it is nearer than the still scene."""
    import cv2

    size = WIDTH, max(1, round(WIDTH * camera.height / camera.width))
    small = [cv2.resize(image, size, interpolation=cv2.INTER_NEAREST) for image in images]
    depth = np.stack(small).astype(np.float32) * np.float32(camera.depth_scale)
    depth[depth == 0] = np.nan
    still = np.full(depth.shape[1:], np.nan, np.float32)
    known = np.isfinite(depth).any(0)
    still[known] = np.nanmedian(depth[:, known], axis=0)
    return depth, still - depth > NEARER


def _share(places: np.ndarray, looks: Sequence[tuple[Camera, np.ndarray, np.ndarray]]) -> float:
    """In what share of the frames something that moves is at places [F, 3] (m), the mean over the cameras that see them."""
    hits, views = np.zeros(len(places)), np.zeros(len(places))
    known = np.isfinite(places).all(1)
    for camera, depth, near in looks:
        pixels, z = camera.project(np.where(known[:, None], places, 0.0))
        rows, columns = depth.shape[1:]
        for frame in np.flatnonzero(known & (z > 0)):
            column, row = (pixels[frame] * columns / camera.width).round().astype(int)
            if 0 <= row < rows and 0 <= column < columns:
                around = np.s_[
                    frame, max(row - REACH, 0) : row + REACH + 1, max(column - REACH, 0) : column + REACH + 1
                ]
                views[frame] += 1
                hits[frame] += (near[around] & (np.abs(depth[around] - z[frame]) < BESIDE)).any()
    return float((hits[views > 0] / views[views > 0]).mean()) if (views > 0).sum() >= FEWEST else np.nan
