"""The T-block's geometry in its body frame, and particles on what a depth camera sees of it; no physics here."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Block:
    """An upright prism made of rectangles, in a body frame whose origin is the centre of mass at table height."""

    rectangles: np.ndarray
    """[R, 4] x_min, y_min, x_max, y_max of each rectangle, metres; they touch but do not overlap."""
    outline: np.ndarray
    """[V, 2] the outline's corners, counter-clockwise, metres."""
    height: float
    """Metres; the block stands on z = 0."""

    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Closed surface in the body frame: vertices [V, 3] (m) and outward-facing triangles [T, 3]."""
        corners = np.concatenate([[[a, b], [c, b], [c, d], [a, d]] for a, b, c, d in self.rectangles])
        count, sides = len(corners), len(self.outline)
        vertices = np.concatenate(
            [
                np.column_stack([corners, np.full(count, self.height)]),
                np.column_stack([corners, np.zeros(count)]),
                np.column_stack([self.outline, np.zeros(sides)]),
                np.column_stack([self.outline, np.full(sides, self.height)]),
            ]
        )
        starts = np.arange(0, count, 4)[:, None]
        top = np.concatenate([starts + np.array([0, 1, 2]), starts + np.array([0, 2, 3])])
        low = 2 * count + np.arange(sides)
        after = 2 * count + (np.arange(sides) + 1) % sides
        walls = np.concatenate(
            [np.column_stack([low, after, after + sides]), np.column_stack([low, after + sides, low + sides])]
        )
        return vertices, np.concatenate([top, top[:, ::-1] + count, walls])

    def visible_surface(self, count: int, seed: int) -> np.ndarray:
        """`count` points drawn evenly from the top and the sides, body frame [count, 3] (m); never the underside."""
        vertices, triangles = self.mesh()
        corners = vertices[triangles]
        corners = corners[corners[..., 2].max(1) > 0]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        rng = np.random.default_rng(seed)
        chosen = corners[rng.choice(len(corners), count, p=area / area.sum())]
        u, v = np.sqrt(rng.random(count)), rng.random(count)
        weights = np.column_stack([1 - u, u * (1 - v), u * v])
        return np.einsum("nk,nkd->nd", weights, chosen)


def t_block() -> Block:
    """The project's T: bars 20 x 5 cm and 5 x 15 cm, 3.5 cm high, its centre of mass 2.7 cm off the area's centre."""
    rectangles = np.array([[-0.1, -0.025, 0.1, 0.025], [-0.025, -0.175, 0.025, -0.025]])
    outline = np.array([
        [-0.1, -0.025], [-0.025, -0.025], [-0.025, -0.175], [0.025, -0.175],
        [0.025, -0.025], [0.1, -0.025], [0.1, 0.025], [-0.1, 0.025],
    ])  # fmt: skip
    centre_of_mass = np.array([0.025, -0.053])
    return Block(rectangles - np.tile(centre_of_mass, 2), outline - centre_of_mass, 0.035)


def place(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Body-frame points [N, 3] (m) at planar poses [..., 3] (x, y in m, yaw in rad), world frame [..., N, 3]."""
    pose = np.asarray(pose, np.float64)
    cos, sin = np.cos(pose[..., 2])[..., None], np.sin(pose[..., 2])[..., None]
    x = cos * points[:, 0] - sin * points[:, 1] + pose[..., 0, None]
    y = sin * points[:, 0] + cos * points[:, 1] + pose[..., 1, None]
    return np.stack([x, y, np.broadcast_to(points[:, 2], x.shape)], axis=-1)
