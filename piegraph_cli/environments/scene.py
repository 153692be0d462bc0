"""What cameras see of the moments of a recording: the object, hand and arm, and what is there on purpose."""

from dataclasses import astuple, dataclass, replace

import numpy as np

from piegraph_cli.environments.base import FRAME_RATE, Environment
from piegraph_cli.environments.hand import Hand
from piegraph_cli.environments.hand_motion import Grip, arm_at, hand_colors
from piegraph_cli.environments.params import TroubleParams
from piegraph_cli.environments.render import HAND, OBJECT, Part, Print, Renderer, View
from piegraph_cli.environments.trouble import Cover, depth_cameras, hidden_frames, still_parts
from piegraph_cli.recording.camera import Camera


@dataclass(frozen=True)
class Moment:
    """What is true at one frame."""

    time: float
    """Seconds since the recording began."""
    shape: np.ndarray
    """The object's configuration, as the environment's `surface` takes it."""
    tip: np.ndarray | None
    """[3] what pushes or what the fingertips hold, metres; None while the hand is out of the scene."""
    grip: Grip | None
    stroke: int
    """The stroke's number, -1 between strokes."""


class Scene:
    """What cameras see of the moments of a recording."""

    def __init__(
        self,
        env: Environment,
        moments: list[Moment],
        cameras: list[Camera],
        hand: Hand,
        trouble: TroubleParams,
        print: Print | None = None,
    ):
        self.env, self.moments, self.hand, self.trouble = env, moments, hand, trouble
        self.skin, self.print = hand_colors(hand), print
        self.renderer = Renderer(cameras)
        self.late = dict.fromkeys(trouble.of if trouble.late else (), trouble.late)
        beside = depth_cameras(cameras, trouble)
        self.beside = {k: Renderer([camera]) for k, camera in beside.items()}
        self.hidden = hidden_frames(trouble, len(moments))
        surface = env.surface(moments[0].shape)
        self.cover = Cover.of(surface)
        self.still: list[Part] = []
        if trouble.beside != "none" or trouble.resting_hand:
            moving = np.concatenate([p.vertices[::3] for m in moments for p in self._moving(m)[0]])
            moving = np.concatenate([moving, *env.particles(np.array([m.shape for m in moments]))])
            self.still = still_parts(trouble, moving, surface, env.color, hand)

    def views(self, frame: int) -> tuple[list[View], np.ndarray]:
        """What each camera sees in a frame, and the hand's landmarks."""
        parts, landmarks = self.parts(self.moments[frame])
        punctual = [k for k in range(len(self.renderer.cameras)) if k not in self.late]
        views = dict(zip(punctual, self.renderer.render(parts, punctual), strict=True))
        for k in self.late:
            [views[k]] = self.renderer.render(self.parts(self._shown(frame, k))[0], [k])
        return [views[k] for k in sorted(views)], landmarks

    def depths(self, frame: int, views: list[View]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Depth (m) and slope [H, W] per camera: those of its view, or from where its depth is seen."""
        found = [(view.depth, view.slope) for view in views]
        for k, renderer in self.beside.items():
            [found[k]] = renderer.depths(self.parts(self._shown(frame, k))[0])
        return found

    def parts(self, moment: Moment) -> tuple[list[Part], np.ndarray]:
        """All that is on the table, and the hand's landmarks [21, 3]."""
        parts, landmarks = self._moving(moment)
        frame = round(moment.time * FRAME_RATE)
        if frame in self.hidden:
            parts.append(self.cover.part(parts[0].vertices))
        if 0 <= self.trouble.gone_from <= frame:
            parts = parts[1:]
        return parts + self.still, landmarks

    def _moving(self, moment: Moment) -> tuple[list[Part], np.ndarray]:
        surface, color = self.env.surface(moment.shape), np.array([self.env.color])
        parts = [Part(surface, self.env.triangles, OBJECT, color, print=self.print)]
        if moment.tip is None or moment.grip is None:
            return parts, np.full((21, 3), np.nan)
        arm = arm_at(self.hand, moment.grip, moment.tip)
        parts.append(Part(arm.hand, self.hand.triangles, HAND, self.skin, smooth=True))
        forearm, faces, colors = arm.forearm
        parts.append(Part(forearm, faces, HAND, colors, smooth=True))
        return parts, arm.landmarks

    def _shown(self, frame: int, camera: int) -> Moment:
        """What a camera shows in a frame: for one that is late, what was before."""
        return moment_at(self.moments, self.moments[frame].time - self.late.get(camera, 0.0))


def moment_at(moments: list[Moment], time: float) -> Moment:
    """What is true at a time (s), between two moments in the straight line."""
    place = min(max(time * FRAME_RATE, 0.0), len(moments) - 1.0)
    before = moments[min(int(place), len(moments) - 2)]
    after = moments[min(int(place), len(moments) - 2) + 1]
    share = place - int(place) if int(place) < len(moments) - 1 else 1.0
    nearest = after if share >= 0.5 else before
    if before.tip is None or after.tip is None or before.grip is None or after.grip is None:
        return replace(nearest, time=place / FRAME_RATE)
    grips = np.array([astuple(before.grip), astuple(after.grip)])
    mixed = (1 - share) * grips[0] + share * grips[1]
    return replace(
        nearest,
        time=place / FRAME_RATE,
        shape=(1 - share) * before.shape + share * after.shape,
        tip=(1 - share) * before.tip + share * after.tip,
        grip=Grip(*mixed.tolist()),
    )
