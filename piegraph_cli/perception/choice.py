"""Which of several parts on the table is the object: the one that the hand touches and that moves."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.parts import Part, hue_and_light
from piegraph_cli.recording.camera import Camera

CLEAR = 0.05
"""Distance (m) between hand and object from which the object counts as clear of the hand."""
LOOKS = 10
"""Frames, spread over the sequence, in which it is seen whether a part has changed."""
TOUCH = 0.03
"""Distance (m) in the plane, and above its top, at which the end-effector touches a part."""
SAME_PLACE, MOVED, LEFT = 0.3, 0.12, 0.5
"""Share of a part's pixels that may change while it stays in its place; from which it is moved; has left its place."""
ENOUGH = 0.3
"""Share of a part's pixels that must be in view for a verdict."""
AT_REST, ALWAYS_AT_REST = 0.25, 0.6
"""Share of the frames in its place from which a part is a thing, not a passing arm; the same beside the hand."""
STEP, STEP_PER_M2 = 0.01, 0.012
"""Change of depth (m) that is no noise, near and per squared metre of distance."""


@dataclass(frozen=True)
class Trait:
    """What the whole sequence says of a part."""

    touched: bool
    """The end-effector came to it."""
    moved: bool
    """It left its place, if only in part."""
    thing: bool
    """It lies there for a while: no piece of an arm, no shadow."""
    stays: bool
    """It lies in its place in all frames."""
    moved_from: int | None
    """The first later frame seen in which it has left its place, where it lay there till then."""


@dataclass(frozen=True)
class Choice:
    """The part that is the object, and what else lies there."""

    part: Part
    rank: int
    """0 touched and moved, 1 touched, 2 moved, 3 neither."""
    rivals: list[Part] = field(default_factory=list)
    """Things that would have done as well."""
    others: list[Part] = field(default_factory=list)
    """All other things, rivals first."""
    leaving: list[tuple[Part, int]] = field(default_factory=list)
    """Those of them that are moved later, and from which frame on."""


class Chooser:
    """Chooses in any frame of one sequence; images are read once.

    `images[camera][frame]`, `depths[camera][frame]` and `workspace` as in `seeds.find_object`; `tips` [F, 3] (m) the
    end-effector, NaN where unknown.
    """

    def __init__(
        self,
        images: Sequence[Sequence[np.ndarray]],
        depths: Sequence[Sequence[np.ndarray]],
        cameras: Sequence[Camera],
        tips: np.ndarray,
        params: SegmentParams,
    ):
        self.images, self.depths, self.cameras, self.tips, self.params = images, depths, cameras, tips, params
        self.frames = np.unique(np.linspace(0, len(tips) - 1, min(len(tips), LOOKS)).astype(int))
        self._seen: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}

    def choose(self, frame: int, parts: Sequence[Part]) -> Choice:
        """The object among the parts of a frame (at least one)."""
        parts = [piece for part in parts for piece in self._apart(frame, part)]
        traits = [self.trait(frame, part) for part in parts]
        ranks = [0 if t.touched and t.moved else 1 if t.touched else 2 if t.moved and t.thing else 3 for t in traits]
        best = min(range(len(parts)), key=lambda n: (ranks[n], -parts[n].score))
        things = [n for n, t in enumerate(traits) if t.thing and n != best]
        rivals = [parts[n] for n in things if ranks[n] == ranks[best] and traits[n].stays <= traits[best].stays]
        leaving = [(parts[n], f) for n in things if (f := traits[n].moved_from) is not None]
        others = [*rivals, *(parts[n] for n in things if not any(parts[n] is rival for rival in rivals))]
        return Choice(parts[best], ranks[best], rivals, others, leaving)

    def _apart(self, frame: int, part: Part) -> Sequence[Part]:
        """The pieces of a part where one is touched and moves while another never does; else the part."""
        traits = [self.trait(frame, piece) for piece in part.pieces]
        handled = [t.touched and t.moved for t in traits]
        at_rest = [t.thing and not t.touched and not t.moved for t in traits]
        return part.pieces if any(handled) and any(at_rest) else (part,)

    def trait(self, frame: int, part: Part) -> Trait:
        """What the sequence says of a part of that frame."""
        looks = [(int(g), self.change(frame, part, int(g))) for g in self.frames if g != frame]
        looks = [(g, share) for g, share in looks if np.isfinite(share)]
        shares = np.array([share for _, share in looks])
        rest = float((shares < SAME_PLACE).mean()) if len(shares) else 1.0  # where nothing else is known, it is one
        thing = rest >= (AT_REST if part.clearance >= CLEAR else ALWAYS_AT_REST)
        left = next((g for g, share in looks if g > frame and share > LEFT), None)
        lay = [share < SAME_PLACE for g, share in looks if left is not None and g < left]
        moved_from = left if len(lay) > 1 and all(lay) else None
        return Trait(self._touched(frame, part), bool((shares > MOVED).any()), thing, bool(rest == 1), moved_from)

    def _touched(self, frame: int, part: Part) -> bool:
        tops = [np.percentile(z, 95) for z in self._heights(frame, part) if len(z)]
        top = max(tops, default=0.0)
        with np.errstate(invalid="ignore"):
            low = self.tips[:, 2] <= top + TOUCH
        return bool(((part.distance(self.tips[:, :2]) <= TOUCH) & low).any())

    def _heights(self, frame: int, part: Part) -> list[np.ndarray]:
        """The heights (m) that each camera reads of a part."""
        found = []
        for c, camera in enumerate(self.cameras):
            rows, columns = np.nonzero(part.masks[c] & (self._look(frame, c)[1] > 0))
            metres = self._look(frame, c)[1][rows, columns] * camera.depth_scale
            found.append(camera.unproject(np.column_stack([columns, rows]), metres)[:, 2] if len(rows) else metres)
        return found

    def change(self, frame: int, part: Part, other: int) -> float:
        """Share of the part's pixels, of those in view, that show something else in frame `other`; NaN unknown."""
        changed = known = total = 0
        for c, camera in enumerate(self.cameras):
            inner = _inner(part.masks[c])
            crop = _box(inner)
            if crop is None:
                continue
            (image, depth), (later_image, later_depth) = self._look(frame, c), self._look(other, c)
            now, later = (image[crop], depth[crop]), (later_image[crop], later_depth[crop])
            seen, differs = changes(now, later, camera, self.params.min_contrast)
            total += int(inner.sum())
            known += int((seen & inner[crop]).sum())
            changed += int((differs & inner[crop]).sum())
        return changed / known if known >= max(ENOUGH * total, 1) else np.nan

    def _look(self, frame: int, c: int) -> tuple[np.ndarray, np.ndarray]:
        import cv2

        if (frame, c) not in self._seen:
            self._seen[frame, c] = self.images[c][frame], cv2.medianBlur(self.depths[c][frame], 5)
        return self._seen[frame, c]


def changes(
    now: tuple[np.ndarray, np.ndarray], later: tuple[np.ndarray, np.ndarray], camera: Camera, min_contrast: float
) -> tuple[np.ndarray, np.ndarray]:
    """Which pixels [H, W] of a later view can be judged, and which of these show something farther or of another hue.

    A view is an image [H, W, 3] and its depth [H, W]. Not judged is where depth is missing or something has come in front.
    """
    (image, depth), (later_image, later_depth) = now, later
    before, after = depth * np.float32(camera.depth_scale), later_depth * np.float32(camera.depth_scale)
    step = np.maximum(STEP, STEP_PER_M2 * before**2)
    seen = (depth > 0) & (later_depth > 0) & (after > before - step)
    recoloured = np.linalg.norm(hue_and_light(image)[0] - hue_and_light(later_image)[0], axis=-1) > min_contrast
    return seen, seen & ((after > before + step) | recoloured)


def _inner(mask: np.ndarray) -> np.ndarray:
    import cv2

    eroded = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    return eroded if eroded.any() else mask


def _box(mask: np.ndarray) -> tuple[slice, slice] | None:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
