"""The spring-mass system in motion: guidance to a setpoint, readable and differentiable; a pusher's stroke is in `pushing`.

This is the reference in PyTorch, for any float type and any batch; it knows nothing of clouds or networks.
Everything is dimensionless in time: a velocity is the displacement per iteration (m), a stiffness is α = k dt²/m,
a gain is κ = Kp dt²/m. Inside, states lie as [N, 3, B], so that the spring sums are products of one sparse matrix with
a [N, 3B] matrix: measured against gather/scatter, padded neighbours and dense products, that is the fastest both
for one state and for hundreds.
"""

import math
import warnings
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.physics.params import GuidanceParams
from piegraph_cli.physics.springs import SpringGraph, stability_bound

CHUNK = 128  # candidates simulated together, so that the arrays of their springs stay in the cache
CHECK_EVERY = 10  # iterations between two tests for convergence
SHORTEST = 1e-6  # metres; below it a spring has no direction worth a force


class _Product(torch.autograd.Function):
    """A constant sparse matrix times a dense one, with the transpose kept at hand for the gradient."""

    @staticmethod
    def forward(ctx, matrix: Tensor, transpose: Tensor, dense: Tensor) -> Tensor:
        ctx.matrix, ctx.transpose = matrix, transpose
        return matrix @ dense

    @staticmethod
    def backward(ctx, gradient: Tensor):
        return None, None, _Product.apply(ctx.transpose, ctx.matrix, gradient.contiguous())


def _product(matrix: Tensor, transpose: Tensor, dense: Tensor) -> Tensor:
    if torch.is_grad_enabled() and dense.requires_grad:
        return _Product.apply(matrix, transpose, dense)
    return matrix @ dense  # the bookkeeping of a gradient costs as much as a small product


class _Springs:
    """The graph as sparse matrices of one float type on one device."""

    def __init__(self, graph: SpringGraph, dtype: torch.dtype, device: torch.device):
        count = len(graph.pairs)
        rows = np.repeat(np.arange(count), 2)
        signs = np.tile([-1.0, 1.0], count)
        incidence = torch.sparse_coo_tensor(
            torch.as_tensor(np.stack([rows, graph.pairs.reshape(-1)])),
            torch.as_tensor(signs, dtype=dtype),
            (count, graph.particles),
            device=device,
            check_invariants=False,
        )
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
            self.difference = incidence.to_sparse_csr()  # particles to springs
            self.sum = incidence.t().coalesce().to_sparse_csr()  # springs to particles
        self.rest_length = torch.as_tensor(graph.rest_length, dtype=dtype, device=device)[:, None]

    def acceleration(self, positions: Tensor, stiffness: float | Tensor, tension_only: bool = False) -> Tensor:
        """α (l − r)(x_j − x_i)/l summed over the springs of each particle: [N, 3, B], m per iteration squared.

        With `tension_only` a spring shorter than at rest has no force.
        """
        particles, _, batch = positions.shape
        span = _product(self.difference, self.sum, positions.reshape(particles, 3 * batch)).view(-1, 3, batch)
        dx, dy, dz = span.unbind(1)
        inverse_length = (dx * dx + dy * dy + dz * dz).clamp_min(SHORTEST**2).rsqrt()
        strain = stiffness - stiffness * self.rest_length * inverse_length
        if tension_only:
            strain = strain.clamp_min(0)
        pull = (span * strain[:, None]).reshape(-1, 3 * batch)
        return -_product(self.sum, self.difference, pull).view(particles, 3, batch)


@lru_cache(maxsize=32)
def springs_of(graph: SpringGraph, dtype: torch.dtype, device: torch.device) -> _Springs:
    with torch.inference_mode(False):  # the cache serves callers that need gradients too
        return _Springs(graph, dtype, device)


def _move(positions: Tensor, velocity: Tensor, friction: float | Tensor) -> tuple[Tensor, Tensor]:
    """One displacement on a table: no particle [N, 3, B] ends below z = 0, and there Coulomb friction acts."""
    free = positions + velocity
    floor = torch.tensor([-torch.inf, -torch.inf, 0.0], dtype=free.dtype, device=free.device)[:, None]
    moved = torch.maximum(free, floor)
    correction = moved - free
    if friction > 0:
        slide, lift = velocity[:, :2], correction[:, 2]
        speed = (slide * slide).sum(1).clamp_min(SHORTEST**4).sqrt()
        stop = -slide * (friction * lift / speed).clamp_max(1)[:, None]
        correction = torch.cat([stop, lift[:, None]], dim=1)
        moved = free + correction
    return moved, velocity + correction


def guide(
    positions: Tensor,
    setpoint: Tensor,
    graph: SpringGraph,
    params: GuidanceParams = GuidanceParams(),
    weights: Tensor | None = None,
) -> Tensor:
    """Draw a spring object from rest towards a setpoint until it comes to rest: the nearest shape its springs allow.

    positions, setpoint: [B, N, 3] or [N, 3], metres; weights: [B, N] or [N], factors on the gain of each particle
    (0 lets it go where its springs pull it). Returns positions of the same shape, no particle below z = 0.
    Differentiable in positions, setpoint and weights. A batch runs until its slowest member is at rest.
    Raises UsageError for unstable parameters (with the bound), DataError for non-finite or unequal arrays.

    Source: paper, Eq. 3 and 4. Differs in two points: the force of a spring has a direction, +k (l − r)(x_j − x_i)/l
    (the paper's formula is a scalar), and the new velocity moves the positions (with the old one these gains diverge).
    """
    check_guidance(positions, setpoint, graph, params, weights)
    single = positions.dim() == 2
    states, targets = (a[None] if single else a for a in (positions, setpoint))
    factors = torch.ones_like(states[..., 0]) if weights is None else weights.expand(states.shape[:2])
    chunks = zip(*(a.split(CHUNK) for a in (states, targets, factors)), strict=True)
    guided = torch.cat([_guide_chunk(x, target, factor, graph, params) for x, target, factor in chunks])
    return guided[0] if single else guided


def _guide_chunk(
    positions: Tensor, setpoint: Tensor, weights: Tensor, graph: SpringGraph, params: GuidanceParams
) -> Tensor:
    x, target = (a.permute(1, 2, 0).contiguous() for a in (positions, setpoint))
    springs = springs_of(graph, x.dtype, x.device)
    moved, _ = _drive(x, torch.zeros_like(x), target, weights.t()[:, None], springs, params)
    return moved.permute(2, 0, 1).contiguous()


def drive(
    positions: Tensor, velocity: Tensor, setpoint: Tensor, graph: SpringGraph, params: GuidanceParams, weights: Tensor
) -> tuple[Tensor, Tensor]:
    """`guide` for one moving state: positions [N, 3] m, velocity [N, 3] m per iteration, after `params.iterations`.

    weights: [N]. Checks nothing, since it is called often: call `check_stability` once before.
    """
    springs = springs_of(graph, positions.dtype, positions.device)
    state, speed, target = (a[..., None] for a in (positions, velocity, setpoint))
    x, v = _drive(state, speed, target, weights[:, None, None], springs, params)
    return x[..., 0], v[..., 0]


def _drive(
    x: Tensor, velocity: Tensor, target: Tensor, weight: Tensor, springs: _Springs, params: GuidanceParams
) -> tuple[Tensor, Tensor]:
    """Iterate states [N, 3, B] towards targets until all are at rest. weight: [N, 1, B]."""
    gain, integral, derivative = (g * weight for g in (params.gain, params.integral, params.derivative))
    summed = torch.zeros_like(x)
    for iteration in range(1, params.iterations + 1):
        error = target - x
        control = gain * error
        if params.integral > 0:
            summed = summed + error
            length = summed.norm(dim=1, keepdim=True).clamp_min(SHORTEST)
            summed = summed * (params.integral_limit / length).clamp_max(1)
            control = control + integral * summed
        if params.derivative > 0:
            control = control - derivative * velocity
        last = velocity
        velocity = params.damping * (
            velocity + springs.acceleration(x, params.stiffness, params.tension_only) + control
        )
        x, velocity = _move(x, velocity, params.friction)
        if iteration % CHECK_EVERY == 0 and max(_speed(last), _speed(velocity)) < params.tolerance:
            break  # two iterations, since an overshoot is slow for one where it turns
    return x, velocity


def _speed(velocity: Tensor) -> float:
    """Largest displacement of a particle [N, 3, B] per iteration, metres."""
    return float((velocity.detach() ** 2).sum(1).max().sqrt())


def _finite(values: Tensor) -> bool:
    """Whether all are; a sum shows it faster than a look at each."""
    return math.isfinite(float(values.detach().sum()))


def check_state(positions: Tensor, graph: SpringGraph) -> None:
    if positions.shape[-2:] != (graph.particles, 3) or not _finite(positions):
        raise DataError(f"positions {tuple(positions.shape)} for {graph.particles} particles: unequal or not finite")


def check_guidance(
    positions: Tensor, setpoint: Tensor, graph: SpringGraph, params: GuidanceParams, weights: Tensor | None
) -> None:
    """Refuse what `guide` cannot work with: see there."""
    check_state(positions, graph)
    if setpoint.shape != positions.shape or not _finite(setpoint):
        raise DataError(
            f"setpoint {tuple(setpoint.shape)} for positions {tuple(positions.shape)}: unequal or not finite"
        )
    check_stability(graph, params, 1.0 if weights is None else float(weights.detach().max()))


def check_bound(graph: SpringGraph, stiffness: float, damping: float, gain: float) -> None:
    bound = stability_bound(graph, damping, gain)
    if stiffness >= bound:
        raise UsageError(
            f"stiffness {stiffness:.4g} is unstable: these springs bear less than {bound:.4g} at damping {damping:.3g}"
            f" and gain {gain:.3g}",
            hint=f"stiffness {max(0.8 * bound, 0):.3g}, fewer springs (a smaller radius), or a smaller gain",
        )


def check_stability(graph: SpringGraph, params: GuidanceParams, largest_weight: float = 1.0) -> None:
    """Refuse gains and stiffness whose linear motion grows: paper, Eq. 3 with the PID force, mode by mode."""
    gain, integral, derivative = (largest_weight * g for g in (params.gain, params.integral, params.derivative))
    check_bound(graph, params.stiffness, params.damping, gain + integral / 2 + 2 * derivative)
    if integral == 0:
        return
    kept = params.damping * (1 - derivative)
    forward = 1 + kept - params.damping * gain
    free = np.roots([1, -forward - 1 + params.damping * integral, kept + forward, -kept])  # no spring helps this mode
    if np.abs(free).max() > 1:
        raise UsageError(
            f"integral gain {params.integral:.4g} is unstable at gain {params.gain:.4g}, damping {params.damping:.3g}",
            hint="an integral gain of 0 (the default), or a tenth of this one",
        )
