"""Distances to the T-block, computed apart from the package, for its tests."""

import math

import numpy as np


def distance_to_block(env, pose, points):
    """Signed distance [P] (m) of planar points to the block's outline, negative inside."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    shifted = points - pose[:2]
    body = np.column_stack([cos * shifted[:, 0] + sin * shifted[:, 1], -sin * shifted[:, 0] + cos * shifted[:, 1]])
    corners = env.block.outline
    edges = np.roll(corners, -1, axis=0) - corners
    along = ((body[:, None] - corners) * edges).sum(-1) / (edges**2).sum(-1)
    nearest = corners + np.clip(along, 0, 1)[..., None] * edges
    distance = np.linalg.norm(body[:, None] - nearest, axis=-1).min(1)
    low, high = env.block.rectangles[:, :2], env.block.rectangles[:, 2:]
    inside = ((body[:, None] > low) & (body[:, None] < high)).all(-1).any(-1)
    return np.where(inside, -distance, distance)


def distance_to_surface(env, pose, points):
    """Distance [P] (m) of points [P, 3] to the block's surface."""
    aside = distance_to_block(env, pose, points[:, :2])
    above = np.maximum(points[:, 2] - env.block.height, -points[:, 2])
    outside = np.hypot(np.maximum(aside, 0), np.maximum(above, 0))
    return np.where((aside < 0) & (above < 0), -np.maximum(aside, above), outside)
