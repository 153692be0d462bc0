"""A recording of a sheet, frame by frame: pictures in, and what `tracking` tells of every frame."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import cv2
import numpy as np
from scipy.spatial import cKDTree

from piegraph_cli.physics.follower import FEWEST_POINTS, Found
from piegraph_cli.physics.params import TrackParams
from piegraph_cli.physics.sheet import Hand, SheetFollower, State
from piegraph_cli.physics.sheet_images import Lens, Shot
from piegraph_cli.physics.sheet_mesh import is_sheet, sheet_mesh
from piegraph_cli.physics.visibility import View
from piegraph_cli.recording.colour import colour_model, lab_bins, pixel_bins, softened

LOST = 0.03
"""Metres of misfit beyond the first frame's, from which the sheet is not where it was looked for."""
SEEN = 1.0
"""Pixels that show a node, by their weights, from which it is seen."""
SPARSE = 20
"""Every how many points of a cloud tell in which part of the images the object is."""
THINNED = 800
"""Points of a cloud that are compared with the nodes."""


def taken_for_sheet(cloud: np.ndarray, views: Sequence[View], params: TrackParams) -> bool:
    """Whether an object is followed as a sheet: its first cloud [P, 3] (m) is one, and there are colour images of it."""
    if params.object == "solid" or not views or any(view.image is None for view in views):
        return False
    return params.object == "sheet" or (params.association == "soft" and is_sheet(cloud))


class SheetTracker:
    """One sheet on its way, from the first images of it on."""

    def __init__(self, cloud: np.ndarray, views: Sequence[View], particles: int):
        """`cloud` [P, 3] (m) of the sheet at first; so many of its points, or more, are told of.

        Raises `DataError` for a cloud that is no surface.
        """
        self.mesh, self.colours = sheet_mesh(cloud, particles), [_Colours(view) for view in views]
        self.follower: SheetFollower | None = None
        self.usual = 0.0

    def begin(self, everywhere: np.ndarray, views: Sequence[View], time: np.ndarray, hand: Hand | None) -> None:
        """Go on from where the sheet is, as `views` show it, with the frames at `time` [F] (s), the first of which this is.

        `everywhere` [P, 3] (m) is where it gets to in them.
        """
        self.lenses = [Lens(view.camera, everywhere) for view in views]
        shots = _shots(views, self.lenses, self.colours)
        if self.follower is None:
            self.follower = SheetFollower(self.mesh, shots, time, hand)
            self.first = _seen(self.follower.state)
        else:
            self.follower.go_on(shots, time, hand)

    def at(self, frame: int, cloud: np.ndarray, views: Sequence[View]) -> Found:
        """The sheet in a frame after the last one, or in the first: its cloud [P, 3] (m), and what cameras see."""
        assert self.follower is not None
        unseen = len(cloud) < FEWEST_POINTS
        if frame > 0:
            self.follower.skip(frame) if unseen else self.follower.follow(
                frame, _shots(views, self.lenses, self.colours)
            )
        positions = self.mesh.particles(self.follower.state.x).astype(np.float32)
        seen = np.zeros(len(positions)) if unseen else _seen(self.follower.state)
        near, misfit = (0.0, 0.0) if unseen else _distances(positions, seen >= SEEN, cloud)
        self.usual = misfit if frame == 0 else self.usual
        weight = np.where(seen < SEEN, 0.0, (seen / np.maximum(self.first, SEEN)).clip(max=1)).astype(np.float32)
        return Found(positions, near, weight, misfit, unseen, misfit > self.usual + LOST)


def follow_sheet(
    clouds: Sequence[np.ndarray],
    views: Sequence[Sequence[View]],
    time: np.ndarray,
    hand: Hand | None,
    particles: int,
    progress: Callable[[Sequence[np.ndarray]], Iterable[np.ndarray]],
) -> list[Found]:
    """Every frame of a sheet whose clouds are [P, 3] (m) at `time` [F] (s), of `particles` or more of its points.

    Raises `DataError` for a first cloud that is no surface.
    """
    tracker = SheetTracker(clouds[0], views[0], particles)
    tracker.begin(np.concatenate([cloud[::SPARSE] for cloud in clouds]), views[0], time, hand)
    return [tracker.at(frame, cloud, views[frame]) for frame, cloud in enumerate(progress(clouds))]


class _Colours:
    """How much more a colour is the object's than that of what is around it, as a camera sees both in the first frame."""

    def __init__(self, view: View):
        assert view.image is not None
        bins, mask = lab_bins(view.image()), view.mask.astype(np.uint8)
        core, near = cv2.erode(mask, np.ones((3, 3), np.uint8)) > 0, cv2.dilate(mask, np.ones((9, 9), np.uint8)) > 0
        self.ratio = colour_model(bins[core]) - colour_model(bins[~near])

    def alike(self, softened: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Which pixels [P] of a `softened` image are coloured as the object."""
        return self.ratio[pixel_bins(softened, row, column)] > 0 if len(row) else np.zeros(0, bool)


def _shots(views: Sequence[View], lenses: list[Lens], colours: list[_Colours]) -> list[Shot]:
    """What the cameras took, as the follower reads it."""
    shots = []
    for view, lens, colour in zip(views, lenses, colours, strict=True):
        assert view.image is not None
        image = np.ascontiguousarray(view.image()[lens.window])
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        depth = view.depth[lens.window].astype(np.float32) * np.float32(view.camera.depth_scale)
        shots.append(
            Shot(lens, grey, depth, view.mask[lens.window].astype(np.uint8), partial(colour.alike, softened(image)))
        )
    return shots


def _seen(state: State) -> np.ndarray:
    """Pixels [N] of all cameras that show each node."""
    total = np.zeros(len(state.x))
    for surface in state.surfaces:
        total += np.bincount(surface.corners.ravel(), surface.weights.ravel(), len(total))
    return total


def _distances(positions: np.ndarray, seen: np.ndarray, cloud: np.ndarray) -> tuple[float, float]:
    """Metres from seen points to a cloud, and the mean of that and of the way back from the cloud to all of them."""
    if not seen.any():
        return 0.0, 0.0
    there = float(cKDTree(cloud).query(positions[seen])[0].mean())
    some = cloud[:: max(1, len(cloud) // THINNED)]
    return there, (there + float(cKDTree(positions).query(some)[0].mean())) / 2
