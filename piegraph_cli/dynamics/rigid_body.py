"""A rigid body that is pushed over a table, quasi-statically: five numbers fitted to strokes, and an outline."""

import math
from typing import Any, ClassVar

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn

from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.params import RigidParams
from piegraph_cli.dynamics.rigid_contour import NUMBERS, Contour, Fit
from piegraph_cli.dynamics.rigid_kernel import push
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError
from piegraph_cli.params import PICK
from piegraph_cli.physics.rigid import moved_in_plane, planar_fit

STARTS = 12
"""Yaws from which one shape is laid on another whose particles do not correspond."""
MATCHED = 0.2
"""Spacings between particles and those of another state up to which they correspond."""
MOST = 400
"""Strokes that numbers are fitted to: as many of all, evenly spread."""
STIFF, WIDE = 0.002, 0.008
"""Metres from a rigid motion up to which nine of ten strokes leave what is rigid, and how wide (rms) that is at least."""
MOVED, SEVERAL = 0.005, 4
"""Strokes that move the object by so much (m) tell whether it is rigid, where there are so many."""
REACH = 1e-3
"""Least distance (m) between the pusher's centre and the outline."""
_NAMES = ("friction with the pusher", "turning length", "reach of the pusher", *["centre of friction"] * 2)
OTHERS = 4
"""Sets of numbers that other draws of the strokes would have given."""
_SPREAD = np.array([0.5, 0.3, 0.01, 0.004, 0.004])
"""Of the numbers before any stroke is seen: logarithms of friction and of c, then metres."""
_OPTIMISER: dict[str, Any] = {"popsize": 8, "maxiter": 40, "tol": 1e-4, "polish": False, "rng": 0}


class RigidBody(nn.Module):
    """What is known of a body: its outline and particles in a frame of its own, and the five numbers of pushing.

    The numbers are those of `rigid_kernel.push`. Before a stroke is seen they are the settings' and, for uniform pressure,
    four fifths of the radius of gyration. The paper has no such model.
    """

    learned: ClassVar[dict[str, tuple[int, ...]]] = {
        "edges": (0, 4),
        "shape": (0, 2),
        "numbers": (5,),
        "others": (0, 5),
        "other_edges": (0, 0, 4),
    }
    """Arrays that are learned, and their shapes; 0 for as many as there are. Earlier models have no others."""

    def __init__(self, params: RigidParams):
        super().__init__()
        self.params = params
        self.ended: list[tuple[str, float]] = []
        """Where in its range the fit of each number ended: 0 in the middle, 1 at a bound."""
        for name, shape in self.learned.items():
            self.register_buffer(name, torch.zeros(shape))

    def _load_from_state_dict(self, state_dict: dict, prefix: str, *rest: Any) -> None:
        for name in ("others", "other_edges"):
            state_dict.setdefault(prefix + name, getattr(self, name))
        for name, shape in self.learned.items():
            if 0 in shape and prefix + name in state_dict:
                setattr(self, name, torch.empty_like(state_dict[prefix + name]))
        super()._load_from_state_dict(state_dict, prefix, *rest)

    def fit(self, data: Sequences, corners: np.ndarray | None = None) -> tuple[float, float]:
        """Outline from the first sequence at rest, numbers from all strokes.

        `corners` [K, 2] (m): an outline that is given, in a frame of its own; it is laid on the particles. Returns the
        mean particle error (m) of the strokes after it, and how far (m) the particles are from moving rigidly. Raises
        `DataError` for picks, and for an outline of another body.
        """
        from piegraph_cli.dynamics.outline import (
            covered_outline,
            edges_of,
            laid_on,
            outline_of,
        )  # OpenCV and SciPy: planning does without

        if data.picks:
            raise DataError("strokes that hold the object: a rigid body is pushed", hint="train another model")
        self.shape = torch.as_tensor(_centred(data.rest[0]), dtype=torch.float32)
        points = self.shape.numpy()
        refine = self.params.refine and corners is None
        if corners is not None:
            outline = edges_of(laid_on(corners, points))
        else:
            outline = covered_outline(points) if refine else outline_of(points, self.params.alpha)
        self.edges = torch.as_tensor(outline, dtype=torch.float32)
        scene = self.scene(data)
        if refine and self.params.fit:
            self._refine(*scene)
        else:
            self._fit_numbers(*scene)
        bent = float(np.median(planar_residuals(*(states.numpy() for states in scene[2:]))))
        return float(self._errors(self.numbers[None], *scene).mean()), bent

    def scene(self, data: Sequences) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Of at most `MOST` strokes: poses [S, 3] before them, their ends [S, 4], particles before and after [S, N, 2]."""
        chosen = np.linspace(0, len(data.strokes) - 1, min(len(data.strokes), MOST)).astype(int)
        (first, last), owner = data.strokes[chosen].T, data.owner[chosen]
        frames = [body_frame(rest, self.shape.numpy()) for rest in data.rest]
        before, after = (data.positions[k][..., :2] for k in (first, last))
        poses = np.array([pose_now(data.rest[o], x, frames[o]) for o, x in zip(owner, before, strict=True)])
        ends = data.whole()[chosen].ends.flatten(1)
        arrays = (torch.as_tensor(np.asarray(a, np.float32)) for a in (poses, ends, before, after))
        at, along, start, end = arrays
        return at, along, start, end

    def _fit_numbers(self, *scene: Tensor) -> None:
        from scipy.optimize import differential_evolution  # planning does without

        middle, farthest = self._before()
        self.numbers = _numbers(middle[None])[0]
        if not self.params.fit:
            return

        tried: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

        def cost(x: np.ndarray) -> np.ndarray:
            errors = self._errors(_numbers(x.T), *scene).double().numpy()
            unlikely = np.log1p(((x.T - middle) / _SPREAD) ** 2).sum(1)
            tried.append((x.T.copy(), errors, unlikely))
            return len(scene[0]) * np.log(errors.mean(1)) + unlikely

        bounds = list(zip(middle - farthest, middle + farthest, strict=True))
        found = differential_evolution(cost, bounds, vectorized=True, updating="deferred", **_OPTIMISER)
        self._end_at(found.x)
        self.others = _numbers(_redrawn(*(np.concatenate(part) for part in zip(*tried, strict=True))))

    def _refine(self, *scene: Tensor) -> None:
        """Numbers and outline together."""
        middle, farthest = self._before()
        contour = Contour(self.edges.double().numpy(), spacing_of(self.shape.numpy()))

        def numbers(x: np.ndarray) -> Tensor:
            return _numbers(middle + x * _SPREAD)

        fit = Fit(contour, scene, self.gyration(), numbers, farthest / _SPREAD)
        best, curve = fit.find()
        others = fit.drawn(best, curve, OTHERS)
        self._end_at(middle + best[:NUMBERS] * _SPREAD)
        self.others = numbers(others[:, :NUMBERS])
        outlines = contour.edges(np.vstack([best, others])[:, NUMBERS:])
        self.edges, *rest = torch.as_tensor(outlines, dtype=torch.float32)
        self.other_edges = torch.stack(rest)

    def gyration(self) -> float:
        """Radius of gyration (m) of the particles: what turns are measured by."""
        return float(self.shape.square().sum(1).mean().sqrt())

    def _before(self) -> tuple[np.ndarray, np.ndarray]:
        """What is fitted [5] before strokes are seen, and how far from there it may end."""
        gyration = self.gyration()
        middle = np.array([math.log(self.params.friction), math.log(0.8 * gyration), self.params.reach, 0.0, 0.0])
        return middle, np.array([1.5, 0.9, 0.03, 0.6 * gyration, 0.6 * gyration])

    def _end_at(self, x: np.ndarray) -> None:
        """The numbers, of what is fitted [5], and where in its range each of them is."""
        middle, farthest = self._before()
        shares = np.abs(x - middle) / farthest
        shares[2] = max(shares[2], x[2] <= REACH)
        self.numbers = _numbers(x[None])[0]
        self.ended = list(zip(_NAMES, shares.tolist(), strict=True))

    def _errors(self, numbers: Tensor, poses: Tensor, strokes: Tensor, before: Tensor, after: Tensor) -> Tensor:
        """Mean particle error (m) [K, S] of every stroke [S] under every set of numbers [K, 5]."""
        sets, count = len(numbers), len(poses)
        moved = push(self.edges, poses.repeat(sets, 1), strokes.repeat(sets, 1), numbers.repeat_interleave(count, 0))
        found = carry(before.repeat(sets, 1, 1), poses.repeat(sets, 1), moved)
        return (found - after.repeat(sets, 1, 1)).norm(dim=-1).mean(1).reshape(sets, count)

    def predict(self, positions: Tensor, strokes: Strokes, rest: Tensor, frame: np.ndarray) -> Tensor:
        """Positions [B, N, 3] (m) after strokes [B]; `frame`: `body_frame` of the object at rest [N, 3]."""
        if bool((strokes.mode == PICK).any()):
            raise DataError("a pick: a rigid body is pushed", hint="plan with pushes alone, or another model")
        poses = _poses(rest[:, :2], positions[..., :2], frame)
        ends = strokes.ends.flatten(1).to(poses)
        return torch.cat([carry(positions[..., :2], poses, self.moved(poses, ends)), positions[..., 2:]], -1)

    def spread(self, positions: Tensor, strokes: Strokes, rest: Tensor, frame: np.ndarray) -> Tensor:
        """How far apart [B] (m) particles lie, as a deviation, under the numbers that other draws of strokes would give."""
        if not len(self.others):
            return positions.new_zeros(len(positions))
        sets, count = len(self.others), len(positions)
        poses = _poses(rest[:, :2], positions[..., :2], frame)
        ends, numbers = strokes.ends.flatten(1).to(poses), self.others.repeat_interleave(count, 0)
        edges = self.other_edges if len(self.other_edges) else self.edges
        moved = push(edges, poses.repeat(sets, 1), ends.repeat(sets, 1), numbers).reshape(sets, count, 3)
        middle, turns = moved[..., :2], moved[..., 2] * self.gyration()
        return (middle.var(0).sum(-1) + turns.var(0)).sqrt()

    def moved(self, poses: Tensor, ends: Tensor) -> Tensor:
        """Poses [B, 3] after strokes [B, 4] (m) from poses [B, 3]."""
        return push(self.edges, poses, ends, self.numbers.expand(len(poses), 5))


def _redrawn(x: np.ndarray, errors: np.ndarray, unlikely: np.ndarray) -> np.ndarray:
    """Of candidates [K, 5] those that fit best [`OTHERS`, 5] if the strokes are drawn anew, with errors [K, S] (m).

    A bootstrap without any further fit: what was tried on the way to the best lies close around it.
    """
    count = errors.shape[1]
    draws = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), OTHERS)
    return x[(count * np.log(errors @ draws.T / count) + unlikely[:, None]).argmin(0)]


def _numbers(x: np.ndarray) -> Tensor:
    """Numbers [K, 5] as the kernel takes them, from what is fitted."""
    return torch.as_tensor(
        np.column_stack([np.exp(x[:, :2]), np.maximum(x[:, 2:3], REACH), x[:, 3:]]), dtype=torch.float32
    )


def planar_residuals(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """How far [S] (m) particles [S, N, 2] are after strokes from where a rigid motion would have brought them, on average."""
    motions = [planar_fit(b, a) for b, a in zip(before, after, strict=True)]
    return np.array(
        [
            np.linalg.norm(moved_in_plane(b, m) - a, axis=1).mean()
            for b, a, m in zip(before, after, motions, strict=True)
        ]
    )


def is_rigid(data: Sequences) -> bool:
    """Whether all strokes are pushes and move the object as a rigid thing that covers an area: what a `RigidBody` is for."""
    before, after = (data.positions[k][..., :2] for k in data.strokes.T)
    moved = np.linalg.norm(after - before, axis=-1).mean(1) > MOVED
    wide = np.linalg.svd(_centred(data.rest[0]), compute_uv=False)[-1] / math.sqrt(data.rest.shape[1]) > WIDE
    if data.picks or not wide or moved.sum() < SEVERAL:
        return False
    return bool(np.quantile(planar_residuals(before[moved], after[moved]), 0.9) < STIFF)


def spacing_of(points: np.ndarray) -> float:
    """How far (m) points [N, 2] are from the nearest other, the median."""
    return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))


def body_frame(rest: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """The pose (x, y, yaw) of a body whose particles are `rest` [N, 2 or 3], given them in its own frame, [M, 2].

    The particles need not be the same ones: then the shapes are laid on each other from several yaws, and the best is taken.
    """
    points = rest[:, :2]
    spacing = spacing_of(shape)
    if len(points) == len(shape):
        pose = planar_fit(shape, points)
        if np.linalg.norm(moved_in_plane(shape, pose) - points, axis=1).mean() < MATCHED * spacing:
            return pose
    tree = cKDTree(points)
    tries = []
    for yaw in np.arange(STARTS) * (2 * math.pi / STARTS):
        pose = np.array([*(points.mean(0) - moved_in_plane(shape.mean(0), np.array([0.0, 0.0, yaw]))), yaw])
        for _ in range(20):
            laid = moved_in_plane(shape, pose)
            source = np.concatenate([shape, shape[cKDTree(laid).query(points)[1]]])
            pose = planar_fit(source, np.concatenate([points[tree.query(laid)[1]], points]))
        laid = moved_in_plane(shape, pose)
        tries.append((tree.query(laid)[0].mean() + cKDTree(laid).query(points)[0].mean(), pose))
    return min(tries, key=lambda entry: entry[0])[1]


def _poses(rest: Tensor, states: Tensor, frame: np.ndarray) -> Tensor:
    """Poses [B, 3] of the body in states [B, N, 2], given its pose at rest [N, 2]."""
    a, b = rest - rest.mean(0), states - states.mean(1, keepdim=True)
    yaw = torch.atan2((a[:, 0] * b[..., 1] - a[:, 1] * b[..., 0]).sum(1), (a * b).sum((1, 2)))
    offset = torch.as_tensor(frame[:2], dtype=rest.dtype, device=rest.device) - rest.mean(0)
    cosine, sine = yaw.cos(), yaw.sin()
    place = torch.stack([cosine * offset[0] - sine * offset[1], sine * offset[0] + cosine * offset[1]], 1)
    return torch.cat([states.mean(1) + place, (yaw + float(frame[2]))[:, None]], 1)


def carry(points: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """Points [B, N, 2] of bodies that went from one pose [B, 3] to another."""
    yaw = after[:, 2] - before[:, 2]
    cosine, sine = yaw.cos()[:, None], yaw.sin()[:, None]
    x, y = (points - before[:, None, :2]).unbind(-1)
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y], -1) + after[:, None, :2]


def pose_now(rest: np.ndarray, now: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """The pose [3] of a body at `frame` [3] (m, rad) when its particles were `rest` [N, 2 or 3], now that they are `now`."""
    motion = planar_fit(rest[:, :2], now[:, :2])
    return np.array([*moved_in_plane(frame[:2], motion), frame[2] + motion[2]])


def _centred(rest: np.ndarray) -> np.ndarray:
    return rest[:, :2] - rest[:, :2].mean(0)
