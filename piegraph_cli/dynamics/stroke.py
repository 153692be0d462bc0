"""Strokes: where a pusher or gripper starts, where it ends, and what it does between; and what a model makes of them.

Rows of numbers, whose meaning is their place, are made here alone, for the kernels.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from piegraph_cli.errors import DataError
from piegraph_cli.kernels.recorded import recording
from piegraph_cli.params import PICK, PUSH

MIN_STROKE = 1e-3
"""Metres; a shorter stroke has no heading."""


@dataclass(frozen=True, eq=False)
class Strokes:
    """A batch [...] of strokes; indexing, stacking and splitting are the batch's."""

    start: Tensor
    """[..., 2] or, with heights, [..., 3] metres."""
    end: Tensor
    """As `start`."""
    mode: Tensor
    """[...] int64: 0 push, 1 pick."""
    held: Tensor
    """[..., 2] bool: whether a pick holds the object already at its start, and still at its end."""

    @classmethod
    def of(cls, start: Any, end: Any, mode: Any, held: Any = None) -> "Strokes":
        """Strokes from arrays as the fields name them; one mode may stand for all.

        Without `held` they are whole: grasped after their start, let go before their end. Raises `DataError` for shapes
        that do not belong together and for modes that there are not.
        """
        start, end = torch.as_tensor(start), torch.as_tensor(end)
        mode = torch.as_tensor(mode, device=start.device).long()
        held = torch.zeros(2, dtype=torch.bool) if held is None else torch.as_tensor(held)
        held = held.to(start.device, torch.bool)
        batch = start.shape[:-1]
        fits = start.ndim > 0 and start.shape[-1] in (2, 3) and start.shape == end.shape
        if not fits or mode.shape not in ((), batch) or held.shape not in ((2,), (*batch, 2)):
            shapes = ", ".join(
                f"{name} {list(part.shape)}"
                for name, part in (("start", start), ("end", end), ("mode", mode), ("held", held))
            )
            raise DataError(
                f"no strokes: {shapes}", hint="give start and end [..., 2] or [..., 3], mode [...], held [..., 2]"
            )
        unknown = (mode != PUSH) & (mode != PICK)
        if unknown.any():
            raise DataError(f"no mode {int(mode[unknown][0])}", hint=f"{PUSH} is a push, {PICK} a pick")
        return cls(start, end, mode.expand(batch), held.expand(*batch, 2))

    def _each(self, change: Callable[[Tensor], Tensor]) -> "Strokes":
        return Strokes(change(self.start), change(self.end), change(self.mode), change(self.held))

    def __len__(self) -> int:
        return len(self.mode)

    def __getitem__(self, index: Any) -> "Strokes":
        """Some strokes of the batch, by anything that indexes its axes from the first on."""
        return self._each(lambda field: field[index])

    def split(self, size: int) -> list["Strokes"]:
        """Chunks of at most `size` along the first axis."""
        return [self[k : k + size] for k in range(0, len(self), size)]

    @classmethod
    def stack(cls, parts: Sequence["Strokes"], axis: int = 0) -> "Strokes":
        """Batches of one shape, along a new axis."""
        rows = [(part.start, part.end, part.mode, part.held) for part in parts]
        return cls(*(torch.stack(column, axis) for column in zip(*rows, strict=True)))

    def to(self, *place: Any) -> "Strokes":
        """On another device, or with ends of another floating type: what `Tensor.to` takes."""
        start = self.start.to(*place)
        return Strokes(start, self.end.to(*place), self.mode.to(start.device), self.held.to(start.device))

    def clone(self) -> "Strokes":
        """In memory of their own."""
        return self._each(torch.clone)

    @property
    def planar(self) -> "Strokes":
        """As seen from above, without heights."""
        if self.start.shape[-1] == 2:
            return self
        return Strokes(self.start[..., :2], self.end[..., :2], self.mode, self.held)

    @property
    def ends(self) -> Tensor:
        """Start and end seen from above [..., 2, 2] (m)."""
        return torch.stack([self.planar.start, self.planar.end], -2)

    @property
    def along(self) -> Tensor:
        """From start to end, seen from above [..., 2] (m)."""
        return self.planar.end - self.planar.start

    @property
    def length(self) -> Tensor:
        """How long they are seen from above [...] (m)."""
        return self.along.norm(dim=-1)

    @property
    def rotation(self) -> Tensor:
        """R(phi) [..., 2, 2], which turns the x axis to the stroke's heading."""
        along = self.along
        cosine, sine = (along / along.norm(dim=-1, keepdim=True)).unbind(-1)
        return torch.stack([torch.stack([cosine, -sine], -1), torch.stack([sine, cosine], -1)], -2)

    def moved(self, motion: Tensor, shift: Tensor | None = None) -> "Strokes":
        """Under linear motions of the plane [..., 2, 2], turns or reflections, then shifted by [2] (m); heights stay."""
        ends = self.ends @ motion.transpose(-1, -2)
        ends = ends if shift is None else ends + shift
        start, end = (
            torch.cat([planar, whole[..., 2:]], -1)
            for planar, whole in zip(ends.unbind(-2), (self.start, self.end), strict=True)
        )
        return Strokes(start, end, self.mode, self.held)

    def check(self) -> None:
        """Refuse strokes [B] that are not finite or too short to have a heading. Raises `DataError` naming the first."""
        if recording():
            return
        known = (self.end - self.start).abs().amax(-1) < torch.inf  # not so for NaN, which comparisons deny
        bad = ~(known & (self.length >= MIN_STROKE))
        if bad.any():
            index = int(bad.nonzero()[0])
            ends = [*self.start[index].tolist(), *self.end[index].tolist()]
            raise DataError(
                f"start and end {ends} are equal or not finite: no heading",
                f"stroke {index}",
                f"give strokes of at least {MIN_STROKE * 1000:g} mm",
            )

    def packed(self) -> Tensor:
        """Rows [..., 7] for kernels: start x, y, end x, y (m), mode, held at start, held at end."""
        planar = self.planar
        return torch.cat([planar.start, planar.end, self.mode[..., None].to(self.start), self.held.to(self.start)], -1)

    def action(self) -> dict[str, np.ndarray | int]:
        """One stroke as what `step` of a simulated environment takes."""
        start, end = self.ends.numpy().astype(float)
        return {"start": start, "end": end, "mode": int(self.mode)}


Predict = Callable[[Tensor, Strokes], Tensor]
"""A model of one object: particles [B, N, 3] (m) before strokes [B] in, those after them out."""

Foresee = Callable[[Tensor, Strokes], tuple[Tensor, Tensor]]
"""The same, beside the signs [B, 2] (m) of how far off each prediction may be: see `dynamics.reliability`."""

Spread = Callable[[Tensor, Strokes, Tensor], Tensor]
"""How far apart [B] (m) strokes may end that are predicted to end in a state [B, N, 3] (m), from one before them."""
