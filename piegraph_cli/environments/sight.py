"""Cameras over a simulated table, in place of a robot's: images of what is there now, as noisy as those of recordings.

They give images and the cameras as they are said to be, nothing else: no mask, no place, no state.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from piegraph_cli.environments.base import Environment
from piegraph_cli.environments.noise import sensed_color, sensed_depth
from piegraph_cli.environments.params import SightParams
from piegraph_cli.environments.render import OBJECT, Part, Renderer
from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.environments.robot_arm import arm_parts
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.film import Scene


class Sight:
    """The cameras over one environment; what they give follows from `seed` and how often they were asked."""

    def __init__(
        self, environment: Environment, params: SightParams = SightParams(), seed: Sequence[int] = (0,)
    ) -> None:
        self.environment, self.params, self.seed, self.shots = environment, params, list(seed), 0
        self.renderer = _renderer(params.cameras)
        self.told = _told(self.renderer.cameras, params, self.seed)
        self.beside: list[Part] = []
        """What else lies on the table."""

    def shoot(self, shape: np.ndarray | None = None, tip: np.ndarray | None = None) -> Scene:
        """One image of each camera: of the environment as it is, or with the object as `shape`, as `surface` takes it.

        `tip` [3] (m): the lower end of the robot's rod, whose arm is then in view.
        """
        env = self.environment
        thing = Part(env.surface(shape), env.triangles, OBJECT, np.array([env.color]))
        arm = [] if tip is None else arm_parts(tip, env.pusher_radius)
        views = self.renderer.render([thing, *arm, *self.beside])
        rng = np.random.default_rng([*self.seed, self.shots])
        self.shots += 1
        color = [sensed_color(view.color, rng) for view in views]
        depth = [
            sensed_depth(view.depth, view.slope, camera.K[0, 0], camera.depth_scale, rng, self.params.noise)
            for view, camera in zip(views, self.renderer.cameras, strict=True)
        ]
        return Scene(color, depth, self.told)


@lru_cache(maxsize=2)
def _renderer(cameras: int) -> Renderer:
    """One for all episodes of a process: it shades the table and the floor once."""
    return Renderer(camera_rig(count=cameras))


def _told(cameras: Sequence[Camera], params: SightParams, seed: list[int]) -> list[Camera]:
    """The cameras as they are said to be: each off by so much in a direction, and about an axis, of its own."""
    if not params.moved and not params.turned:
        return list(cameras)
    rng, told = np.random.default_rng([*seed, len(cameras)]), []
    for camera in cameras:
        way, axis = (direction / np.linalg.norm(direction) for direction in rng.normal(size=(2, 3)))
        T = camera.T_world_camera.copy()
        T[:3, :3] = Rotation.from_rotvec(params.turned * axis, degrees=True).as_matrix() @ T[:3, :3]
        T[:3, 3] += params.moved * way
        told.append(replace(camera, T_world_camera=T))
    return told
