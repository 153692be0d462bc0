"""Particles that are carried on from look to look by the frames in between, as a recording's are: what folds needs this."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch

from piegraph_cli.environments.base import FRAME_RATE
from piegraph_cli.params import PICK
from piegraph_cli.perception.look import Look, LookSettings, look
from piegraph_cli.physics.follower import Follower, Grip
from piegraph_cli.physics.params import TrackParams
from piegraph_cli.physics.particles import choose_particles
from piegraph_cli.physics.sheet import Hand
from piegraph_cli.physics.sheet_tracking import SheetTracker, taken_for_sheet
from piegraph_cli.physics.springs import build_springs
from piegraph_cli.physics.tracking import spring_radius
from piegraph_cli.physics.visibility import View
from piegraph_cli.recording.film import Scene


class Tracked:
    """The tracked particles of one object, from a look at it on: a sheet, or what is followed by its springs."""

    def __init__(self, first: Look, scene: Scene, settings: LookSettings):
        self.settings, self.cloud = settings, first.cloud
        params = TrackParams(particles=settings.particles, tracked=max(TrackParams().tracked, settings.particles))
        self.views, self.follower = _views(first, scene), None
        self.sheet: SheetTracker | None = None
        if taken_for_sheet(first.cloud, self.views, params):
            self.sheet = SheetTracker(first.cloud, self.views, settings.particles)
            self.sheet.begin(first.cloud, self.views, np.zeros(1), None)
            chosen = self.sheet.at(0, first.cloud, self.views).positions
        else:
            chosen = choose_particles(first.cloud, params.tracked)
            with torch.inference_mode():
                graph = build_springs(chosen, spring_radius(chosen))
                self.follower = Follower(chosen, graph, first.cloud, self.views, params, upright=True)
        self.rest = chosen[: settings.particles].astype(np.float32)
        """[N, 3] metres: the particles at rest, as they were first seen."""

    def follow(self, hand: np.ndarray, mode: int, shoot: Callable[[int], Scene]) -> None:
        """Follow a stroke in which the tool is at `hand` [F, 3] (m), at 5 Hz: `shoot` gives the images of a frame on the way,
        1 to F - 2, in which the tool is in view.
        """
        grip, self.last = self._begin(hand, mode == PICK), len(hand) - 1
        for frame in range(1, self.last):
            scene = shoot(frame)
            self._on(frame, look(*scene, self.settings), scene, grip)

    def settle(self, seen: Look, scene: Scene) -> np.ndarray:
        """The particles [N, 3] float32 (m) in a look after the stroke, when the tool has let go."""
        return self._on(self.last, seen, scene, Grip(None, None))[: len(self.rest)].astype(np.float32)

    def _begin(self, hand: np.ndarray, picks: bool) -> Grip:
        """A stroke whose tool goes along `hand` [F, 3] (m), and holds what is under it where it `picks`."""
        grip = Grip(hand, np.full(len(hand), picks))
        if self.sheet is None:
            assert self.follower is not None
            self.follower.upright = not picks
            with torch.inference_mode():
                grip.update(0, self.follower.positions)
            return grip
        holds = np.append(np.ones(len(hand) - 1, bool), False)
        way = (hand[-1] - hand[0]) * [1, 1, 0]
        everywhere = np.concatenate([self.cloud, self.cloud + way, hand])
        held = Hand(hand, holds, holds, 0) if picks else None
        self.sheet.begin(everywhere, self.views, np.arange(len(hand)) / FRAME_RATE, held)
        return grip

    def _on(self, frame: int, seen: Look, scene: Scene, grip: Grip) -> np.ndarray:
        """All particles [M, 3] (m) in the next frame."""
        self.views, self.cloud = _views(seen, scene), seen.cloud
        if self.sheet is not None:
            return self.sheet.at(frame, seen.cloud, self.views).positions
        assert self.follower is not None
        with torch.inference_mode():
            self.follower.at(frame, seen.cloud, self.views, grip)
        return self.follower.positions.numpy()


def _views(seen: Look, scene: Scene) -> Sequence[View]:
    images = [partial(np.asarray, color) for color in scene.color]
    return [View(*of) for of in zip(scene.cameras, scene.depth, seen.masks, images, strict=True)]
