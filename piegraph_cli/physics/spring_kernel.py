"""The spring-mass system as a kernel: guidance and a pusher's stroke, for many candidates at once.

The truth is `physics.simulation`, in the same words; this holds to it within 1e-5 m and is tested so. A group of
candidates stops when all of it is at rest, whatever the others do.
"""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from piegraph_cli.kernels.lanes import KERNEL, Launch, accessors, bandwidth_order, start_warp, vector
from piegraph_cli.physics.params import GuidanceParams
from piegraph_cli.physics.simulation import (
    CHECK_EVERY,
    SHORTEST,
    PushParams,
    check_guidance,
    check_push,
)
from piegraph_cli.physics.springs import SpringGraph

LANES = 32
"""Candidates in a group on a CPU. Measured: 16 take half as long again, 64 a tenth longer, since less fits the cache."""

TINY = wp.constant(SHORTEST)
EVERY = wp.constant(CHECK_EVERY)


@wp.struct
class Springs:
    """A graph as the kernels read it: each spring belongs to the earlier of its particles."""

    order: wp.array(dtype=wp.int32)
    """[N] the particle that comes at each place."""
    first: wp.array(dtype=wp.int32)
    """[N + 1] where the springs of each begin."""
    second: wp.array(dtype=wp.int32)
    """[S] the later particle of each spring."""
    rest: wp.array(dtype=wp.float32)
    """[S] metres."""


@dataclass(frozen=True)
class _Terms:
    """Which terms a kernel has at all: a test in its inner loop costs more than the term it skips."""

    friction: bool
    tension_only: bool = False
    integral: bool = False
    derivative: bool = False
    held: bool = False


@dataclass(frozen=True)
class _Kernels:
    guide: wp.Kernel
    push: wp.Kernel


@functools.cache
def _kernels(lanes: int, terms: _Terms) -> _Kernels:
    """The kernels for groups of `lanes` candidates. Each particle's springs are those to later particles."""
    friction_acts, tension_only = terms.friction, terms.tension_only
    integral_acts, derivative_acts, held_acts = terms.integral, terms.derivative, terms.held
    vec = vector(lanes)
    load, store = accessors(lanes)
    zero, tiny2 = vec(0.0), vec(SHORTEST * SHORTEST)

    @wp.func
    def inverse_root(a: vec) -> vec:
        r = vec()
        for k in range(lanes):
            r[k] = 1.0 / wp.sqrt(a[k])
        return r

    @wp.func
    def springs(
        i: int,
        x: wp.array2d(dtype=vec),
        force: wp.array2d(dtype=vec),
        graph: Springs,
        stiffness: float,
    ):
        """The sum of all spring forces on particle i; later particles get their share, that of i is set back to zero."""
        xi = x[i, 0]
        yi = x[i, 1]
        zi = x[i, 2]
        fx = force[i, 0]
        fy = force[i, 1]
        fz = force[i, 2]
        for s in range(graph.first[i], graph.first[i + 1]):
            j = graph.second[s]
            dx = x[j, 0] - xi
            dy = x[j, 1] - yi
            dz = x[j, 2] - zi
            square = wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy) + wp.cw_mul(dz, dz)
            strain = vec(stiffness) - inverse_root(wp.max(square, tiny2)) * (stiffness * graph.rest[s])
            if wp.static(tension_only):
                strain = wp.max(strain, zero)
            px, py, pz = wp.cw_mul(strain, dx), wp.cw_mul(strain, dy), wp.cw_mul(strain, dz)
            fx += px
            fy += py
            fz += pz
            force[j, 0] = force[j, 0] - px
            force[j, 1] = force[j, 1] - py
            force[j, 2] = force[j, 2] - pz
        force[i, 0] = zero
        force[i, 1] = zero
        force[i, 2] = zero
        return fx, fy, fz

    @wp.func
    def sliding(vx: vec, vy: vec, lift: vec, friction: float) -> vec:
        """What Coulomb friction leaves of a planar velocity where the table lifts a particle by `lift` (m)."""
        r = vec()
        for k in range(lanes):
            speed = wp.sqrt(wp.max(vx[k] * vx[k] + vy[k] * vy[k], TINY * TINY * TINY * TINY))
            r[k] = 1.0 - wp.min(friction * lift[k] / speed, 1.0)
        return r

    @wp.func
    def fastest(a: vec) -> float:
        r = a[0]
        for k in range(1, lanes):
            r = wp.max(r, a[k])
        return r

    @wp.kernel(**KERNEL)
    def guide(
        first_group: int,
        first_slot: int,
        apart: int,
        positions: wp.array3d(dtype=wp.float32),
        setpoint: wp.array3d(dtype=wp.float32),
        weights: wp.array3d(dtype=wp.float32),
        velocity: wp.array3d(dtype=wp.float32),
        out: wp.array3d(dtype=wp.float32),
        graph: Springs,
        states: wp.array3d(dtype=vec),
        velocities: wp.array3d(dtype=vec),
        forces: wp.array3d(dtype=vec),
        targets: wp.array3d(dtype=vec),
        sums: wp.array3d(dtype=vec),
        stiffness: float,
        damping: float,
        gain: float,
        integral: float,
        integral_limit: float,
        derivative: float,
        friction: float,
        iterations: int,
        tolerance: float,
    ):
        group = first_group + wp.tid()
        slot = first_slot + wp.tid() * apart
        x = states[slot]
        v = velocities[slot]
        force = forces[slot]
        target = targets[slot]
        summed = sums[slot]
        particles = graph.order.shape[0]
        for i in range(particles):
            for c in range(3):
                x[i, c] = load(positions, group, graph.order[i], c)
                v[i, c] = load(velocity, group, graph.order[i], c)
                target[i, c] = load(setpoint, group, graph.order[i], c)
                force[i, c] = zero
                summed[i, c] = zero
            target[i, 3] = load(weights, group, graph.order[i], 0)
        for iteration in range(1, iterations + 1):
            looks = iteration % EVERY == 0
            largest = zero
            for i in range(particles):
                fx, fy, fz = springs(i, x, force, graph, stiffness)
                vx = v[i, 0]
                vy = v[i, 1]
                vz = v[i, 2]
                if looks:
                    largest = wp.max(largest, wp.cw_mul(vx, vx) + wp.cw_mul(vy, vy) + wp.cw_mul(vz, vz))
                w = target[i, 3]
                ex = target[i, 0] - x[i, 0]
                ey = target[i, 1] - x[i, 1]
                ez = target[i, 2] - x[i, 2]
                fx += wp.cw_mul(w, ex) * gain
                fy += wp.cw_mul(w, ey) * gain
                fz += wp.cw_mul(w, ez) * gain
                if wp.static(integral_acts):
                    sx = summed[i, 0] + ex
                    sy = summed[i, 1] + ey
                    sz = summed[i, 2] + ez
                    square = wp.cw_mul(sx, sx) + wp.cw_mul(sy, sy) + wp.cw_mul(sz, sz)
                    share = wp.min(inverse_root(wp.max(square, tiny2)) * integral_limit, vec(1.0))
                    sx, sy, sz = wp.cw_mul(sx, share), wp.cw_mul(sy, share), wp.cw_mul(sz, share)
                    summed[i, 0] = sx
                    summed[i, 1] = sy
                    summed[i, 2] = sz
                    fx += wp.cw_mul(w, sx) * integral
                    fy += wp.cw_mul(w, sy) * integral
                    fz += wp.cw_mul(w, sz) * integral
                if wp.static(derivative_acts):
                    fx -= wp.cw_mul(w, vx) * derivative
                    fy -= wp.cw_mul(w, vy) * derivative
                    fz -= wp.cw_mul(w, vz) * derivative
                vx = (vx + fx) * damping
                vy = (vy + fy) * damping
                vz = (vz + fz) * damping
                lift = wp.max(x[i, 2] + vz, zero) - (x[i, 2] + vz)
                vz = vz + lift
                if wp.static(friction_acts):
                    kept = sliding(vx, vy, lift, friction)
                    vx = wp.cw_mul(vx, kept)
                    vy = wp.cw_mul(vy, kept)
                x[i, 0] = x[i, 0] + vx
                x[i, 1] = x[i, 1] + vy
                x[i, 2] = x[i, 2] + vz
                v[i, 0] = vx
                v[i, 1] = vy
                v[i, 2] = vz
                if looks:
                    largest = wp.max(largest, wp.cw_mul(vx, vx) + wp.cw_mul(vy, vy) + wp.cw_mul(vz, vz))
            if looks and fastest(largest) < tolerance * tolerance:
                break
        for i in range(particles):
            for c in range(3):
                store(out, group, graph.order[i], c, x[i, c])
                store(velocity, group, graph.order[i], c, v[i, c])

    @wp.kernel(**KERNEL)
    def push(
        first_group: int,
        first_slot: int,
        apart: int,
        positions: wp.array3d(dtype=wp.float32),
        path: wp.array3d(dtype=wp.float32),
        held: wp.array3d(dtype=wp.float32),
        discs: wp.array3d(dtype=wp.float32),
        out: wp.array3d(dtype=wp.float32),
        graph: Springs,
        states: wp.array3d(dtype=vec),
        velocities: wp.array3d(dtype=vec),
        forces: wp.array3d(dtype=vec),
        grips: wp.array3d(dtype=vec),
        stiffness: float,
        damping: float,
        friction: float,
        gravity: float,
    ):
        group = first_group + wp.tid()
        slot = first_slot + wp.tid() * apart
        x = states[slot]
        v = velocities[slot]
        force = forces[slot]
        grip = grips[slot]
        particles = graph.order.shape[0]
        radius = load(discs, group, 0, 0)
        last_x, last_y = load(path, group, 0, 0), load(path, group, 0, 1)
        for i in range(particles):
            for c in range(3):
                x[i, c] = load(positions, group, graph.order[i], c)
                v[i, c] = zero
                force[i, c] = zero
            if wp.static(held_acts):
                grip[i, 0] = load(held, group, graph.order[i], 0)
        for t in range(path.shape[1]):
            cx, cy = load(path, group, t, 0), load(path, group, t, 1)
            for i in range(particles):
                fx, fy, fz = springs(i, x, force, graph, stiffness)
                vx = (v[i, 0] + fx) * damping
                vy = (v[i, 1] + fy) * damping
                vz = (v[i, 2] + fz - vec(gravity)) * damping
                lift = wp.max(x[i, 2] + vz, zero) - (x[i, 2] + vz)
                vz = vz + lift
                if wp.static(friction_acts):
                    kept = sliding(vx, vy, lift, friction)
                    vx = wp.cw_mul(vx, kept)
                    vy = wp.cw_mul(vy, kept)
                px = x[i, 0] + vx
                py = x[i, 1] + vy
                pz = x[i, 2] + vz
                for k in range(lanes):
                    ox = px[k] - cx[k]
                    oy = py[k] - cy[k]
                    if wp.max(wp.abs(ox), wp.abs(oy)) < TINY:
                        ox += TINY
                    distance = wp.max(wp.sqrt(ox * ox + oy * oy), TINY)
                    out_of = wp.max(radius[k] / distance - 1.0, 0.0)
                    px[k] = px[k] + ox * out_of
                    py[k] = py[k] + oy * out_of
                    vx[k] = vx[k] + ox * out_of
                    vy[k] = vy[k] + oy * out_of
                if wp.static(held_acts):
                    h = grip[i, 0]
                    free = vec(1.0) - h
                    px = wp.cw_mul(px, free) + wp.cw_mul(h, x[i, 0] + cx - last_x)
                    py = wp.cw_mul(py, free) + wp.cw_mul(h, x[i, 1] + cy - last_y)
                    pz = wp.cw_mul(pz, free) + wp.cw_mul(h, x[i, 2])
                    vx, vy, vz = wp.cw_mul(vx, free), wp.cw_mul(vy, free), wp.cw_mul(vz, free)
                x[i, 0] = px
                x[i, 1] = py
                x[i, 2] = pz
                v[i, 0] = vx
                v[i, 1] = vy
                v[i, 2] = vz
            last_x, last_y = cx, cy
        for i in range(particles):
            for c in range(3):
                store(out, group, graph.order[i], c, x[i, c])

    return _Kernels(guide, push)


@functools.lru_cache(maxsize=32)
def _packed(graph: SpringGraph, device: torch.device) -> Springs:
    start_warp()
    order = bandwidth_order(graph.pairs, graph.particles)
    pairs = np.sort(np.argsort(order)[graph.pairs], axis=1)
    by_first = np.lexsort((pairs[:, 1], pairs[:, 0]))
    springs = Springs()
    springs.order = wp.array(order.astype(np.int32), dtype=wp.int32, device=str(device))
    first = np.searchsorted(pairs[by_first, 0], np.arange(graph.particles + 1))
    springs.first = wp.array(first.astype(np.int32), dtype=wp.int32, device=str(device))
    springs.second = wp.array(pairs[by_first, 1].astype(np.int32), dtype=wp.int32, device=str(device))
    springs.rest = wp.array(graph.rest_length[by_first].astype(np.float32), dtype=wp.float32, device=str(device))
    return springs


def guide(
    positions: Tensor,
    setpoint: Tensor,
    graph: SpringGraph,
    params: GuidanceParams = GuidanceParams(),
    weights: Tensor | None = None,
) -> Tensor:
    """`physics.simulation.guide` in float32, without gradients: positions, setpoint [B, N, 3] (m) and weights [B, N].

    Raises as the reference does. Source: paper, Eq. 3 and 4.
    """
    check_guidance(positions, setpoint, graph, params, weights)
    weights = torch.ones_like(positions[..., 0]) if weights is None else weights
    return _drive(positions, torch.zeros_like(positions), setpoint, weights, graph, params)


def drive(
    positions: Tensor, velocity: Tensor, setpoint: Tensor, graph: SpringGraph, params: GuidanceParams, weights: Tensor
) -> tuple[Tensor, Tensor]:
    """`physics.simulation.drive` in float32, without gradients: positions and velocity [N, 3] afterwards."""
    velocity = velocity.clone()
    out = _drive(positions[None], velocity[None], setpoint[None], weights[None], graph, params)
    return out[0], velocity


def _drive(
    positions: Tensor, velocity: Tensor, setpoint: Tensor, weights: Tensor, graph: SpringGraph, params: GuidanceParams
) -> Tensor:
    """Positions [B, N, 3] afterwards; velocity [B, N, 3] becomes that of the end. weights: [B, N]."""
    launch = Launch(len(positions), positions.device, LANES)
    out = torch.empty_like(positions)
    size = graph.particles
    arguments: list[Any] = [
        positions.contiguous(),
        setpoint.contiguous(),
        weights[..., None].contiguous(),
        velocity,
        out,
    ]
    arguments += [_packed(graph, positions.device)]
    arguments += [launch.scratch(size, 3) for _ in range(3)] + [launch.scratch(size, 4), launch.scratch(size, 3)]
    arguments += [params.stiffness, params.damping, params.gain, params.integral, params.integral_limit]
    arguments += [params.derivative, params.friction, params.iterations, params.tolerance]
    terms = _Terms(params.friction > 0, params.tension_only, params.integral > 0, params.derivative > 0)
    launch.run(_kernels(launch.lanes, terms).guide, arguments)
    return out


def push(
    positions: Tensor,
    path: Tensor,
    graph: SpringGraph,
    params: PushParams = PushParams(),
    held: Tensor | None = None,
) -> Tensor:
    """`physics.simulation.push` in float32, without gradients: positions [B, N, 3], path [B, T, 2] (m), held [B, N].

    Raises as the reference does. Source: paper, Eq. 3, with contact as the external force.
    """
    *numbers, radius = check_push(positions, path, graph, params)
    launch = Launch(len(positions), positions.device, LANES)
    out = torch.empty_like(positions)
    grip = torch.zeros_like(positions[..., 0]) if held is None else held.to(positions)
    discs = torch.where(grip.any(1), 0.0, radius).to(positions)[:, None, None]
    arguments: list[Any] = [positions.contiguous(), path.contiguous(), grip[..., None].contiguous(), discs, out]
    arguments += [_packed(graph, positions.device)]
    arguments += [launch.scratch(graph.particles, 3) for _ in range(3)] + [launch.scratch(graph.particles, 1)]
    arguments += numbers
    terms = _Terms(numbers[2] > 0, params.tension_only, held=held is not None)
    launch.run(_kernels(launch.lanes, terms).push, arguments)
    return out
