"""The outline of a rigid body that its strokes refine: smooth offsets from that of the particles, fitted with its numbers."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from piegraph_cli.dynamics.poses import in_frame, pose_after, seen_from
from piegraph_cli.dynamics.rigid_kernel import push

PIECE = 0.5
"""Spacings of particles that a piece of the outline is long, at most."""
OFFSET, ALIKE, MODES = 0.2, 0.5, 80
"""Deviation of the outline from where the particles have it, and how far along it that is alike, in spacings; its modes."""
NUMBERS = 5
TOUCHED = 0.003
"""Metres that a stroke moves the body by, from which the pusher touches it in the end."""
USUAL, WEIGHT = 0.004, 5
"""Error of a stroke (m) before any is seen, and how many strokes that counts as."""
SURE = 1.5e-3
"""Metres that the touch is off, at least."""
STRIDE = 1e-3
"""Metres of the pusher in a step while fitting."""
STARTS = ((0, -3, -1.5, -0.5, 0.5, 1.5, 3), (0, -2, -1, 1, 2), (0, -0.5, 1))
"""Friction, turning length and reach that are tried before the first round, in deviations."""
ROUNDS, STEP, ENOUGH = 12, 0.1, 0.02
"""Most rounds, step of differences, and gain of the last round."""
DAMPING = (0.03, 0.3, 3.0, 30.0)
"""What is tried in a round, times the damping of the round before."""
FARTHEST = 1.5
"""Deviations that one round goes, at most."""


class Contour:
    """An outline whose corners may lie off their places, along their normals, by what a few smooth modes add up to."""

    def __init__(self, edges: np.ndarray, spacing: float):
        """edges [E, 4] (m): a closed outline in pieces; `spacing` (m): of the particles that it is of."""
        pieces = _cut(edges, PIECE * spacing)
        corners, index = np.unique(np.round(pieces.reshape(-1, 2), 9), axis=0, return_inverse=True)
        self.corners, self.index = corners, index.reshape(-1, 2)
        along = pieces[:, 2:] - pieces[:, :2]
        normals = np.stack([along[:, 1], -along[:, 0]], 1) / np.linalg.norm(along, axis=1, keepdims=True)
        middle = (pieces[:, :2] + pieces[:, 2:]) / 2
        normals *= np.sign(apart(pieces[None], middle + 1e-5 * normals)[0])[:, None]
        self.normals = np.zeros_like(corners)
        for end in self.index.T:
            np.add.at(self.normals, end, normals)
        self.normals /= np.maximum(np.linalg.norm(self.normals, axis=1, keepdims=True), 1e-9)
        distance = np.square(corners[:, None] - corners).sum(-1) / (ALIKE * spacing) ** 2
        values, vectors = np.linalg.eigh(np.exp(-distance / 2 + self.normals @ self.normals.T - 1))
        first = np.argsort(-values)[:MODES]
        self.modes = OFFSET * spacing * (vectors[:, first] * np.sqrt(np.maximum(values[first], 0))).T

    def edges(self, offsets: np.ndarray) -> np.ndarray:
        """Outlines [K, E, 4] (m) by so many modes [K, MODES] each, in deviations."""
        places = self.corners + (offsets @ self.modes)[..., None] * self.normals
        return places[:, self.index].reshape(len(offsets), -1, 4)


def _cut(edges: np.ndarray, longest: float) -> np.ndarray:
    """Pieces [P, 4] of edges [E, 4] (m) that are no longer than that."""
    parts = []
    for start, end in edges.reshape(-1, 2, 2):
        count = max(math.ceil(float(np.linalg.norm(end - start)) / longest), 1)
        points = start + np.linspace(0, 1, count + 1)[:, None] * (end - start)
        parts.append(np.hstack([points[:-1], points[1:]]))
    return np.concatenate(parts)


def apart(edges: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far [K, P] (m) points [P, 2] are outside of outlines [K, E, 4]; negative inside."""
    start, piece, at = edges[:, None, :, :2], edges[:, None, :, 2:] - edges[:, None, :, :2], points[None, :, None]
    square = np.square(piece).sum(-1)
    share = np.clip(((at - start) * piece).sum(-1) / np.maximum(square, 1e-18), 0, 1)
    distance = np.linalg.norm(at - start - share[..., None] * piece, axis=-1).min(-1)
    rise = piece[..., 1]
    spans = (start[..., 1] > at[..., 1]) != (start[..., 1] + rise > at[..., 1])
    cut = start[..., 0] + (at[..., 1] - start[..., 1]) / np.where(rise == 0, 1.0, rise) * piece[..., 0]
    return np.where((spans & (at[..., 0] < cut)).sum(-1) % 2 == 1, -distance, distance)


@dataclass(frozen=True)
class Left:
    """What fits leave of strokes: of motions [K, S, 3], of the touch in the end and of the beginning [K, S], all in m."""

    motion: np.ndarray
    touch: np.ndarray
    begin: np.ndarray

    def one(self, k: int) -> "Left":
        """That of one fit, [1, S, ...]."""
        return Left(self.motion[k : k + 1], self.touch[k : k + 1], self.begin[k : k + 1])


class Fit:
    """Numbers of a body and offsets of its outline, in deviations from what is thought before strokes are seen.

    A stroke tells where the body ends; that the pusher touches the outline there, if it moved it; and that the pusher
    was not inside of it in the beginning. Steps of Gauss and Newton, errors weighed so that one stroke that is off counts
    little, on a Gaussian prior of the outline and a heavy-tailed one of the numbers.
    """

    def __init__(
        self, contour: Contour, scene: tuple[Tensor, ...], radius: float, numbers: Callable, bound: np.ndarray
    ):
        """`scene`: as of `RigidBody.scene`; `radius` (m): of gyration; `numbers`: of deviations [K, 5], bounded by `bound`."""
        poses, ends, before, after = scene
        self.contour, self.poses, self.ends, self.numbers, self.bound = contour, poses, ends, numbers, bound
        self.scale = np.array([1.0, 1.0, radius])
        done = pose_after(poses, before, after)
        self.motion = in_frame(poses, done).double().numpy() * self.scale
        self.moved = np.linalg.norm(self.motion, axis=1) > TOUCHED
        self.start = seen_from(poses, ends[:, :2]).double().numpy()
        self.end = seen_from(done, ends[:, 2:]).double().numpy()

    def left(self, x: np.ndarray) -> Left:
        """What candidates [K, 5 + MODES] leave."""
        edges, numbers = self.contour.edges(x[:, NUMBERS:]), self.numbers(x[:, :NUMBERS])
        sets, count = len(x), len(self.poses)
        poses, outlines = self.poses.repeat(sets, 1), torch.as_tensor(edges, dtype=torch.float32)
        moved = push(outlines, poses, self.ends.repeat(sets, 1), numbers.repeat_interleave(count, 0), STRIDE)
        motion = in_frame(poses, moved).double().numpy().reshape(sets, count, 3) * self.scale
        reach = numbers[:, 2:3].double().numpy()
        begin = np.minimum(apart(edges, self.start) - reach, 0)
        return Left(motion - self.motion, (apart(edges, self.end) - reach) * self.moved, begin)

    def cost(self, x: np.ndarray, left: Left, sure: float) -> np.ndarray:
        """[K], of candidates and what they leave; `sure` (m): how far the touch is usually off."""
        errors = np.linalg.norm(left.motion, axis=-1)
        known = (errors.shape[1] + WEIGHT) * np.log(self.error(errors))
        known += sum(np.log1p(np.square(off / sure)).sum(1) / 2 for off in (left.touch, left.begin))
        return known + np.log1p(np.square(x[:, :NUMBERS])).sum(1) + np.square(x[:, NUMBERS:]).sum(1) / 2

    def error(self, errors: np.ndarray) -> np.ndarray:
        """Of errors [K, S] (m) the mean [K], with what is thought before."""
        return (errors.sum(1) + WEIGHT * USUAL) / (errors.shape[1] + WEIGHT)

    def sure(self, left: Left) -> float:
        """Metres that the touch is usually off."""
        return max(SURE, float(np.median(np.abs(left.touch[0, self.moved])))) if self.moved.any() else SURE

    def find(self) -> tuple[np.ndarray, np.ndarray]:
        """The candidate [5 + MODES] that costs least, and the curvature [5 + MODES, 5 + MODES] of the cost there."""
        size = NUMBERS + len(self.contour.modes)
        tries = np.zeros((math.prod(map(len, STARTS)), size))
        tries[:, : len(STARTS)] = list(itertools.product(*STARTS))
        all_left = self.left(tries)
        best = int(self.cost(tries, all_left, self.sure(all_left.one(0))).argmin())
        x, left, damping = tries[best], all_left.one(best), 1.0
        curve = np.eye(size)
        for _ in range(ROUNDS):
            sure = self.sure(left)
            slope, curve = self._slopes(x, left, sure)
            diagonal = np.diag(np.diag(curve))
            steps = [np.linalg.solve(curve + damping * d * diagonal, slope) for d in DAMPING]
            tries = self._bounded(x - np.clip(steps, -FARTHEST, FARTHEST))
            all_left = self.left(tries)
            costs, now = self.cost(tries, all_left, sure), float(self.cost(x[None], left, sure)[0])
            best = int(costs.argmin())
            if costs[best] >= now:
                damping *= 10
                continue
            x, left, damping = tries[best], all_left.one(best), max(damping * DAMPING[best], 1e-3)
            if costs[best] > now - ENOUGH:
                break
        return x, curve

    def _bounded(self, x: np.ndarray) -> np.ndarray:
        head = np.clip(x[:, :NUMBERS], -self.bound, self.bound)
        return np.concatenate([head, x[:, NUMBERS:]], 1)

    def _slopes(self, x: np.ndarray, left: Left, sure: float) -> tuple[np.ndarray, np.ndarray]:
        """Slope [D] and curvature [D, D] of the cost at a candidate [D]."""
        ahead = self.left(x + STEP * np.eye(len(x)))
        errors = np.linalg.norm(left.motion[0], axis=-1)
        mean = float(self.error(errors[None])[0])
        weight = 1 / (np.maximum(errors, mean / 5) * mean)
        prior = np.concatenate([2 / (1 + np.square(x[:NUMBERS])), np.ones(len(x) - NUMBERS)])
        slope, curve = prior * x, np.diag(prior)
        motion = (ahead.motion - left.motion) / STEP
        slope = slope + np.einsum("ask,sk,s->a", motion, left.motion[0], weight)
        curve = curve + np.einsum("ask,bsk,s->ab", motion, motion, weight)
        for then, now in ((ahead.touch, left.touch), (ahead.begin, left.begin)):
            change, weight = (then - now) / STEP, 1 / (sure**2 + np.square(now[0]))
            slope = slope + change @ (now[0] * weight)
            curve = curve + (change * weight) @ change.T
        return slope, curve

    def drawn(self, x: np.ndarray, curve: np.ndarray, count: int) -> np.ndarray:
        """So many candidates [count, 5 + MODES] as likely as the strokes leave them around the best one."""
        spread = np.linalg.cholesky(np.linalg.inv(curve))
        half = np.random.default_rng(0).standard_normal((count // 2, len(x))) @ spread.T
        return self._bounded(x + np.concatenate([half, -half]))
