"""Colours that mean the same in every figure: of models, and of goal, object and prediction.

Models are as far apart as thirteen colours can be that stand out from white and from black, for colour-blind people too.
"""

import math
import re
import zlib

import numpy as np

GOAL, OBJECT, PREDICTED = "#d9480f", "#2b74d8", "#2f9e58"

MODELS = {
    "piegraph": "#2b74d8",
    "piegraph-ng": "#00a6f4",
    "kabsch": "#6f43b0",
    "egnn-g": "#4a7c4f",
    "gnn": "#de1253",
    "gnn-aug": "#fe7260",
    "sms-no": "#a89711",
    "sms-o": "#7a550d",
    "pgnd": "#b26d00",
    "gbnd": "#af0a74",
    "rigid": "#40ac69",
    "rigid-gp": "#d96cc7",
    "static": "#7c848f",
    "greedy": "#356286",
}
"""A colour per model, each with a contrast of at least 2.6 on white and on the report's dark ground."""

DARKEST, LIGHTEST = 0.48, 0.69
"""Lightness (OKLab) within which shades of these keep that contrast."""

MARKERS = "osD^vP*Xdph<>8"
"""Beside colours, for those who see none of them and for prints in grey."""

_LABEL = re.compile(r"([^:@]+)(?::([^:@]+))?(?:@([0-9]{1,9}))?")
_CONES = np.array([[0.41222, 0.53633, 0.05145], [0.21190, 0.68070, 0.10740], [0.08830, 0.28172, 0.62998]])
_LAB = np.array([[0.21045, 0.79362, -0.00407], [1.97800, -2.42859, 0.45059], [0.02590, 0.78277, -0.80868]])


def model_color(label: str) -> str:
    """The colour of a model by its label, `#rrggbb`: the same wherever the model is drawn.

    `piegraph:fine` and `piegraph@20` are shades of `piegraph`; the fewer sequences one learned from, the paler. A label
    that is none of a model's has a colour of its own, the same at all times.
    """
    if label in MODELS:
        return MODELS[label]
    parts = _LABEL.fullmatch(label)
    if parts is None or parts[1] not in MODELS:
        return _hex(0.5 + 0.18 * _fraction(label[::-1]), 0.13, 2 * math.pi * _fraction(label))
    lightness, chroma, hue = _polar(MODELS[parts[1]])
    if parts[2]:
        lightness += 0.1 if lightness < 0.58 else -0.1
        hue += _fraction(parts[2]) - 0.5
    if parts[3]:
        few = 1 - min(math.log2(max(int(parts[3]), 1)) / 8, 1)
        lightness, chroma = lightness + 0.7 * few * (LIGHTEST - lightness), chroma * (1 - 0.6 * few)
    return _hex(lightness, chroma, hue)


def model_marker(label: str) -> str:
    """A marker of matplotlib's for a model: that of its name, or one that stays the same for a name of no model."""
    name = re.split("[:@]", label, maxsplit=1)[0]
    names = list(MODELS)
    return MARKERS[names.index(name) if name in MODELS else zlib.crc32(name.encode()) % len(MARKERS)]


def _fraction(text: str) -> float:
    """A number in 0-1 that a text always has."""
    return zlib.crc32(text.encode()) / 2**32


def _polar(color: str) -> tuple[float, float, float]:
    """Lightness, chroma and hue (rad) of `#rrggbb`. Source: Ottosson, "A perceptual color space for image processing"."""
    coded = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    lightness, a, b = _LAB @ np.cbrt(_CONES @ linear)
    return float(lightness), math.hypot(a, b), math.atan2(b, a)


def _hex(lightness: float, chroma: float, hue: float) -> str:
    """`#rrggbb` of lightness, chroma and hue (rad); what no screen shows is as near to it as one can."""
    within = min(max(lightness, DARKEST), LIGHTEST)
    cones = np.linalg.solve(_LAB, [within, chroma * math.cos(hue), chroma * math.sin(hue)]) ** 3
    linear = np.clip(np.linalg.solve(_CONES, cones), 0, 1)
    coded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return "#" + "".join(f"{round(float(part) * 255):02x}" for part in coded)
