"""Looks in the loop: which of them can be trusted, when it is looked again, and when nobody knows any more where the object is.

A look judges one set of images (`perception.look`). Here it is held against those before it: cameras go on delivering, and an
object keeps its colours and goes no further than what pushes it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.perception.look import Look, LookSettings, look
from piegraph_cli.recording.film import Scene

LOOKS = 3
"""Looks in a row that may be bad before an episode stops: noise and what passes by are gone in the next one."""
LEAP = 0.06
"""Metres that an object may move further than the tool went: what is seen farther away is another thing."""
TINTS, STRANGE = 24, 0.25
"""Cells of each of two log ratios of colour, and the share of an object's pixels in cells that it never had."""
SETTLED = ("edges",)
"""Checks of how images are made, which one good look answers for all that follow; folds and shadows may look like faults."""
TINT_RANGE = 3.0
"""Log ratio at either end of the cells."""


class Unseen(DataError):
    """The object cannot be seen: nobody knows where it is."""


@dataclass(frozen=True)
class Near:
    """Where an object can be after a stroke."""

    cloud: np.ndarray
    """[P, 3] metres: what was seen before it."""
    length: float
    """Of the stroke, metres."""

    def require(self, cloud: np.ndarray) -> None:
        """Raise `DataError` where a cloud [Q, 3] (m) cannot be the object."""
        apart = float(np.linalg.norm(cloud[:, :2].mean(0) - self.cloud[:, :2].mean(0)))
        if apart <= self.length + LEAP:
            return
        x, y = cloud[:, :2].mean(0)
        raise DataError(
            f"what is seen at x, y = ({x:+.2f}, {y:+.2f}) m cannot be the object: it lay {apart * 100:.0f} cm away, and the "
            f"tool went {self.length * 100:.0f} cm",
            "look",
            "look what lies there, and whether the object is still on the table",
        )


class Eyes:
    """Looks at one object, one after the other."""

    def __init__(self, settings: LookSettings) -> None:
        self.settings = settings
        self.said: list[str] = []
        """What was wrong with looks, and what is doubtful in those that count: each once."""
        self._last: Scene | None = None
        self._colors: np.ndarray | None = None

    def see(self, shoot: Callable[[], Scene], near: Near | None = None) -> tuple[Look, Scene]:
        """The first of `LOOKS` looks that can be trusted, and its images.

        Raises `Unseen` with the reasons where none can be, or where the cameras deliver nothing.
        """
        for again in range(1, LOOKS + 1):
            try:
                return self._trusted(shoot(), near)
            except DataError as error:
                if again == LOOKS:
                    text = f"{error.message} (so in {LOOKS} looks in a row)"
                    raise Unseen(text, error.where, error.hint) from None
                self._say(f"{error.message}; looked again")
        raise AssertionError("unreachable")

    def _trusted(self, scene: Scene, near: Near | None) -> tuple[Look, Scene]:
        _check_delivered(scene, self._last)
        self._last = scene
        found = look(*scene, self.settings)
        if self._colors is not None:
            found = replace(found, checks=[check for check in found.checks if check.name not in SETTLED])
        found.require()
        if near is not None:
            near.require(found.cloud)
        colors = tints(scene, found)
        if self._colors is None:
            self._colors = colors
        _check_colors(colors, self._colors)
        for finding in found.findings:
            self._say(f"{finding.text}: doubtful, and used")
        return found, scene

    def _say(self, text: str) -> None:
        if text not in self.said:
            self.said.append(text)


def _check_delivered(scene: Scene, last: Scene | None) -> None:
    """Raise `DataError` where a camera has no depth at all, or gives the very image that it gave before."""
    for k, camera in enumerate(scene.cameras):
        hint = "look at its cable and power, or go on without it: take it out of cameras.json"
        if not scene.depth[k].any():
            raise DataError(f"camera {camera.name} delivers no depth", "look", hint)
        if last is not None and np.array_equal(scene.depth[k], last.depth[k]) and scene.depth[k] is not last.depth[k]:
            raise DataError(f"camera {camera.name} delivers the same image again: it has stopped", "look", hint)


def tints(scene: Scene, found: Look) -> np.ndarray:
    """How many of the object's pixels have which log ratios of colour: [TINTS, TINTS]; light and shade make no difference."""
    pixels = np.concatenate([c[mask] for c, mask in zip(scene.color, found.masks, strict=True)]).astype(np.float32) + 8
    ratios = np.log(pixels[:, [0, 2]] / pixels[:, [1]])
    edges = np.linspace(-TINT_RANGE, TINT_RANGE, TINTS + 1)
    return np.histogram2d(ratios[:, 0], ratios[:, 1], bins=(edges, edges))[0]


def _check_colors(now: np.ndarray, first: np.ndarray) -> None:
    """Raise `DataError` where much of what is seen has colours [TINTS, TINTS] that the object did not have at first."""
    padded = np.pad(first, 1)
    rows, columns = first.shape
    near = sum(padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3))
    share = float(now[near < 0.005 * first.sum()].sum() / max(now.sum(), 1))
    if share > STRANGE:
        raise DataError(
            f"{share:.0%} of what is seen has colours that the object did not have in the first look",
            "look",
            "take away what lies on the object or beside it, a tool or a hand, and look again",
        )
