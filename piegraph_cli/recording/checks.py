"""What a check says, how checks are told, and the checks of single images: readings, exposure, sharpness."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.params import CheckName

Verdict = Literal["good", "doubtful", "bad"]
NAMES = get_args(CheckName)

FEW_READINGS = 0.3
"""Share of pixels with a reading of depth below which it is doubtful."""
STEPS = 20
"""Depth that never exceeds this number of units was not written in units that fit an image of whole numbers."""
COARSE, EVENLY, ENOUGH = (0.005, 0.01), 1.25, 16
"""Steps of depth, as shares of its median, that are doubtful, bad, where they are as wide (the widest of most times the
narrowest) from near to far and so many: stereo and structured light have narrow ones near by and wider ones far away.
"""
DIM = 32
"""Grey of the brightest pixels below which an image shows hardly anything."""
CLIPPED = 0.5
"""Share of pixels that are black or white."""
FAINT = 10.0
"""Edges that are weaker (Sobel, of 8-bit values) than this are noise."""
SHARP = 1.12
"""How much stronger the strongest edges are than after a blur of two pixels; a sharp image has 1.5 and more."""


@dataclass(frozen=True)
class Check:
    """One check of one camera, or of two: its figure against a threshold, and what follows."""

    name: str
    cameras: tuple[str, ...]
    figure: float
    unit: str
    threshold: float
    """Beyond it (below it, for shares of readings and sharpness) the check is not good."""
    verdict: Verdict
    text: str
    """What was found, for people."""
    cause: str = ""
    remedy: str = ""


def judged(figure: float, doubtful: float, bad: float = np.inf) -> Verdict:
    """The verdict on a figure that should be small."""
    return "bad" if figure > bad else "doubtful" if figure > doubtful else "good"


def listed(names: Sequence[str]) -> str:
    """Names for people."""
    return " and ".join([", ".join(names[:-1])] * (len(names) > 1) + list(names[-1:]))


@dataclass(frozen=True)
class Finding:
    """What is wrong with some cameras in the same way."""

    checks: list[Check]

    @property
    def name(self) -> str:
        """That of the check."""
        return self.checks[0].name

    @property
    def cameras(self) -> list[str]:
        """All that it is about."""
        return list(dict.fromkeys(name for check in self.checks for name in check.cameras))

    @property
    def text(self) -> str:
        """Cameras, the worst finding, and the cause."""
        worst = max(self.checks, key=lambda c: abs(c.figure) if np.isfinite(c.figure) else 0)
        return f"{listed(self.cameras)}: {worst.text}" + (f"; {worst.cause}" if worst.cause else "")

    @property
    def remedy(self) -> str:
        """What to do."""
        return self.checks[0].remedy


def _place(check: Check) -> int:
    """Checks of geometry in their order, then all others as they come."""
    return NAMES.index(check.name) if check.name in NAMES else len(NAMES)


def grouped(checks: Sequence[Check]) -> list[Finding]:
    """Checks that are not good, those with the same verdict and cause together, the worst first."""
    groups: dict[tuple[str, str, str], list[Check]] = {}
    for check in sorted((c for c in checks if c.verdict != "good"), key=lambda c: (c.verdict, _place(c))):
        groups.setdefault((check.name, check.verdict, check.cause), []).append(check)
    return [Finding(same) for same in groups.values()]


def check_images(camera: Camera, depth: Sequence[np.ndarray], color: Sequence[np.ndarray]) -> list[Check]:
    """Readings, exposure and sharpness of a camera's depth uint16 [H, W] and colour [H, W, 3] images.

    Only depth in impossible units is bad: pictures may be made up, dark or out of focus and still be of use.
    """
    who = (camera.name,)
    most = max(int(image.max()) for image in depth)
    if 0 < most <= STEPS:
        text = f"depth has no reading above {most} units"
        cause = "metres or the like, cut to whole numbers"
        remedy = "write depth in millimetres, with depth_scale 0.001"
        return [Check("readings", who, most, "units", STEPS, "bad", text, cause, remedy)]
    share = float(np.mean([(image[::2, ::2] > 0).mean() for image in depth]))
    few: Verdict = "doubtful" if share < FEW_READINGS else "good"
    remedy = "check range, sunlight and shiny surfaces; for stereo cameras the projector" if few != "good" else ""
    text = f"{share:.0%} of the depth pixels have a reading"
    checks = [Check("readings", who, share, "1", FEW_READINGS, few, text, remedy=remedy)]
    checks += _check_steps(camera, depth)
    grey = [image[::2, ::2].mean(-1) for image in color]
    most_light = max(float(np.percentile(g, 99.9)) for g in grey)
    if 0 < most_light < DIM:
        text, cause = f"the brightest pixels have {most_light:.0f} of 255", "too dark, or 10 or 12 bits written as 16"
        remedy = "more light; or write colour with 8 bits"
        return [*checks, Check("exposure", who, most_light, "1", DIM, "doubtful", text, cause, remedy)]
    clipped = float(np.mean([((g < 4) | (g > 251)).mean() for g in grey]))
    text = f"{clipped:.0%} of the pixels are black or white"
    verdict = judged(clipped, CLIPPED)
    remedy = "change exposure or light" if verdict != "good" else ""
    checks.append(Check("exposure", who, clipped, "1", CLIPPED, verdict, text, remedy=remedy))
    sharpness = sharpness_of(color[0])
    if sharpness is not None:
        dull: Verdict = "doubtful" if sharpness < SHARP else "good"
        text = f"edges are {sharpness:.2f} times as strong as after a blur"
        remedy = "focus, clean the lens, shorten exposure" if dull != "good" else ""
        checks.append(Check("sharpness", who, sharpness, "1", SHARP, dull, text, remedy=remedy))
    return checks


def _check_steps(camera: Camera, depth: Sequence[np.ndarray]) -> list[Check]:
    """Depth that comes in even steps, as 8 bits make them; nothing where it does not."""
    readings = np.concatenate([image[::2, ::2][image[::2, ::2] > 0] for image in depth])
    values = np.unique(readings).astype(np.int64)
    if len(values) < ENOUGH:
        return []
    narrow, step, wide = np.quantile(np.diff(values), [0.1, 0.5, 0.9])
    share = float(step / np.median(readings))
    if share <= COARSE[0] or wide > EVENLY * narrow + 1:
        return []
    text = f"depth comes in steps of {step * camera.depth_scale * 1000:.0f} mm"
    cause, remedy = "written with 8 bits, or compressed with loss", "write depth as 16-bit PNG, in millimetres or finer"
    return [Check("readings", (camera.name,), share, "1", COARSE[0], judged(share, *COARSE), text, cause, remedy)]


def sharpness_of(color: np.ndarray) -> float | None:
    """How much a blur of two pixels weakens the strongest edges; None in an image that has none."""
    import cv2

    grey = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2GRAY)
    strength = [
        float(np.percentile(np.abs(cv2.Sobel(image, cv2.CV_16S, 1, 0)[::2, ::2]), 99.5))
        for image in (grey, cv2.GaussianBlur(grey, (0, 0), 2.0))
    ]
    return strength[0] / strength[1] if strength[1] > FAINT else None
