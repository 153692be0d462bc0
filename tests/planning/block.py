"""A square that a pusher of 24 mm moves along with it: the smallest environment to plan in."""

import numpy as np

from piegraph_cli.environments.base import Environment, Motion


class Block(Environment):
    """Goals are 8 cm to the right."""

    pusher_radius = 0.024
    walls = None

    def __init__(self):
        super().__init__(36)
        side = np.linspace(-0.05, 0.05, 6)
        self.square = np.array([[x, y, 0.0] for x in side for y in side])
        self.place = np.zeros(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-0.05, 0.05, 2)
        return self.particles(), {}

    def particles(self, shapes=None):
        places = self.place if shapes is None else shapes
        return (self.square + np.pad(places, [(0, 0)] * (places.ndim - 1) + [(0, 1)])[..., None, :]).astype(np.float32)

    def surface(self, shapes=None):
        return self.particles(shapes)

    def get_state(self):
        return {"place": self.place.copy()}

    def set_state(self, state):
        self.place = state["place"].copy()

    def goal(self, rng):
        return self.particles(self.place + np.array([0.08, rng.uniform(-0.01, 0.01)]))

    def _outline(self):
        return self.particles()[:, :2].astype(float), 0.002

    def _push(self, start, end):
        shapes = np.array([self.place, self.place + 0.9 * (end - start)])
        self.place = shapes[1].copy()
        return Motion(shapes, np.pad([start, end], ((0, 0), (0, 1))))
