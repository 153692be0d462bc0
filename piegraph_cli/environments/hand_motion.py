"""How a person holds the right hand and arm while the fingertips push or pinch: grips, joints, surfaces; no rendering."""

import math
from dataclasses import dataclass

import numpy as np

from piegraph_cli.environments.hand import Hand

PERSON = np.array([0.04, -0.78, 0.30])
"""Where the forearm comes from, metres: the person stands at the table's -y side."""
_SHOULDER = np.array([0.08, -0.80, 0.62])
_FOREARM, _CUFF = 0.26, 0.012
_SIDES = 24
# rings of the arm, metres: distance from the wrist, then from the elbow; half width; half thickness
_ALONG = np.array([-0.006, 0.010, 0.025, 0.06, 0.10, 0.14, 0.1405, 0.18, 0.22, 0.25])
_ABOVE = np.array([0.02, 0.06, 0.15, 0.30, 0.60])
_WIDE = np.array(
    [0.020, 0.0262, 0.0268, 0.029, 0.034, 0.037, 0.043, 0.044, 0.045, 0.044, 0.045, 0.047, 0.051, 0.055, 0.055]
)
_THICK = np.array(
    [0.014, 0.0188, 0.0195, 0.023, 0.030, 0.034, 0.040, 0.043, 0.045, 0.046, 0.046, 0.047, 0.051, 0.055, 0.055]
)
_SLEEVE_FROM = 6
_CARRYING = 1.72
"""Heading of a pinching hand, rad: the forearm comes straight from the person, and most cameras see thumb and index."""
_PAD = 0.008
"""How far below the middle of pinching fingertips they hold something, metres."""
_SKIN, _SLEEVE = np.array([0.60, 0.335, 0.225]), np.array([0.09, 0.10, 0.12])


@dataclass(frozen=True)
class Grip:
    """How the hand is held while the fingertips follow a point."""

    heading: float
    """Direction of the fingers in the table plane, rad."""
    steep: float
    """0: palm low, fingers reach forward; 1: palm high, fingers point down."""
    pinch: float = 0.0
    """0: index and middle finger push; 1: the thumb meets them; between: an open hand about to pinch."""


@dataclass(frozen=True)
class Arm:
    """Hand and forearm in the world frame."""

    hand: np.ndarray
    """[V, 3] metres; triangles are the `Hand`'s."""
    landmarks: np.ndarray
    """[21, 3] metres, MediaPipe's order."""
    forearm: tuple[np.ndarray, np.ndarray, np.ndarray]
    """Vertices [W, 3] (m), triangles [T, 3] and linear RGB [W, 3]."""


def held(hand: Hand, grip: Grip) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and landmarks (m) of a grip in world axes; the origin is what pushes or what is held.

    A pushing hand has it in the middle of index and middle fingertip, a pinching one just below the middle of thumb,
    index and middle fingertip.
    """
    pushing, pinching = _pushing(grip.steep), _pinching(grip.steep)
    mixed = {finger: (1 - grip.pinch) * pushing[finger] + grip.pinch * pinching[finger] for finger in pushing}
    vertices, landmarks = hand.pose(
        {finger: tuple(angles[:3]) for finger, angles in mixed.items()},
        {finger: float(angles[3]) for finger, angles in mixed.items()},
    )
    pitch = (1 - grip.pinch) * (0.42 + 0.28 * grip.steep) + grip.pinch * (0.30 + 0.40 * grip.steep)
    cos, sin = math.cos(grip.heading), math.sin(grip.heading)
    tilt = np.array([[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]])
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ tilt
    vertices, landmarks = vertices @ turn.T, landmarks @ turn.T
    pusher = (landmarks[8] + landmarks[12]) / 2
    tip = pusher + grip.pinch * ((landmarks[4] - pusher) / 2 - np.array([0, 0, _PAD]))
    return vertices - tip, landmarks - tip


def _pushing(steep: float) -> dict[str, np.ndarray]:
    """Per finger the bend of its three bones and its spread, rad, as in `Hand.pose`: fingers nearly straight."""
    first, second, third = 0.30 + 0.30 * steep, 0.30 + 0.15 * steep, 0.18
    return {
        "thumb": np.array([0.10 - 0.10 * steep, 0.22 - 0.15 * steep, 0.25 - 0.2 * steep, -0.45]),
        "index": np.array([first, second, third, -0.02]),
        "middle": np.array([first + 0.04, second + 0.05, third, 0.06]),
        "ring": np.array([first + 0.12, second + 0.14, third + 0.08, 0.17]),
        "pinky": np.array([first + 0.18, second + 0.18, third + 0.10, 0.22]),
    }


def _pinching(steep: float) -> dict[str, np.ndarray]:
    """As `_pushing`, with thumb, index and middle fingertip together and the other two fingers off the table."""
    first, second, third = 1.11 + 0.07 * steep, 0.79, 0.39
    return {
        "thumb": np.array([0.43 + 0.05 * steep, 0.25 + 0.03 * steep, 0.27, -0.62 + 0.04 * steep]),
        "index": np.array([0.92 + 0.03 * steep, 0.85 + 0.16 * steep, 0.43 + 0.06 * steep, -0.06]),
        "middle": np.array([first, second, third, 0.06]),
        "ring": np.array([first + 0.10, second + 0.12, third + 0.06, 0.15]),
        "pinky": np.array([first + 0.16, second + 0.16, third + 0.10, 0.20]),
    }


def arm_at(hand: Hand, grip: Grip, tip: np.ndarray) -> Arm:
    """Hand and forearm with what pushes or what is held at `tip` [3] (m)."""
    vertices, landmarks = held(hand, grip)
    vertices, landmarks = vertices + tip, landmarks + tip
    wrist = landmarks[0]
    fingers = np.array([math.cos(grip.heading), math.sin(grip.heading), 0.0])
    to_person = (PERSON - wrist) / np.linalg.norm(PERSON - wrist)
    back = _unit(-0.5 * fingers + 0.6 * to_person + np.array([0, 0, 0.18]))
    cuff = np.clip((_CUFF - hand.vertices[:, :1]) / (2 * _CUFF), 0, 1)
    palm = _unit(wrist - landmarks[9])
    bent = wrist + (vertices - wrist) @ _turning(palm, back).T
    return Arm(vertices + cuff * (bent - vertices), landmarks, _forearm(wrist, back, fingers))


def choose_grip(hand: Hand, heading: float, tips: np.ndarray, inside, pinch: float = 0.0) -> Grip:
    """The comfortable grip for a stroke along `heading` (rad) that least reaches into the object.

    A hand that pinches does not turn with its way. `pinch` is the grip's. `tips` [F, 3] (m) is the fingertips' path;
    `inside(frame, points [V, 3])` says which points lie in the object.
    """
    forward = math.pi / 2
    off = math.remainder(heading - forward, 2 * math.pi)
    wanted = forward + (max(-0.7, min(off, 1.0)) if abs(off) < 2.0 else 0.0) if pinch == 0 else _CARRYING
    best, best_cost = Grip(wanted, 0.0, pinch), math.inf
    for steep in (0.0, 0.5, 1.0):
        for turned in np.linspace(forward - 0.8, forward + 1.1, 9):
            grip = Grip(float(turned), steep, pinch)
            vertices, _ = held(hand, grip)
            hits = np.mean([inside(k, vertices + tips[k]).mean() for k in range(0, len(tips), 2)])
            cost = 40 * hits + 0.3 * abs(turned - wanted) + 0.25 * steep
            if cost < best_cost:
                best, best_cost = grip, cost
    return best


def hand_colors(hand: Hand) -> np.ndarray:
    """Linear RGB [V, 3]: skin, redder at the fingertips and paler on the palm."""
    tips = [hand.joints[hand.names.index(n)] for n in hand.names if n.endswith("tip")]
    distance = np.min([np.linalg.norm(hand.vertices - tip, axis=1) for tip in tips], axis=0)
    warm = np.exp(-((distance / 0.02) ** 2))[:, None]
    return _SKIN * (1 + warm * np.array([0.10, -0.10, -0.08]))


def _forearm(wrist: np.ndarray, back: np.ndarray, fingers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A tube from inside the hand's cuff to the elbow and on to the shoulder: skin first, then a sleeve."""
    elbow = wrist + _FOREARM * back
    centres = np.concatenate([wrist + _ALONG[:, None] * back, elbow + _ABOVE[:, None] * _unit(_SHOULDER - elbow)])
    thumb_side = np.array([-fingers[1], fingers[0], 0.0])
    side = _unit(thumb_side - back * (thumb_side @ back))
    up = np.cross(back, side)
    angle = np.linspace(0, 2 * math.pi, _SIDES, endpoint=False)[:, None]
    rings = centres[:, None] + _WIDE[:, None, None] * np.cos(angle) * side + _THICK[:, None, None] * np.sin(angle) * up
    rows, around = np.arange(len(centres) - 1)[:, None] * _SIDES, np.arange(_SIDES)
    first, after = (rows + around).ravel(), (rows + (around + 1) % _SIDES).ravel()
    triangles = np.concatenate(
        [np.column_stack([first, after, after + _SIDES]), np.column_stack([first, after + _SIDES, first + _SIDES])]
    )
    colors = np.where((np.arange(len(centres)) < _SLEEVE_FROM)[:, None], _SKIN, _SLEEVE)
    return rings.reshape(-1, 3), triangles, np.repeat(colors, _SIDES, axis=0)


def _turning(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The smallest rotation [3, 3] that takes one unit vector to another."""
    from scipy.spatial.transform import Rotation

    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    return Rotation.from_rotvec(axis / max(sine, 1e-12) * math.atan2(sine, start @ end)).as_matrix()


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
