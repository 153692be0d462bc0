"""Particles that are carried on from look to look by the frames in between, as a recording's are: what folds needs this."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from piegraph_cli.environments.sight import Sight
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.perception.look import Look, LookSettings, look
from piegraph_cli.physics.follower import Follower, Grip
from piegraph_cli.physics.params import TrackParams
from piegraph_cli.physics.particles import choose_particles
from piegraph_cli.physics.springs import build_springs
from piegraph_cli.physics.tracking import spring_radius
from piegraph_cli.physics.visibility import View
from piegraph_cli.recording.film import Scene


class Tracked:
    """The tracked particles of one object, from a look at it on."""

    def __init__(self, first: Look, scene: Scene, settings: LookSettings, tool_height: float):
        """`tool_height` (m): how far the lower end of the tool is below its middle while it pushes."""
        self.settings, self.tool_height = settings, tool_height
        params = TrackParams(particles=settings.particles, tracked=max(TrackParams().tracked, settings.particles))
        chosen = choose_particles(first.cloud, params.tracked)
        self.rest = chosen[: settings.particles].astype(np.float32)
        """[N, 3] metres: the particles at rest, as they were first seen."""
        with torch.inference_mode():
            graph = build_springs(chosen, spring_radius(chosen))
            self.follower = Follower(chosen, graph, first.cloud, _views(first, scene), params, upright=True)

    def follow(self, sight: Sight, info: dict[str, Any], mode: int) -> None:
        """Follow a stroke by its frames on the way, `info` of the environment's step; the tool is in view."""
        self.follower.upright = mode == PUSH
        hand = np.asarray(info["pusher"], float)
        grip = Grip(hand, np.full(len(hand), mode == PICK))
        with torch.inference_mode():
            grip.update(0, self.follower.positions)
        lower = np.array([0, 0, self.tool_height if mode == PUSH else 0.0])
        for frame in range(1, len(hand) - 1):
            scene = sight.shoot(info["shapes"][frame], hand[frame] - lower)
            self._on(frame, look(*scene, self.settings), scene, grip)

    def settle(self, seen: Look, scene: Scene) -> np.ndarray:
        """The particles [N, 3] float32 (m) in a look after the stroke, when the tool has let go."""
        self._on(1, seen, scene, Grip(None, None))
        return self.follower.positions[: len(self.rest)].numpy().astype(np.float32)

    def _on(self, frame: int, seen: Look, scene: Scene, grip: Grip) -> None:
        with torch.inference_mode():
            self.follower.at(frame, seen.cloud, _views(seen, scene), grip)


def _views(seen: Look, scene: Scene) -> Sequence[View]:
    return [View(c, d, mask) for c, d, mask in zip(scene.cameras, scene.depth, seen.masks, strict=True)]
