"""What models learn from: tracked sequences, as pairs of frames for one-step models and as windows for frame-by-frame ones."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import nn

from piegraph_cli.dynamics.egnn import Rest
from piegraph_cli.dynamics.losses import dynamics_loss
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError
from piegraph_cli.params import PICK

STILL = 1e-3
"""A hand that moves less than this between two frames (m) rests."""


@dataclass(frozen=True)
class Sequences:
    """Tracked sequences of one object, strokes cut."""

    positions: np.ndarray
    """[F, N, 3] metres."""
    hand: np.ndarray
    """[F, 2] metres."""
    strokes: np.ndarray
    """[S, 2] first and last frame."""
    mode: np.ndarray
    """[S] 0 push, 1 pick."""
    owner: np.ndarray
    """[S] the sequence of each stroke."""
    rest: np.ndarray
    """[Q, N, 3] the object of each sequence before its first stroke, metres."""
    pairs: np.ndarray
    """[P, 2] two frames of a stroke."""
    pair_stroke: np.ndarray
    """[P] the stroke of each pair."""
    seen: np.ndarray | None = None
    """[F, N] particles whose places are known, or None where all are."""

    @property
    def picks(self) -> bool:
        """Whether any stroke is a pick."""
        return bool((self.mode == PICK).any())

    @property
    def pace(self) -> float:
        """Metres that the hand moves between two frames, where it moves: the median."""
        steps = np.concatenate([np.linalg.norm(np.diff(self.hand[a : b + 1], axis=0), axis=1) for a, b in self.strokes])
        return float(np.median(steps[steps > STILL]))

    def grasped(self) -> np.ndarray:
        """[S] the particle nearest to the hand where each stroke begins."""
        first = self.strokes[:, 0]
        return np.linalg.norm(self.positions[first, :, :2] - self.hand[first, None], axis=-1).argmin(-1)

    def at_rest(self, most: int) -> list[np.ndarray]:
        """At most so many states [N, 3] (m) of the object: those at the ends of strokes, where nothing lifts it."""
        frames = np.unique(self.strokes)
        return list(self.positions[frames[np.unique(np.linspace(0, len(frames) - 1, most).astype(int))]])

    def whole(self) -> Strokes:
        """All strokes [S] from their first to their last frame."""
        first, last = self.strokes.T
        return Strokes.of(self.hand[first], self.hand[last], self.mode)


class Pairs:
    """Training pairs: start and end positions [P, N, 3] (m), strokes [P], whose object each is, and what picks hold."""

    def __init__(
        self,
        start: np.ndarray,
        end: np.ndarray,
        strokes: Strokes,
        rest: np.ndarray,
        owner: np.ndarray,
        grasp: np.ndarray,
        neighbors: int,
        device: str = "cpu",
        *,
        seen: np.ndarray | None = None,
        shape_weight: float = 0.1,
        mirror: bool = False,
        turn: bool = False,
    ):
        """`rest` [S, N, 3] (m): objects at rest; `owner` [P]: the object of each pair; `grasp` [P]: its grasped particle.

        `seen` [P, N]: the particles that teach, all by default.

        `mirror` reflects half of the pairs in y, `turn` turns each about the vertical, anew in every step.
        """
        self.start, self.end, at_rest = (
            torch.as_tensor(np.asarray(a, np.float32), device=device) for a in (start, end, rest)
        )
        self.strokes = strokes.to(torch.float32).to(device)
        self.rest = Rest.of(at_rest, neighbors)
        self.owner, self.grasp = (torch.as_tensor(np.asarray(a, np.int64), device=device) for a in (owner, grasp))
        self.seen = None if seen is None else torch.as_tensor(seen, device=device)
        self.shape_weight, self.mirror, self.turn = shape_weight, mirror, turn

    @classmethod
    def of(cls, data: Sequences, neighbors: int, device: str = "cpu", **settings) -> "Pairs":
        """The pairs of tracked sequences."""
        first, last = data.pairs.T
        stroke = data.pair_stroke
        begin, finish = data.strokes[stroke].T
        held = np.stack([first > begin, last < finish], 1)
        strokes = Strokes.of(data.hand[first], data.hand[last], data.mode[stroke], held)
        start, end = data.positions[first], data.positions[last]
        owner, grasp = data.owner[stroke], data.grasped()[stroke]
        seen = None if data.seen is None else data.seen[first] & data.seen[last]
        return cls(start, end, strokes, data.rest, owner, grasp, neighbors, device, seen=seen, **settings)

    @property
    def picks(self) -> bool:
        """Whether any stroke is a pick."""
        return bool((self.strokes.mode == PICK).any())

    def loss(self, network: nn.Module, chosen: torch.Tensor, rng: np.random.Generator | None = None) -> torch.Tensor:
        """`dynamics_loss` (dm^2) of the network on the chosen pairs [B], varied at random where `rng` is given."""
        rest = self.rest[self.owner[chosen]]
        start, end, strokes = self.start[chosen], self.end[chosen], self.strokes[chosen]
        if rng is not None and (self.mirror or self.turn):
            planar = planar_motions(rng, len(chosen), self.mirror, self.turn).to(start)
            start, end = move_in_plane(start, planar), move_in_plane(end, planar)
            strokes = strokes.moved(planar)
            rest = Rest(move_in_plane(rest.positions, planar), rest.neighbors)
        seen = None if self.seen is None else self.seen[chosen]
        predicted = network(start, strokes, rest, self.grasp[chosen])
        return dynamics_loss(predicted, end, rest.neighbors, self.shape_weight, seen)

    def static_loss(self, network: nn.Module, chosen: torch.Tensor) -> torch.Tensor:
        """The loss on the chosen pairs [B] if nothing moves."""
        neighbors = self.rest[self.owner[chosen]].neighbors
        seen = None if self.seen is None else self.seen[chosen]
        return dynamics_loss(self.start[chosen], self.end[chosen], neighbors, self.shape_weight, seen)

    def __len__(self) -> int:
        return len(self.start)


def planar_motions(rng: np.random.Generator, count: int, mirror: bool, turn: bool) -> torch.Tensor:
    """Random linear motions of the plane [count, 2, 2]: rotations, and reflections in y for half of them."""
    angle = rng.uniform(-np.pi, np.pi, count) if turn else np.zeros(count)
    sign = np.where(rng.random(count) < 0.5, -1.0, 1.0) if mirror else np.ones(count)
    cosine, sine = np.cos(angle), np.sin(angle)
    return torch.as_tensor(np.array([[cosine, -sine * sign], [sine, cosine * sign]]).transpose(2, 0, 1))


def move_in_plane(positions: torch.Tensor, motions: torch.Tensor) -> torch.Tensor:
    """Positions [B, ..., 3] under linear motions of the plane [B, 2, 2]."""
    flat = positions.reshape(len(positions), -1, 3)
    return torch.cat([flat[..., :2] @ motions.transpose(1, 2), flat[..., 2:]], -1).reshape(positions.shape)


@dataclass(frozen=True)
class Window:
    """A few frames in a row of B strokes; before a stroke's first frame its object rests."""

    past: torch.Tensor
    """[B, H + 1, N, 3] the frames up to now, newest last, metres."""
    hand: torch.Tensor
    """[B, R + 1, 2] the hand now and in the frames that follow, metres."""
    future: torch.Tensor
    """[B, R, N, 3] metres."""
    valid: torch.Tensor
    """[B, R] whether the stroke lasts so long."""
    mode: torch.Tensor
    """[B] 0 push, 1 pick."""
    grasp: torch.Tensor
    """[B] the particle nearest to the hand where the stroke began."""
    seen: torch.Tensor | None = None
    """[B, R, N] particles of the future whose places are known, or None where all are."""

    def known(self, step: int) -> torch.Tensor | None:
        """The particles [B, N] that are known `step` frames after the next, or None where all are."""
        return None if self.seen is None else self.seen[:, step]


def finer(data: Sequences, step: float) -> Sequences:
    """The strokes alone, with frames between theirs where the hand moves by more than `step` (m), on straight lines.

    What is between two frames is known where both are. There are no pairs.
    """
    frames, strokes, count = [], [], 0
    for first, last in data.strokes:
        moves = np.linalg.norm(np.diff(data.hand[first : last + 1], axis=0), axis=1)
        parts = np.maximum(np.rint(moves / step), 1).astype(int)
        between = [first + k + np.arange(n) / n for k, n in enumerate(parts)]
        frames.append(np.concatenate([*between, [last]]))
        strokes.append((count, count + len(frames[-1]) - 1))
        count += len(frames[-1])
    at = np.concatenate(frames)
    low = np.floor(at).astype(int)
    high, share = np.ceil(at).astype(int), (at - low).astype(np.float32)

    def along(of: np.ndarray) -> np.ndarray:
        weight = share.reshape(-1, *(1,) * (of.ndim - 1))
        return (1 - weight) * of[low] + weight * of[high]

    seen = None if data.seen is None else data.seen[low] & data.seen[high]
    none = np.zeros((0, 2), np.int64)
    return replace(
        data,
        positions=along(data.positions),
        hand=along(data.hand),
        strokes=np.array(strokes),
        pairs=none,
        pair_stroke=none[:, 0],
        seen=seen,
    )


Step = Callable[[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor]
"""Particles one frame later from past frames, the hand, where it goes, and the mode, as `Window` has them."""


class Windows:
    """All windows of tracked strokes: a frame that is not a stroke's last, with what came before and comes after."""

    def __init__(
        self,
        data: Sequences,
        history: int,
        rollout: int,
        device: str = "cpu",
        *,
        noise: float = 0.0,
        turn: bool = False,
    ):
        if len(data.strokes) == 0:
            raise DataError("no strokes to learn from", hint="record longer strokes")
        now = [np.arange(first, last) for first, last in data.strokes]
        stroke = np.repeat(np.arange(len(now)), [len(n) for n in now])
        first, last = data.strokes[stroke].T
        frame = np.concatenate(now)
        past = np.maximum(frame[:, None] + np.arange(-history, 1), first[:, None])
        after = frame[:, None] + np.arange(rollout + 1)
        self.past, self.after, self.valid, self.mode, self.grasp = (
            torch.as_tensor(a, device=device)
            for a in (
                past,
                np.minimum(after, last[:, None]),
                after[:, 1:] <= last[:, None],
                data.mode[stroke].astype(np.int64),
                data.grasped()[stroke],
            )
        )
        self.positions, self.hand = (
            torch.as_tensor(np.asarray(a, np.float32), device=device) for a in (data.positions, data.hand)
        )
        self.seen = None if data.seen is None else torch.as_tensor(data.seen, device=device)
        self.noise, self.turn = noise, turn

    def loss(self, network: nn.Module, chosen: torch.Tensor, rng: np.random.Generator | None = None) -> torch.Tensor:
        """The network's own loss on the chosen windows [B], varied at random where `rng` is given."""
        window = self._window(chosen)
        return network.loss(window if rng is None else self._vary(window, rng))  # type: ignore[operator]

    def static_loss(self, network: nn.Module, chosen: torch.Tensor) -> torch.Tensor:
        """The network's own loss on the chosen windows [B] if nothing moves."""
        return network.loss(self._window(chosen), lambda past, *_: past[:, -1])  # type: ignore[operator]

    def _window(self, chosen: torch.Tensor) -> Window:
        past, after = self.past[chosen], self.after[chosen]
        return Window(
            self.positions[past],
            self.hand[after],
            self.positions[after[:, 1:]],
            self.valid[chosen],
            self.mode[chosen],
            self.grasp[chosen],
            None if self.seen is None else self.seen[after[:, 1:]],
        )

    def _vary(self, window: Window, rng: np.random.Generator) -> Window:
        past, hand, future = window.past, window.hand, window.future
        if self.noise > 0:
            past = past + torch.as_tensor(rng.normal(0, self.noise, past.shape)).to(past)
        if self.turn:
            planar = planar_motions(rng, len(past), False, True).to(past)
            past, future = move_in_plane(past, planar), move_in_plane(future, planar)
            hand = hand @ planar.transpose(1, 2)
        return Window(past, hand, future, window.valid, window.mode, window.grasp, window.seen)

    def __len__(self) -> int:
        return len(self.past)
