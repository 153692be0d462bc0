"""A spring-mass system alone: how springs with given numbers move under a stroke, whose hand pushes or carries them."""

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.params import PICK
from piegraph_cli.physics import spring_kernel
from piegraph_cli.physics.pushing import PushParams
from piegraph_cli.physics.springs import SpringGraph, build_springs, contour, stability_bound

STRIDE, SETTLE = 5e-4, 40
"""Metres of the hand in an iteration, and iterations after it has stopped, of springs whose numbers are fitted."""
HOLD = 0.02
"""Particles within this of where a pick starts are held [m]."""
STABLE = 0.8
"""Largest share of the stability bound that a stiffness may take."""
RADIUS, AS_GIVEN_STRIDE = 0.08, 1e-3
"""Of `sms-no`: longest springs, and the hand's motion in an iteration [m]."""
AS_GIVEN = PushParams(stiffness=0.1, damping=0.9, friction=5e-5, radius=0.015, grip=0.4, settle=20)
"""The numbers of `sms-no`."""


def stroke_path(strokes: Strokes, stride: float, settle: int) -> Tensor:
    """The hand's path [B, T, 2] (m) under strokes [B], `stride` (m) per iteration.

    At its end it waits for `settle` iterations, and for the longest stroke of the batch.
    """
    start, along, length = strokes.planar.start, strokes.along, strokes.length[:, None]
    count = math.ceil(float(length.max()) / stride)
    travelled = torch.arange(count + settle + 1, dtype=start.dtype, device=start.device) * stride
    return start[:, None] + (along / length)[:, None] * torch.minimum(travelled[None], length)[..., None]


def held_particles(positions: Tensor, strokes: Strokes, within: Tensor) -> Tensor:
    """Which particles [B, N] of positions [B, N, 3] (m) picks hold: those `within` (m; or [B]) of their start, one at least."""
    apart = (positions[..., :2] - strokes.planar.start[:, None]).norm(dim=-1)
    reach = torch.maximum(apart.amin(1, keepdim=True), within.to(apart).reshape(-1, 1))
    return (apart <= reach) & (strokes.mode == PICK)[:, None]


def object_springs(rest: np.ndarray, radius: float) -> SpringGraph:
    """The springs of an object at rest [N, 3] (m), with the contour that a pusher touches."""
    return replace(build_springs(rest, radius), contour=contour(rest))


def moved(
    positions: Tensor,
    strokes: Strokes,
    graph: SpringGraph,
    params: PushParams,
    stride: float = STRIDE,
    hold: Tensor | float = HOLD,
) -> Tensor:
    """Positions [B, N, 3] (m) after strokes [B]; `stride` (m) per iteration, `hold` (m; or [B]) as for `held_particles`."""
    assert params.settle is not None
    path = stroke_path(strokes, stride, params.settle)
    picks = bool((strokes.mode == PICK).any())
    held = held_particles(positions, strokes, torch.as_tensor(hold)) if picks else None
    return spring_kernel.push(positions, path, graph, params, held)


def as_given(graph: SpringGraph, tension_only: bool) -> PushParams:
    """What `sms-no` takes for these springs, as far as they bear it. Source: paper, IV-B, ablation SMS(NO)."""
    bound = STABLE * stability_bound(graph, float(AS_GIVEN.damping))
    return replace(AS_GIVEN, stiffness=min(float(AS_GIVEN.stiffness), bound), tension_only=tension_only)


def stiffness_of(graph: SpringGraph, numbers: Tensor) -> Tensor:
    """Stiffness k dt^2/m [...] of springs with numbers [..., 5]."""
    damping = numbers[..., 1].double().sigmoid()
    return numbers[..., 0] * stability_bound(graph, 0.5) * (1 + damping) / damping / 3  # the bound from that at 0.5


def push_params(graph: SpringGraph, numbers: Tensor, tension_only: bool = False) -> PushParams:
    """What the simulation takes of numbers [5] or [B, 5].

    They are stiffness as a share of what the springs bear, the logit of the damping, friction with the table (m), the
    pusher's reach (m) and its grip.
    """
    _, damping, friction, reach, grip = numbers.float().unbind(-1)
    stiffness = stiffness_of(graph, numbers).float()
    return PushParams(stiffness, damping.sigmoid(), friction, reach, grip, tension_only, SETTLE)
