"""The spring-mass system as a kernel: guidance and a pusher's stroke, for many candidates at once.

The truth is `physics.simulation` and `physics.pushing`, in the same words; this holds to them within 1e-5 m and is tested so.
A group of candidates stops when all of it is at rest, whatever the others do.
"""

import functools
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from piegraph_cli.kernels.lanes import (
    BLOCK_KERNEL,
    KERNEL,
    Launch,
    Standing,
    accessors,
    any_thread,
    bandwidth_order,
    barrier,
    cores,
    roots,
    start_warp,
    vector,
)
from piegraph_cli.kernels.recorded import recording
from piegraph_cli.physics.params import GuidanceParams
from piegraph_cli.physics.pushing import PushParams, check_push, clear
from piegraph_cli.physics.simulation import CHECK_EVERY, SHORTEST, check_guidance
from piegraph_cli.physics.springs import SpringGraph

LANES = 32
"""Candidates in a group on a CPU. Measured: 16 take half as long again, 64 a tenth longer, since less fits the cache."""

PARTS = wp.constant(2)
"""Threads of a GPU that share the springs of a particle. Measured: see docs/performance.md."""

TINY = wp.constant(SHORTEST)
EVERY = wp.constant(CHECK_EVERY)


@wp.struct
class Springs:
    """A graph as the kernels read it: on a CPU each spring belongs to the earlier of its particles, on a GPU to both."""

    order: wp.array(dtype=wp.int32)
    """[N] the particle that comes at each place."""
    first: wp.array(dtype=wp.int32)
    """[N + 1] where the springs of each begin."""
    second: wp.array(dtype=wp.int32)
    """[S] the other particle of each spring."""
    rest: wp.array(dtype=wp.float32)
    """[S] metres."""
    wall: wp.array(dtype=wp.int32)
    """[N + 1] where the segments of the contour begin that end in each."""
    other: wp.array(dtype=wp.int32)
    """[2 E] the other end of each."""


@wp.struct
class Numbers:
    """`GuidanceParams` as the kernels read them."""

    stiffness: wp.float32
    damping: wp.float32
    friction: wp.float32
    gain: wp.float32
    integral: wp.float32
    integral_limit: wp.float32
    derivative: wp.float32
    iterations: wp.int32
    tolerance: wp.float32


@wp.struct
class Scene:
    """What is asked of all candidates, and what becomes of them: arrays [B, N, ...]."""

    positions: wp.array3d(dtype=wp.float32)
    """[B, N, 3] metres."""
    setpoint: wp.array3d(dtype=wp.float32)
    """[B, N, 3] metres."""
    weights: wp.array3d(dtype=wp.float32)
    """[B, N, 1] factors on the gain; of a push, whether a hand holds the particle."""
    velocity: wp.array3d(dtype=wp.float32)
    """[B, N, 3] metres per iteration, in the beginning and then in the end."""
    out: wp.array3d(dtype=wp.float32)
    """[B, N, 3] metres."""


@wp.struct
class Stroke:
    """What pushes the candidates."""

    path: wp.array3d(dtype=wp.float32)
    """[B, T, 2] metres."""
    numbers: wp.array3d(dtype=wp.float32)
    """[B, 1, 6] of `check_push`; a radius of 0 where a hand holds particles."""


@dataclass(frozen=True)
class _Terms:
    """Which terms a kernel has at all: a test in its inner loop costs more than the term it skips."""

    friction: bool
    tension_only: bool = False
    integral: bool = False
    derivative: bool = False
    held: bool = False


@functools.cache
def _bodies(lanes: int) -> tuple[type, type]:
    """The state of a group's particles, each array [N, ...], and the scratch memory for it in every slot."""
    vec = vector(lanes)

    @wp.struct
    class Body:
        x: wp.array2d(dtype=vec)
        v: wp.array2d(dtype=vec)
        force: wp.array2d(dtype=vec)
        target: wp.array2d(dtype=vec)
        """The setpoint and the weight; of a push whether a hand holds the particle."""
        summed: wp.array2d(dtype=vec)

    @wp.struct
    class Bodies:
        x: wp.array3d(dtype=vec)
        v: wp.array3d(dtype=vec)
        force: wp.array3d(dtype=vec)
        target: wp.array3d(dtype=vec)
        summed: wp.array3d(dtype=vec)

    return Body, Bodies


@functools.cache
def _body_at(lanes: int) -> wp.Function:
    Body, Bodies = _bodies(lanes)

    @wp.func
    def body_at(bodies: Bodies, slot: int) -> Body:
        body = Body()
        body.x = bodies.x[slot]
        body.v = bodies.v[slot]
        body.force = bodies.force[slot]
        body.target = bodies.target[slot]
        body.summed = bodies.summed[slot]
        return body

    return body_at


@functools.cache
def _forces(lanes: int, tension_only: bool) -> tuple[wp.Function, wp.Function, wp.Function]:
    """The sum of all spring forces on a particle: for one thread that goes through them in order; and for many,
    of which some share a particle."""
    vec = vector(lanes)
    _, inverse_root, _ = roots(lanes)
    Body, _ = _bodies(lanes)
    zero, tiny2 = vec(0.0), vec(SHORTEST * SHORTEST)

    @wp.func
    def pull(dx: vec, dy: vec, dz: vec, rest: float, stiffness: float):
        """k (l - r) / l times the way to the other end."""
        square = wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy) + wp.cw_mul(dz, dz)
        strain = vec(stiffness) - inverse_root(wp.max(square, tiny2)) * (stiffness * rest)
        if wp.static(tension_only):
            strain = wp.max(strain, zero)
        return wp.cw_mul(strain, dx), wp.cw_mul(strain, dy), wp.cw_mul(strain, dz)

    @wp.func
    def springs_in_turn(i: int, body: Body, graph: Springs, stiffness: float):
        """Later particles get their share of the springs that are i's; what earlier ones left to i is set back to zero."""
        x = body.x
        force = body.force
        xi = x[i, 0]
        yi = x[i, 1]
        zi = x[i, 2]
        fx = force[i, 0]
        fy = force[i, 1]
        fz = force[i, 2]
        for s in range(graph.first[i], graph.first[i + 1]):
            j = graph.second[s]
            px, py, pz = pull(x[j, 0] - xi, x[j, 1] - yi, x[j, 2] - zi, graph.rest[s], stiffness)
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
    def springs_apart(item: int, body: Body, graph: Springs, stiffness: float):
        """A part of a particle's springs. Leaves the sum in `force`, since others still read the positions."""
        i, part = item / PARTS, item % PARTS
        x = body.x
        xi = x[i, 0]
        yi = x[i, 1]
        zi = x[i, 2]
        fx = vec(0.0)
        fy = vec(0.0)
        fz = vec(0.0)
        for s in range(graph.first[i] + part, graph.first[i + 1], PARTS):
            j = graph.second[s]
            px, py, pz = pull(x[j, 0] - xi, x[j, 1] - yi, x[j, 2] - zi, graph.rest[s], stiffness)
            fx += px
            fy += py
            fz += pz
        row = i + part * graph.order.shape[0]
        body.force[row, 0] = fx
        body.force[row, 1] = fy
        body.force[row, 2] = fz

    @wp.func
    def sum_of_parts(i: int, body: Body, particles: int):
        force = body.force
        fx = force[i, 0]
        fy = force[i, 1]
        fz = force[i, 2]
        for part in range(1, PARTS):
            fx += force[i + part * particles, 0]
            fy += force[i + part * particles, 1]
            fz += force[i + part * particles, 2]
        return fx, fy, fz

    return springs_in_turn, springs_apart, sum_of_parts


@functools.cache
def _controller(lanes: int, integral: bool, derivative: bool) -> wp.Function:
    vec = vector(lanes)
    _, inverse_root, _ = roots(lanes)
    Body, _ = _bodies(lanes)
    tiny2 = vec(SHORTEST * SHORTEST)

    @wp.func
    def controlled(i: int, fx: vec, fy: vec, fz: vec, body: Body, numbers: Numbers):
        """The force on particle i with that of the controller, which draws it to its setpoint."""
        target = body.target
        w = target[i, 3]
        ex = target[i, 0] - body.x[i, 0]
        ey = target[i, 1] - body.x[i, 1]
        ez = target[i, 2] - body.x[i, 2]
        gx = fx + wp.cw_mul(w, ex) * numbers.gain
        gy = fy + wp.cw_mul(w, ey) * numbers.gain
        gz = fz + wp.cw_mul(w, ez) * numbers.gain
        if wp.static(integral):
            summed = body.summed
            sx = summed[i, 0] + ex
            sy = summed[i, 1] + ey
            sz = summed[i, 2] + ez
            square = wp.cw_mul(sx, sx) + wp.cw_mul(sy, sy) + wp.cw_mul(sz, sz)
            share = wp.min(inverse_root(wp.max(square, tiny2)) * numbers.integral_limit, vec(1.0))
            sx, sy, sz = wp.cw_mul(sx, share), wp.cw_mul(sy, share), wp.cw_mul(sz, share)
            summed[i, 0] = sx
            summed[i, 1] = sy
            summed[i, 2] = sz
            gx += wp.cw_mul(w, sx) * numbers.integral
            gy += wp.cw_mul(w, sy) * numbers.integral
            gz += wp.cw_mul(w, sz) * numbers.integral
        if wp.static(derivative):
            gx -= wp.cw_mul(w, body.v[i, 0]) * numbers.derivative
            gy -= wp.cw_mul(w, body.v[i, 1]) * numbers.derivative
            gz -= wp.cw_mul(w, body.v[i, 2]) * numbers.derivative
        return gx, gy, gz

    return controlled


@functools.cache
def _table(lanes: int, friction_acts: bool) -> wp.Function:
    vec = vector(lanes)
    zero = vec(0.0)

    @wp.func
    def sliding(vx: vec, vy: vec, lift: vec, friction: float) -> vec:
        """What Coulomb friction leaves of a planar velocity where the table lifts a particle by `lift` (m)."""
        r = vec()
        for k in range(lanes):
            speed = wp.sqrt(wp.max(vx[k] * vx[k] + vy[k] * vy[k], TINY * TINY * TINY * TINY))
            r[k] = 1.0 - wp.min(friction * lift[k] / speed, 1.0)
        return r

    @wp.func
    def on_table(z: vec, vx: vec, vy: vec, vz: vec, friction: float):
        """The velocity with which a particle at height z ends above the table, and is braked there."""
        lift = wp.max(z + vz, zero) - (z + vz)
        if wp.static(friction_acts):
            kept = sliding(vx, vy, lift, friction)
            return wp.cw_mul(vx, kept), wp.cw_mul(vy, kept), vz + lift
        return vx, vy, vz + lift

    return on_table


@functools.cache
def _guided(lanes: int, terms: _Terms) -> tuple[wp.Function, wp.Function, wp.Function]:
    """What guidance does with a particle: take it in, move it for one iteration, give it back."""
    vec = vector(lanes)
    load, store = accessors(lanes)
    Body, _ = _bodies(lanes)
    controlled = _controller(lanes, terms.integral, terms.derivative)
    on_table = _table(lanes, terms.friction)
    zero = vec(0.0)

    @wp.func
    def take(i: int, group: int, body: Body, scene: Scene, order: wp.array(dtype=wp.int32)):
        for c in range(3):
            body.x[i, c] = load(scene.positions, group, order[i], c)
            body.v[i, c] = load(scene.velocity, group, order[i], c)
            body.target[i, c] = load(scene.setpoint, group, order[i], c)
            body.force[i, c] = zero
            body.summed[i, c] = zero
        body.target[i, 3] = load(scene.weights, group, order[i], 0)

    @wp.func
    def advance(i: int, fx: vec, fy: vec, fz: vec, body: Body, numbers: Numbers, looks: bool, largest: vec) -> vec:
        """One iteration under the springs' force; the largest squared speed, of those before and after, if it `looks`."""
        x = body.x
        v = body.v
        fastest = largest
        if looks:
            fastest = wp.max(fastest, squared(v[i, 0], v[i, 1], v[i, 2]))
        gx, gy, gz = controlled(i, fx, fy, fz, body, numbers)
        vx = (v[i, 0] + gx) * numbers.damping
        vy = (v[i, 1] + gy) * numbers.damping
        vz = (v[i, 2] + gz) * numbers.damping
        vx, vy, vz = on_table(x[i, 2], vx, vy, vz, numbers.friction)
        x[i, 0] = x[i, 0] + vx
        x[i, 1] = x[i, 1] + vy
        x[i, 2] = x[i, 2] + vz
        v[i, 0] = vx
        v[i, 1] = vy
        v[i, 2] = vz
        if looks:
            fastest = wp.max(fastest, squared(vx, vy, vz))
        return fastest

    @wp.func
    def squared(x: vec, y: vec, z: vec) -> vec:
        return wp.cw_mul(x, x) + wp.cw_mul(y, y) + wp.cw_mul(z, z)

    @wp.func
    def give(i: int, group: int, body: Body, scene: Scene, order: wp.array(dtype=wp.int32)):
        for c in range(3):
            store(scene.out, group, order[i], c, body.x[i, c])
            store(scene.velocity, group, order[i], c, body.v[i, c])

    return take, advance, give


@functools.cache
def _guide_kernel(lanes: int, terms: _Terms) -> wp.Kernel:
    """Guidance on a CPU: a thread works on a group at a time, particle by particle."""
    vec = vector(lanes)
    _, Bodies = _bodies(lanes)
    body_at = _body_at(lanes)
    springs, _, _ = _forces(lanes, terms.tension_only)
    take, advance, give = _guided(lanes, terms)

    @wp.func
    def highest(a: vec) -> float:
        r = a[0]
        for k in range(1, lanes):
            r = wp.max(r, a[k])
        return r

    @wp.kernel(**KERNEL)
    def guide(first_group: int, slot: int, scene: Scene, graph: Springs, bodies: Bodies, numbers: Numbers):
        group = first_group + wp.tid()
        body = body_at(bodies, slot)
        particles = graph.order.shape[0]
        for i in range(particles):
            take(i, group, body, scene, graph.order)
        for iteration in range(1, numbers.iterations + 1):
            looks = iteration % EVERY == 0
            largest = vec(0.0)
            for i in range(particles):
                fx, fy, fz = springs(i, body, graph, numbers.stiffness)
                largest = advance(i, fx, fy, fz, body, numbers, looks, largest)
            if looks and highest(largest) < numbers.tolerance * numbers.tolerance:
                break
        for i in range(particles):
            give(i, group, body, scene, graph.order)

    return guide


@functools.cache
def _guide_blocks(terms: _Terms) -> wp.Kernel:
    """Guidance on a GPU: a block works on a candidate at a time, its threads on particles."""
    vec = vector(1)
    _, Bodies = _bodies(1)
    body_at = _body_at(1)
    _, springs, sum_of_parts = _forces(1, terms.tension_only)
    take, advance, give = _guided(1, terms)

    @wp.kernel(**BLOCK_KERNEL)
    def guide(scene: Scene, graph: Springs, bodies: Bodies, numbers: Numbers):
        slot, thread = wp.tid()
        body = body_at(bodies, slot)
        particles, threads = graph.order.shape[0], wp.block_dim()
        for candidate in range(slot, scene.positions.shape[0], bodies.x.shape[0]):
            for i in range(thread, particles, threads):
                take(i, candidate, body, scene, graph.order)
            barrier()
            for iteration in range(1, numbers.iterations + 1):
                looks = iteration % EVERY == 0
                for item in range(thread, particles * PARTS, threads):
                    springs(item, body, graph, numbers.stiffness)
                barrier()
                largest = vec(0.0)
                for i in range(thread, particles, threads):
                    fx, fy, fz = sum_of_parts(i, body, particles)
                    largest = advance(i, fx, fy, fz, body, numbers, looks, largest)
                moves = any_thread(wp.where(largest[0] < numbers.tolerance * numbers.tolerance, 0, 1))
                if looks and moves == 0:
                    break
            for i in range(thread, particles, threads):
                give(i, candidate, body, scene, graph.order)

    return guide


@functools.cache
def _pushed(lanes: int, held: bool) -> tuple[type, wp.Function, wp.Function, wp.Function]:
    """A disc or hand on its way, and what one iteration of it does with a particle: moves it, touches it, puts it aside."""
    vec = vector(lanes)
    Body, _ = _bodies(lanes)
    _, inverse_root, quotient = roots(lanes)
    zero, one, tiny2 = vec(0.0), vec(1.0), vec(SHORTEST * SHORTEST)

    @wp.struct
    class Pusher:
        stiffness: vec
        damping: vec
        friction: vec
        radius: vec
        grip: vec
        x: vec
        y: vec
        dx: vec
        dy: vec
        until: vec
        goes_on: vec

    @wp.func
    def sliding(vx: vec, vy: vec, friction: vec) -> vec:
        """The share that Coulomb friction leaves of a planar velocity."""
        r = vec()
        for k in range(lanes):
            speed = wp.sqrt(wp.max(vx[k] * vx[k] + vy[k] * vy[k], TINY * TINY * TINY * TINY))
            r[k] = wp.max(1.0 - friction[k] / speed, 0.0)
        return r

    @wp.func
    def advance(i: int, fx: vec, fy: vec, body: Body, pusher: Pusher):
        """One iteration under the force of springs of unit stiffness, and the table's friction."""
        x = body.x
        v = body.v
        vx = wp.cw_mul(v[i, 0] + wp.cw_mul(fx, pusher.stiffness), pusher.damping)
        vy = wp.cw_mul(v[i, 1] + wp.cw_mul(fy, pusher.stiffness), pusher.damping)
        kept = wp.cw_mul(sliding(vx, vy, pusher.friction), pusher.goes_on)
        vx, vy = wp.cw_mul(vx, kept), wp.cw_mul(vy, kept)
        if wp.static(held):
            h = body.target[i, 3]
            free = vec(1.0) - h
            x[i, 0] = x[i, 0] + wp.cw_mul(vx, free) + wp.cw_mul(h, pusher.dx)
            x[i, 1] = x[i, 1] + wp.cw_mul(vy, free) + wp.cw_mul(h, pusher.dy)
            vx, vy = wp.cw_mul(vx, free), wp.cw_mul(vy, free)
        else:
            x[i, 0] = x[i, 0] + vx
            x[i, 1] = x[i, 1] + vy
        v[i, 0] = vx
        v[i, 1] = vy

    @wp.func
    def nudged(ox: vec, square: vec) -> vec:
        """No way out is the shortest from the middle: take the one along x."""
        r = vec()
        for k in range(lanes):
            r[k] = ox[k] + wp.where(square[k] < TINY * TINY, TINY, 0.0)
        return r

    @wp.func
    def out_of_disc(xi: vec, yi: vec, ux: vec, uy: vec, xj: vec, yj: vec, wx: vec, wy: vec, pusher: Pusher):
        """How the disc moves the first end of a segment whose ends are at x, y and move by u, w; and how much it counts."""
        ax = xj - xi
        ay = yj - yi
        inverse = inverse_root(wp.max(wp.cw_mul(ax, ax) + wp.cw_mul(ay, ay), tiny2))
        ahead = wp.cw_mul(pusher.x - xi, ax) + wp.cw_mul(pusher.y - yi, ay)
        share = wp.min(wp.max(wp.cw_mul(wp.cw_mul(ahead, inverse), inverse), zero), one)
        mine = one - share
        oy = yi + wp.cw_mul(share, ay) - pusher.y
        ox = xi + wp.cw_mul(share, ax) - pusher.x
        ox = nudged(ox, wp.cw_mul(ox, ox) + wp.cw_mul(oy, oy))
        square = wp.max(wp.cw_mul(ox, ox) + wp.cw_mul(oy, oy), tiny2)
        inverse = inverse_root(square)
        depth = wp.max(pusher.radius - wp.cw_mul(square, inverse), zero)
        nx = wp.cw_mul(ox, inverse)
        ny = wp.cw_mul(oy, inverse)
        slip_x = wp.cw_mul(mine, ux) + wp.cw_mul(share, wx) - pusher.dx
        slip_y = wp.cw_mul(mine, uy) + wp.cw_mul(share, wy) - pusher.dy
        most = wp.cw_mul(pusher.grip, depth)
        drag = wp.min(wp.max(wp.cw_mul(slip_y, nx) - wp.cw_mul(slip_x, ny), -most), most)
        part = quotient(mine, wp.cw_mul(mine, mine) + wp.cw_mul(share, share))
        px = wp.cw_mul(part, wp.cw_mul(nx, depth) + wp.cw_mul(ny, drag))
        py = wp.cw_mul(part, wp.cw_mul(ny, depth) - wp.cw_mul(nx, drag))
        return px, py, wp.cw_mul(mine, depth)

    @wp.func
    def touch(i: int, body: Body, graph: Springs, pusher: Pusher):
        """How the disc moves particle i, by all segments that end in it. Leaves it in `summed`: others still read places."""
        x = body.x
        v = body.v
        xi = x[i, 0]
        yi = x[i, 1]
        ux = v[i, 0]
        uy = v[i, 1]
        sx = vec(0.0)
        sy = vec(0.0)
        whole = vec(0.0)
        for s in range(graph.wall[i], graph.wall[i + 1]):
            j = graph.other[s]
            px, py, weight = out_of_disc(xi, yi, ux, uy, x[j, 0], x[j, 1], v[j, 0], v[j, 1], pusher)
            sx += wp.cw_mul(px, weight)
            sy += wp.cw_mul(py, weight)
            whole += weight
        whole = wp.max(whole, tiny2)
        body.summed[i, 0] = quotient(sx, whole)
        body.summed[i, 1] = quotient(sy, whole)

    @wp.func
    def aside(i: int, body: Body, pusher: Pusher):
        """Where the disc moves particle i."""
        for c in range(2):
            out = wp.cw_mul(body.summed[i, c], pusher.goes_on)
            body.x[i, c] = body.x[i, c] + out
            body.v[i, c] = body.v[i, c] + out

    return Pusher, advance, touch, aside


@functools.cache
def _way(lanes: int, held: bool) -> tuple[wp.Function, wp.Function]:
    """The pusher where its path begins, and a step further."""
    load, _ = accessors(lanes)
    Pusher, _, _, _ = _pushed(lanes, held)

    @wp.func
    def begin(group: int, stroke: Stroke) -> Pusher:
        pusher = Pusher()
        pusher.stiffness = load(stroke.numbers, group, 0, 0)
        pusher.damping = load(stroke.numbers, group, 0, 1)
        pusher.friction = load(stroke.numbers, group, 0, 2)
        pusher.radius = load(stroke.numbers, group, 0, 3)
        pusher.grip = load(stroke.numbers, group, 0, 4)
        pusher.until = load(stroke.numbers, group, 0, 5)
        pusher.x = load(stroke.path, group, 0, 0)
        pusher.y = load(stroke.path, group, 0, 1)
        return pusher

    @wp.func
    def follow(pusher: Pusher, group: int, stroke: Stroke, t: int) -> Pusher:
        x = load(stroke.path, group, t, 0)
        y = load(stroke.path, group, t, 1)
        for k in range(lanes):
            pusher.goes_on[k] = wp.where(float(t) <= pusher.until[k], 1.0, 0.0)
        pusher.dx = x - pusher.x
        pusher.dy = y - pusher.y
        pusher.x = x
        pusher.y = y
        return pusher

    return begin, follow


@functools.cache
def _push_kernel(lanes: int, terms: _Terms) -> wp.Kernel:
    """A stroke on a CPU, as `_guide_kernel`."""
    _, Bodies = _bodies(lanes)
    body_at = _body_at(lanes)
    springs, _, _ = _forces(lanes, terms.tension_only)
    take, _, give = _guided(lanes, terms)
    _, advance, touch, aside = _pushed(lanes, terms.held)
    begin, follow = _way(lanes, terms.held)

    @wp.kernel(**KERNEL)
    def push(first_group: int, slot: int, scene: Scene, stroke: Stroke, graph: Springs, bodies: Bodies):
        group = first_group + wp.tid()
        body = body_at(bodies, slot)
        particles = graph.order.shape[0]
        for i in range(particles):
            take(i, group, body, scene, graph.order)
        pusher = begin(group, stroke)
        for t in range(stroke.path.shape[1]):
            pusher = follow(pusher, group, stroke, t)
            for i in range(particles):
                fx, fy, _fz = springs(i, body, graph, 1.0)
                advance(i, fx, fy, body, pusher)
            for i in range(particles):
                touch(i, body, graph, pusher)
            for i in range(particles):
                aside(i, body, pusher)
        for i in range(particles):
            give(i, group, body, scene, graph.order)

    return push


@functools.cache
def _push_blocks(terms: _Terms) -> wp.Kernel:
    """A stroke on a GPU, as `_guide_blocks`."""
    _, Bodies = _bodies(1)
    body_at = _body_at(1)
    _, springs, sum_of_parts = _forces(1, terms.tension_only)
    take, _, give = _guided(1, terms)
    _, advance, touch, aside = _pushed(1, terms.held)
    begin, follow = _way(1, terms.held)

    @wp.kernel(**BLOCK_KERNEL)
    def push(scene: Scene, stroke: Stroke, graph: Springs, bodies: Bodies):
        slot, thread = wp.tid()
        body = body_at(bodies, slot)
        particles, threads = graph.order.shape[0], wp.block_dim()
        for candidate in range(slot, scene.positions.shape[0], bodies.x.shape[0]):
            for i in range(thread, particles, threads):
                take(i, candidate, body, scene, graph.order)
            barrier()
            pusher = begin(candidate, stroke)
            for t in range(stroke.path.shape[1]):
                pusher = follow(pusher, candidate, stroke, t)
                for item in range(thread, particles * PARTS, threads):
                    springs(item, body, graph, 1.0)
                barrier()
                for i in range(thread, particles, threads):
                    fx, fy, _fz = sum_of_parts(i, body, particles)
                    advance(i, fx, fy, body, pusher)
                barrier()
                for i in range(thread, particles, threads):
                    touch(i, body, graph, pusher)
                barrier()
                for i in range(thread, particles, threads):
                    aside(i, body, pusher)
                barrier()
            for i in range(thread, particles, threads):
                give(i, candidate, body, scene, graph.order)

    return push


@functools.lru_cache(maxsize=32)
def _packed(graph: SpringGraph, device: torch.device) -> Springs:
    start_warp()
    order = bandwidth_order(graph.pairs, graph.particles)
    pairs = np.sort(np.argsort(order)[graph.pairs], axis=1)
    rest = graph.rest_length
    if device.type != "cpu":
        pairs, rest = np.concatenate([pairs, pairs[:, ::-1]]), np.tile(rest, 2)
    by_first = np.lexsort((pairs[:, 1], pairs[:, 0]))
    springs = Springs()
    springs.order = wp.array(order.astype(np.int32), dtype=wp.int32, device=str(device))
    first = np.searchsorted(pairs[by_first, 0], np.arange(graph.particles + 1))
    springs.first = wp.array(first.astype(np.int32), dtype=wp.int32, device=str(device))
    springs.second = wp.array(pairs[by_first, 1].astype(np.int32), dtype=wp.int32, device=str(device))
    springs.rest = wp.array(rest[by_first].astype(np.float32), dtype=wp.float32, device=str(device))
    walls = np.argsort(order)[graph.touched]
    both = np.concatenate([walls, walls[walls[:, 0] != walls[:, 1], ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    wall = np.searchsorted(both[:, 0], np.arange(graph.particles + 1))
    springs.wall = wp.array(wall.astype(np.int32), dtype=wp.int32, device=str(device))
    springs.other = wp.array(both[:, 1].astype(np.int32), dtype=wp.int32, device=str(device))
    return springs


def _scratch(launch: Launch, particles: int) -> Any:
    """Bodies for all slots."""
    bodies = _bodies(launch.lanes)[1]()
    parts = 1 if launch.device.type == "cpu" else PARTS
    for name, rows, columns in (
        ("x", 1, 3),
        ("v", 1, 3),
        ("force", parts, 3),
        ("target", 1, 4),
        ("summed", 1, 3),
    ):
        setattr(bodies, name, launch.scratch(rows * particles, columns))
    return bodies


def _scene(**arrays: Tensor) -> Any:
    """The candidates' arrays, float32 and contiguous."""
    scene = Scene()
    for name, array in arrays.items():
        setattr(scene, name, wp.from_torch(array, requires_grad=False))
    return scene


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
    if not recording():
        check_guidance(positions, setpoint, graph, params, weights)
    weights = torch.ones_like(positions[..., 0]) if weights is None else weights
    given = positions, setpoint, weights[..., None], torch.zeros_like(setpoint)
    if positions.device.type == "cpu":
        known = GuidanceParams(**{name: getattr(params, name) for name in GuidanceParams.model_fields})
        return _guide_of(graph, known, len(positions), cores(), threading.get_ident())(*given)
    out = torch.empty(positions.shape, device=positions.device)
    launch, kernel, arguments = _guidance(*(a.contiguous() for a in given), out, graph, params)
    launch.run(kernel, arguments)
    return out


@functools.lru_cache(maxsize=8)
def _guide_of(graph: SpringGraph, params: GuidanceParams, batch: int, cores: int, thread: int) -> Standing:
    shapes = [(batch, graph.particles, columns) for columns in (3, 3, 1, 3, 3)]
    return Standing(shapes, lambda *tensors: _guidance(*tensors, graph, params))


def drive(
    positions: Tensor, velocity: Tensor, setpoint: Tensor, graph: SpringGraph, params: GuidanceParams, weights: Tensor
) -> tuple[Tensor, Tensor]:
    """`physics.simulation.drive` in float32, without gradients: positions and velocity [N, 3] afterwards."""
    if positions.device.type == "cpu":
        return _drive_of(graph, params, threading.get_ident())(positions, velocity, setpoint, weights)
    velocity = velocity.clone()
    out = torch.empty(positions.shape, device=positions.device)
    tensors = [a[None].contiguous() for a in (positions, setpoint, weights[:, None])]
    launch, kernel, arguments = _guidance(*tensors, velocity[None], out[None], graph, params)
    launch.run(kernel, arguments)
    return out, velocity


class _Drive:
    """`drive` of one object on the CPU: a frame of tracking calls it 20 times, and preparing a launch takes longer than it."""

    def __init__(self, graph: SpringGraph, params: GuidanceParams):
        with torch.inference_mode(False):  # else they could not be written to outside of it
            self.given = [torch.empty(1, graph.particles, columns) for columns in (3, 3, 1, 3)]
            self.out = torch.empty(1, graph.particles, 3)
        launch, kernel, self.arguments = _guidance(*self.given, self.out, graph, params)
        (self.command,) = launch.commands(kernel, self.arguments)

    def __call__(self, positions: Tensor, velocity: Tensor, setpoint: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
        for own, given in zip(self.given, (positions, setpoint, weights[:, None], velocity), strict=True):
            own[0].copy_(given)
        self.command.launch()
        return self.out[0].clone(), self.given[3][0].clone()


@functools.lru_cache(maxsize=8)
def _drive_of(graph: SpringGraph, params: GuidanceParams, thread: int) -> _Drive:
    return _Drive(graph, params)


def _guidance(
    positions: Tensor,
    setpoint: Tensor,
    weights: Tensor,
    velocity: Tensor,
    out: Tensor,
    graph: SpringGraph,
    params: GuidanceParams,
) -> tuple[Launch, wp.Kernel, list[Any]]:
    """What to launch for positions, setpoint, velocity, out [B, N, 3] and weights [B, N, 1]; it changes the last two."""
    launch = Launch(len(positions), positions.device, LANES, graph.particles * PARTS)
    scene = _scene(positions=positions, setpoint=setpoint, weights=weights, velocity=velocity, out=out)
    numbers = Numbers()
    for name in ("stiffness", "damping", "friction", "gain", "integral", "integral_limit", "derivative"):
        setattr(numbers, name, getattr(params, name))
    numbers.iterations, numbers.tolerance = params.iterations, params.tolerance
    terms = _Terms(params.friction > 0, params.tension_only, params.integral > 0, params.derivative > 0)
    kernel = _guide_kernel(launch.lanes, terms) if launch.device.type == "cpu" else _guide_blocks(terms)
    return launch, kernel, [scene, _packed(graph, launch.device), _scratch(launch, graph.particles), numbers]


def push(
    positions: Tensor,
    path: Tensor,
    graph: SpringGraph,
    params: PushParams = PushParams(),
    held: Tensor | None = None,
) -> Tensor:
    """`physics.pushing.push` in float32, without gradients: positions [B, N, 3], path [B, T, 2] (m), held [B, N].

    Raises as the reference does. Source: paper, Eq. 3, with contact as the external force.
    """
    numbers = check_push(positions, path, graph, params)
    launch = Launch(len(positions), positions.device, LANES, graph.particles * PARTS)
    out = torch.empty(positions.shape, device=positions.device)
    grip = torch.zeros_like(positions[..., 0]) if held is None else held.to(positions)
    scene = _scene(
        positions=positions.contiguous(),
        setpoint=positions.contiguous(),
        weights=grip[..., None].contiguous(),
        velocity=torch.zeros_like(out),
        out=out,
    )
    numbers[:, 3] = torch.where(grip.any(1), 0.0, numbers[:, 3])
    stroke = Stroke()
    stroke.path = wp.from_torch(path.contiguous())
    stroke.numbers = wp.from_torch(numbers[:, None].contiguous())
    terms = _Terms(False, params.tension_only, held=held is not None)
    kernel = _push_kernel(launch.lanes, terms) if launch.device.type == "cpu" else _push_blocks(terms)
    launch.run(kernel, [scene, stroke, _packed(graph, launch.device), _scratch(launch, graph.particles)])
    return clear(out, path[:, -1], numbers[:, 3])
