"""The trained network as a kernel: predictions for many candidate strokes on one object.

The truth is `dynamics.egnn`; this holds to it within 1e-5 m and is tested so. All candidates share the graph of the
object at rest. A group of candidates runs through the whole network, on a CPU particle by particle, so that what it
works on stays in the cache. Weights are packed for it: those before a SiLU are scaled by -log2 e and those after by the
inverse, which leaves one power of two and one division of it, -log2(e) silu(t) = s / (1 + 2^s) with s = -log2(e) t.
"""

import functools
import math
import threading
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
import warp as wp
from torch import Tensor

from piegraph_cli.dynamics.action import FEATURES, NEAR, PICK_FEATURES, grasped_particle
from piegraph_cli.dynamics.egnn import DECIMETRE, EGNN, Rest
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.kernels.lanes import (
    BLOCK_KERNEL,
    KERNEL,
    Launch,
    Standing,
    accessors,
    bandwidth_order,
    barrier,
    cores,
    roots,
    start_warp,
    vector,
)

LANES = 64
"""Candidates in a group on a CPU. Measured: 16 and 32 take two to three times as long, being unrolled, not vectorised."""

STANDING = 4
"""Launches kept for one object: of the sizes of batch that come again."""

TILE = 4
"""Channels worked on together, so that their sums stay in registers; hidden sizes are padded to it."""

SCALE = wp.constant(DECIMETRE)
NEAR_SCALE = wp.constant(NEAR * DECIMETRE)


@wp.struct
class Weights:
    """The network's weights, transposed to [..., inputs, outputs] and scaled as the kernel needs them."""

    embed: wp.array2d(dtype=wp.float32)
    embed_bias: wp.array(dtype=wp.float32)
    pool: wp.array3d(dtype=wp.float32)
    receive: wp.array3d(dtype=wp.float32)
    receive_bias: wp.array2d(dtype=wp.float32)
    send: wp.array3d(dtype=wp.float32)
    distance: wp.array3d(dtype=wp.float32)
    coordinate: wp.array2d(dtype=wp.float32)
    own: wp.array3d(dtype=wp.float32)
    message: wp.array3d(dtype=wp.float32)
    update_bias: wp.array2d(dtype=wp.float32)
    update: wp.array3d(dtype=wp.float32)
    out_bias: wp.array2d(dtype=wp.float32)
    head: wp.array2d(dtype=wp.float32)
    head_bias: wp.array(dtype=wp.float32)
    planar: wp.array2d(dtype=wp.float32)
    planar_bias: wp.array(dtype=wp.float32)
    lift: wp.array2d(dtype=wp.float32)
    lift_bias: wp.array(dtype=wp.float32)


@wp.struct
class Scene:
    """What is asked of all candidates, and what becomes of them; and the object that they share."""

    positions: wp.array3d(dtype=wp.float32)
    """[B, N, 3] metres."""
    strokes: wp.array3d(dtype=wp.float32)
    """[B, 1, 7] metres."""
    grasps: wp.array3d(dtype=wp.float32)
    """[B, 1, 4] of the grasped particle the place at rest and the height now, metres."""
    out: wp.array3d(dtype=wp.float32)
    """[B, N, 3] metres."""
    order: wp.array(dtype=wp.int32)
    """[N] the particle that comes at each place."""
    neighbors: wp.array2d(dtype=wp.int32)
    """[N, k] places."""
    rest: wp.array2d(dtype=wp.float32)
    """[N, 3] metres."""


@functools.cache
def _scratch_type(lanes: int) -> type:
    vec = vector(lanes)

    @wp.struct
    class Scratch:
        """Memory of every slot. Rows and edges are there for one particle on a CPU, for each on a GPU."""

        h: wp.array3d(dtype=vec)
        """[slots, N, H] features."""
        sent: wp.array3d(dtype=vec)
        """[slots, N, H] what neighbours get of them."""
        x: wp.array3d(dtype=vec)
        """[slots, N, 3] positions from the middle, decimetres."""
        following: wp.array3d(dtype=vec)
        """[slots, N, 3] those after this layer."""
        start: wp.array3d(dtype=vec)
        """[slots, N, 3] those before the first."""
        pooled: wp.array3d(dtype=vec)
        """[slots, 2, H] the sum of all features, and what is mixed into each."""
        rows: wp.array4d(dtype=vec)
        """[slots, 1 or N, 2, H] what is between two linear layers, and summed messages."""
        edges: wp.array4d(dtype=vec)
        """[slots, 1 or N, 3 or more, k] distance now, squared before, and how hard a neighbour pulls, in parts."""

    return Scratch


@wp.func_native("""
    float4 sum = make_float4(a, b, c, d);
    const char* value = (const char*)rows.data + row * rows.strides[0];
    const char* factor = (const char*)(weight.data + o);
    const int inputs = weight.shape[0], along = rows.strides[1], across = weight.strides[0];
#pragma unroll 8
    for (int i = 0; i < inputs; ++i) {
        const float x = *(const float*)(value + i * along);
        const float4 w = *(const float4*)(factor + i * across);
        sum = make_float4(sum.x + x * w.x, sum.y + x * w.y, sum.z + x * w.z, sum.w + x * w.w);
    }
    return wp::vec_t<4, wp::float32>(sum.x, sum.y, sum.z, sum.w);
""")
def _linear_on_gpu(
    rows: wp.array2d(dtype=wp.types.vector(1, wp.float32)),
    row: int,
    weight: wp.array2d(dtype=wp.float32),
    o: int,
    a: float,
    b: float,
    c: float,
    d: float,
) -> wp.vec4:
    """`linear` below, with four weights in one load: what comes of it by itself spends its time on addresses."""


@wp.func_native("""
    return __fdividef(s, 1.0f + exp2f(fminf(s, 120.0f)));
""")
def _gate_on_gpu(s: float) -> float:
    """`gate` below, in five instructions."""


@functools.cache
def _gate(lanes: int) -> wp.Function:
    vec = vector(lanes)

    if lanes == 1:

        @wp.func
        def gate_on_gpu(s: vec) -> vec:
            """s / (1 + 2^s)."""
            return vec(_gate_on_gpu(s[0]))

        return gate_on_gpu

    @wp.func
    def gate(s: vec) -> vec:
        """s / (1 + 2^s): the power by rounding to an integer, which is added to the exponent, and a polynomial."""
        r = vec()
        for k in range(lanes):
            t = wp.min(wp.max(s[k], -120.0), 120.0)
            rounded = t + 12582912.0  # 1.5 * 2^23: the integer is now in the lowest bits
            f = t - (rounded - 12582912.0)
            p = 0.009675528604796063 + f * 0.0013276415462309434
            p = 1.0000000716033874 + f * (
                0.6931469671244377 + f * (0.2402211996683336 + f * (0.05550713318206169 + f * p))
            )
            power = wp.cast(wp.cast(p, wp.int32) + (wp.cast(rounded, wp.int32) << 23), wp.float32)
            r[k] = s[k] / (1.0 + power)
        return r

    return gate


@functools.cache
def _tiles(lanes: int) -> tuple[wp.Function, wp.Function, wp.Function]:
    """A linear layer for `TILE` outputs of one row at a time, which stay in registers: a, b, c, d."""
    vec = vector(lanes)

    @wp.func
    def bias(b: wp.array(dtype=wp.float32), o: int):
        return vec(b[o]), vec(b[o + 1]), vec(b[o + 2]), vec(b[o + 3])

    @wp.func
    def linear(
        rows: wp.array2d(dtype=vec),
        row: int,
        weight: wp.array2d(dtype=wp.float32),
        o: int,
        a: vec,
        b: vec,
        c: vec,
        d: vec,
    ):
        """Outputs o to o + 3 of a linear layer on one row, added to a, b, c, d."""
        for i in range(weight.shape[0]):
            value = rows[row, i]
            a += value * weight[i, o]
            b += value * weight[i, o + 1]
            c += value * weight[i, o + 2]
            d += value * weight[i, o + 3]
        return a, b, c, d

    @wp.func
    def linear_on_gpu(
        rows: wp.array2d(dtype=vec),
        row: int,
        weight: wp.array2d(dtype=wp.float32),
        o: int,
        a: vec,
        b: vec,
        c: vec,
        d: vec,
    ):
        r = _linear_on_gpu(rows, row, weight, o, a[0], b[0], c[0], d[0])
        return vec(r[0]), vec(r[1]), vec(r[2]), vec(r[3])

    @wp.func
    def put(rows: wp.array2d(dtype=vec), row: int, o: int, a: vec, b: vec, c: vec, d: vec):
        rows[row, o] = a
        rows[row, o + 1] = b
        rows[row, o + 2] = c
        rows[row, o + 3] = d

    return bias, linear_on_gpu if lanes == 1 else linear, put


@functools.cache
def _stroke(lanes: int, mirror: bool) -> tuple[type, wp.Function, wp.Function, wp.Function, wp.Function, wp.Function]:
    """A stroke as its own frame, and where that has a particle."""
    vec = vector(lanes)
    load, _ = accessors(lanes)
    root, _, quotient = roots(lanes)
    one = vec(1.0)

    @wp.struct
    class Frame:
        ex: vec
        """Where the stroke ends."""
        ey: vec
        hx: vec
        """Its heading."""
        hy: vec
        length: vec
        mode: vec
        side: vec
        """On which of its sides the object lies, -1 to 1."""

    @wp.func
    def squash(a: vec) -> vec:
        r = vec()
        for k in range(lanes):
            r[k] = wp.tanh(a[k] / NEAR_SCALE)
        return r

    @wp.func
    def beside(dx: vec, dy: vec, hx: vec, hy: vec):
        """How far (dx, dy) lies to the left of the heading."""
        return (wp.cw_mul(dy, hx) - wp.cw_mul(dx, hy)) * SCALE

    @wp.func
    def frame_of(strokes: wp.array3d(dtype=wp.float32), group: int) -> Frame:
        ex = load(strokes, group, 0, 2)
        ey = load(strokes, group, 0, 3)
        hx = ex - load(strokes, group, 0, 0)
        hy = ey - load(strokes, group, 0, 1)
        length = root(wp.cw_mul(hx, hx) + wp.cw_mul(hy, hy))
        hx = quotient(hx, length)
        hy = quotient(hy, length)
        frame = Frame()
        frame.ex = ex
        frame.ey = ey
        frame.hx = hx
        frame.hy = hy
        frame.length = length
        frame.mode = load(strokes, group, 0, 4)
        frame.side = one
        return frame

    @wp.func
    def side_of(i: int, start: wp.array2d(dtype=vec), sides: wp.array2d(dtype=vec), frame: Frame):
        """On which side of the stroke particle i lies, in `sides`."""
        if wp.static(mirror):
            sides[i, 0] = squash(beside(start[i, 0] - frame.ex, start[i, 1] - frame.ey, frame.hx, frame.hy))

    @wp.func
    def mean_side(sides: wp.array2d(dtype=vec)) -> vec:
        if wp.static(mirror):
            side = vec(0.0)
            for i in range(sides.shape[0]):
                side += sides[i, 0]
            return side * (1.0 / float(sides.shape[0]))
        return one

    return Frame, squash, beside, frame_of, side_of, mean_side


@functools.cache
def _features(lanes: int, picks: bool, mirror: bool) -> tuple[wp.Function, wp.Function, wp.Function, wp.Function]:
    """From positions to the first features of the nodes."""
    vec = vector(lanes)
    load, _ = accessors(lanes)
    root, _, _ = roots(lanes)
    bias, linear, put = _tiles(lanes)
    Frame, squash, beside, _, _, _ = _stroke(lanes, mirror)
    zero = vec(0.0)

    @wp.func
    def middle(start: wp.array2d(dtype=vec)):
        cx = vec(0.0)
        cy = vec(0.0)
        cz = vec(0.0)
        for i in range(start.shape[0]):
            cx += start[i, 0]
            cy += start[i, 1]
            cz += start[i, 2]
        share = 1.0 / float(start.shape[0])
        return cx * share, cy * share, cz * share

    @wp.func
    def see(i: int, group: int, start: wp.array2d(dtype=vec), row: wp.array2d(dtype=vec), frame: Frame, scene: Scene):
        """`canonical_action` and `pick_features` of particle i in `row`, lengths in decimetres."""
        dx = start[i, 0] - frame.ex
        dy = start[i, 1] - frame.ey
        row[0, 0] = (wp.cw_mul(dx, frame.hx) + wp.cw_mul(dy, frame.hy)) * SCALE
        row[0, 1] = beside(dx, dy, frame.hx, frame.hy)
        row[0, 2] = start[i, 2] * SCALE
        row[0, 3] = frame.length * SCALE
        row[0, 4] = frame.mode
        row[0, 5] = squash(row[0, 0])
        row[0, 6] = squash(row[0, 0] + row[0, 3])
        row[0, 7] = squash(row[0, 1])
        row[0, 8] = wp.max(row[0, 1], -row[0, 1])
        row[0, 9] = wp.max(row[0, 7], -row[0, 7])
        row[0, 1] = wp.cw_mul(row[0, 1], frame.side)
        row[0, 7] = wp.cw_mul(row[0, 7], frame.side)
        if wp.static(picks):
            at = scene.order[i]
            gx = vec(scene.rest[at, 0]) - load(scene.grasps, group, 0, 0)
            gy = vec(scene.rest[at, 1]) - load(scene.grasps, group, 0, 1)
            gz = vec(scene.rest[at, 2]) - load(scene.grasps, group, 0, 2)
            reach = root(wp.cw_mul(gx, gx) + wp.cw_mul(gy, gy) + wp.cw_mul(gz, gz))
            slack = wp.max(root(wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy)) - reach, zero)
            row[0, 10] = wp.cw_mul(frame.mode, load(scene.strokes, group, 0, 5))
            row[0, 11] = wp.cw_mul(frame.mode, load(scene.strokes, group, 0, 6))
            row[0, 12] = wp.cw_mul(frame.mode, reach) * SCALE
            row[0, 13] = wp.cw_mul(frame.mode, slack) * SCALE
            row[0, 14] = wp.cw_mul(frame.mode, start[i, 2] - load(scene.grasps, group, 0, 3)) * SCALE

    @wp.func
    def embed(i: int, o: int, h: wp.array2d(dtype=vec), row: wp.array2d(dtype=vec), weights: Weights):
        a, b, c, d = bias(weights.embed_bias, o)
        a, b, c, d = linear(row, 0, weights.embed, o, a, b, c, d)
        put(h, i, o, a, b, c, d)

    @wp.func
    def centre(i: int, start: wp.array2d(dtype=vec), x: wp.array2d(dtype=vec), cx: vec, cy: vec, cz: vec):
        start[i, 0] = (start[i, 0] - cx) * SCALE
        start[i, 1] = (start[i, 1] - cy) * SCALE
        start[i, 2] = (start[i, 2] - cz) * SCALE
        for axis in range(3):
            x[i, axis] = start[i, axis]

    return middle, see, embed, centre


@functools.cache
def _pooling(lanes: int) -> tuple[wp.Function, wp.Function, wp.Function, wp.Function]:
    """The mean of all features, mixed into each; and what each then sends to its neighbours."""
    vec = vector(lanes)
    _, linear, put = _tiles(lanes)
    zero = vec(0.0)

    @wp.func
    def total(o: int, h: wp.array2d(dtype=vec), pooled: wp.array2d(dtype=vec)):
        a = vec(0.0)
        b = vec(0.0)
        c = vec(0.0)
        d = vec(0.0)
        for i in range(h.shape[0]):
            a += h[i, o]
            b += h[i, o + 1]
            c += h[i, o + 2]
            d += h[i, o + 3]
        put(pooled, 0, o, a, b, c, d)

    @wp.func
    def pool(o: int, pooled: wp.array2d(dtype=vec), weight: wp.array2d(dtype=wp.float32), share: float):
        a, b, c, d = linear(pooled, 0, weight, o, zero, zero, zero, zero)
        put(pooled, 1, o, a * share, b * share, c * share, d * share)

    @wp.func
    def mix_in(i: int, o: int, h: wp.array2d(dtype=vec), pooled: wp.array2d(dtype=vec)):
        a = h[i, o] + pooled[1, o]
        b = h[i, o + 1] + pooled[1, o + 1]
        c = h[i, o + 2] + pooled[1, o + 2]
        d = h[i, o + 3] + pooled[1, o + 3]
        put(h, i, o, a, b, c, d)

    @wp.func
    def send(
        i: int, o: int, h: wp.array2d(dtype=vec), sent: wp.array2d(dtype=vec), weight: wp.array2d(dtype=wp.float32)
    ):
        a, b, c, d = linear(h, i, weight, o, zero, zero, zero, zero)
        put(sent, i, o, a, b, c, d)

    return total, pool, mix_in, send


@functools.cache
def _messages(lanes: int) -> tuple[wp.Function, wp.Function, wp.Function]:
    """What a particle gets from its neighbours, and where that moves it."""
    vec = vector(lanes)
    root, _, quotient = roots(lanes)
    bias, linear, put = _tiles(lanes)
    gate = _gate(lanes)
    zero, one = vec(0.0), vec(1.0)

    @wp.func
    def offset(x: wp.array2d(dtype=vec), i: int, j: int):
        return x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]

    @wp.func
    def measure(
        i: int,
        j: int,
        e: int,
        x: wp.array2d(dtype=vec),
        start: wp.array2d(dtype=vec),
        edge: wp.array2d(dtype=vec),
    ):
        """How long edge e from i to j is; nothing pulls there yet."""
        dx, dy, dz = offset(x, i, j)
        edge[0, e] = root(wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy) + wp.cw_mul(dz, dz) + vec(1.0e-12))
        dx, dy, dz = offset(start, i, j)
        edge[1, e] = wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy) + wp.cw_mul(dz, dz)
        for part in range(2, edge.shape[0]):
            edge[part, e] = zero

    @wp.func
    def receive(
        i: int,
        o: int,
        part: int,
        h: wp.array2d(dtype=vec),
        sent: wp.array2d(dtype=vec),
        edge: wp.array2d(dtype=vec),
        row: wp.array2d(dtype=vec),
        neighbors: wp.array2d(dtype=wp.int32),
        weights: Weights,
        layer: int,
    ):
        """The sum of messages, channels o to o + 3, in the second row; how they pull is added to that part of the edges."""
        w_distance = weights.distance[layer]
        w_coordinate = weights.coordinate[layer]
        a, b, c, d = bias(weights.receive_bias[layer], o)
        a, b, c, d = linear(h, i, weights.receive[layer], o, a, b, c, d)
        sa = vec(0.0)
        sb = vec(0.0)
        sc = vec(0.0)
        sd = vec(0.0)
        for e in range(neighbors.shape[1]):
            j = neighbors[i, e]
            near = edge[0, e]
            was = edge[1, e]
            ma = gate(a + sent[j, o] + near * w_distance[0, o] + was * w_distance[1, o])
            mb = gate(b + sent[j, o + 1] + near * w_distance[0, o + 1] + was * w_distance[1, o + 1])
            mc = gate(c + sent[j, o + 2] + near * w_distance[0, o + 2] + was * w_distance[1, o + 2])
            md = gate(d + sent[j, o + 3] + near * w_distance[0, o + 3] + was * w_distance[1, o + 3])
            sa += ma
            sb += mb
            sc += mc
            sd += md
            edge[part, e] = (
                edge[part, e]
                + ma * w_coordinate[o]
                + mb * w_coordinate[o + 1]
                + mc * w_coordinate[o + 2]
                + md * w_coordinate[o + 3]
            )
        put(row, 1, o, sa, sb, sc, sd)

    @wp.func
    def follow(
        i: int,
        x: wp.array2d(dtype=vec),
        following: wp.array2d(dtype=vec),
        edge: wp.array2d(dtype=vec),
        neighbors: wp.array2d(dtype=wp.int32),
    ):
        """Where particle i goes in this layer."""
        ux = x[i, 0]
        uy = x[i, 1]
        uz = x[i, 2]
        for e in range(neighbors.shape[1]):
            dx, dy, dz = offset(x, i, neighbors[i, e])
            pull = edge[2, e]
            for part in range(3, edge.shape[0]):
                pull += edge[part, e]
            push = quotient(pull, edge[0, e] + one)
            ux += wp.cw_mul(dx, push)
            uy += wp.cw_mul(dy, push)
            uz += wp.cw_mul(dz, push)
        following[i, 0] = ux
        following[i, 1] = uy
        following[i, 2] = uz

    return measure, receive, follow


@functools.cache
def _updates(lanes: int) -> tuple[wp.Function, wp.Function]:
    """The two layers that make new features of old ones and messages."""
    vec = vector(lanes)
    bias, linear, put = _tiles(lanes)
    gate = _gate(lanes)

    @wp.func
    def hide(i: int, o: int, h: wp.array2d(dtype=vec), row: wp.array2d(dtype=vec), weights: Weights, layer: int):
        a, b, c, d = bias(weights.update_bias[layer], o)
        a, b, c, d = linear(h, i, weights.own[layer], o, a, b, c, d)
        a, b, c, d = linear(row, 1, weights.message[layer], o, a, b, c, d)
        put(row, 0, o, gate(a), gate(b), gate(c), gate(d))

    @wp.func
    def update(i: int, o: int, h: wp.array2d(dtype=vec), row: wp.array2d(dtype=vec), weights: Weights, layer: int):
        a, b, c, d = bias(weights.out_bias[layer], o)
        a, b, c, d = linear(row, 0, weights.update[layer], o, a, b, c, d)
        put(h, i, o, h[i, o] + a, h[i, o + 1] + b, h[i, o + 2] + c, h[i, o + 3] + d)

    return hide, update


@functools.cache
def _head(lanes: int, mirror: bool) -> tuple[wp.Function, wp.Function, wp.Function]:
    """From the last features to displacements."""
    vec = vector(lanes)
    load, store = accessors(lanes)
    bias, linear, put = _tiles(lanes)
    gate = _gate(lanes)
    Frame, squash, beside, _, _, _ = _stroke(lanes, mirror)
    one = vec(1.0)

    @wp.func
    def hide(i: int, o: int, h: wp.array2d(dtype=vec), row: wp.array2d(dtype=vec), weights: Weights):
        a, b, c, d = bias(weights.head_bias, o)
        a, b, c, d = linear(h, i, weights.head, o, a, b, c, d)
        put(row, 0, o, gate(a), gate(b), gate(c), gate(d))

    @wp.func
    def displace(
        i: int,
        group: int,
        h: wp.array2d(dtype=vec),
        row: wp.array2d(dtype=vec),
        x: wp.array2d(dtype=vec),
        start: wp.array2d(dtype=vec),
        following: wp.array2d(dtype=vec),
        frame: Frame,
        scene: Scene,
        weights: Weights,
    ):
        """By how much particle i moves in all, metres, in `following`."""
        particle_side = one
        if wp.static(mirror):
            dx = load(scene.positions, group, scene.order[i], 0) - frame.ex
            dy = load(scene.positions, group, scene.order[i], 1) - frame.ey
            particle_side = squash(beside(dx, dy, frame.hx, frame.hy))
        a, b, c, d = bias(weights.planar_bias, 0)
        px, py, pw, d = linear(row, 0, weights.planar, 0, a, b, c, d)
        py = wp.cw_mul(py, particle_side) + wp.cw_mul(pw, frame.side)
        a, b, c, d = bias(weights.lift_bias, 0)
        pz, b, c, d = linear(h, i, weights.lift, 0, a, b, c, d)
        following[i, 0] = (x[i, 0] - start[i, 0] + wp.cw_mul(frame.hx, px) - wp.cw_mul(frame.hy, py)) / SCALE
        following[i, 1] = (x[i, 1] - start[i, 1] + wp.cw_mul(frame.hy, px) + wp.cw_mul(frame.hx, py)) / SCALE
        following[i, 2] = (x[i, 2] - start[i, 2] + pz) / SCALE

    @wp.func
    def deliver(i: int, group: int, following: wp.array2d(dtype=vec), scene: Scene):
        for axis in range(3):
            moved = load(scene.positions, group, scene.order[i], axis) + following[i, axis]
            store(scene.out, group, scene.order[i], axis, moved)

    return hide, displace, deliver


@functools.cache
def _kernel(lanes: int, picks: bool, mirror: bool) -> wp.Kernel:
    """Prediction on a CPU: a thread works on a group at a time, particle by particle."""
    load, _ = accessors(lanes)
    Scratch = _scratch_type(lanes)
    _, _, _, frame_of, side_of, mean_side = _stroke(lanes, mirror)
    middle, see, embed, centre = _features(lanes, picks, mirror)
    total, pool, mix_in, send = _pooling(lanes)
    measure, receive, follow = _messages(lanes)
    hide, update = _updates(lanes)
    hide_last, displace, deliver = _head(lanes, mirror)

    @wp.kernel(**KERNEL)
    def predict(first_group: int, slot: int, scene: Scene, weights: Weights, scratch: Scratch):
        group = first_group + wp.tid()
        h = scratch.h[slot]
        sent = scratch.sent[slot]
        x = scratch.x[slot]
        following = scratch.following[slot]
        start = scratch.start[slot]
        pooled = scratch.pooled[slot]
        row = scratch.rows[slot][0]
        edge = scratch.edges[slot][0]
        neighbors = scene.neighbors
        particles = scene.order.shape[0]
        hidden = weights.embed.shape[1]
        for i in range(particles):
            for axis in range(3):
                start[i, axis] = load(scene.positions, group, scene.order[i], axis)
        cx, cy, cz = middle(start)
        frame = frame_of(scene.strokes, group)
        for i in range(particles):
            side_of(i, start, following, frame)
        frame.side = mean_side(following)
        for i in range(particles):
            see(i, group, start, row, frame, scene)
            for o in range(0, hidden, TILE):
                embed(i, o, h, row, weights)
            centre(i, start, x, cx, cy, cz)
        for layer in range(weights.receive.shape[0]):
            for o in range(0, hidden, TILE):
                total(o, h, pooled)
            for o in range(0, hidden, TILE):
                pool(o, pooled, weights.pool[layer], 1.0 / float(particles))
            for i in range(particles):
                for o in range(0, hidden, TILE):
                    mix_in(i, o, h, pooled)
                for o in range(0, hidden, TILE):
                    send(i, o, h, sent, weights.send[layer])
            for i in range(particles):
                for e in range(neighbors.shape[1]):
                    measure(i, neighbors[i, e], e, x, start, edge)
                for o in range(0, hidden, TILE):
                    receive(i, o, 2, h, sent, edge, row, neighbors, weights, layer)
                follow(i, x, following, edge, neighbors)
                for o in range(0, hidden, TILE):
                    hide(i, o, h, row, weights, layer)
                for o in range(0, hidden, TILE):
                    update(i, o, h, row, weights, layer)
            for i in range(particles):
                for axis in range(3):
                    x[i, axis] = following[i, axis]
        for i in range(particles):
            for o in range(0, hidden, TILE):
                hide_last(i, o, h, row, weights)
            displace(i, group, h, row, x, start, following, frame, scene, weights)
        for i in range(particles):
            deliver(i, group, following, scene)

    return predict


@functools.cache
def _kernel_blocks(picks: bool, mirror: bool) -> wp.Kernel:
    """Prediction on a GPU: a block works on a candidate at a time, its threads on particles and tiles of channels."""
    load, _ = accessors(1)
    Scratch = _scratch_type(1)
    Frame, _, _, frame_of, side_of, mean_side = _stroke(1, mirror)
    middle, see, embed, centre = _features(1, picks, mirror)
    hide_last, displace, deliver = _head(1, mirror)
    layers = _layer_blocks()

    @wp.func
    def enter(slot: int, candidate: int, thread: int, scene: Scene, weights: Weights, scratch: Scratch) -> Frame:
        """Positions and first features."""
        start = scratch.start[slot]
        rows = scratch.rows[slot]
        particles, threads = scene.order.shape[0], wp.block_dim()
        frame = frame_of(scene.strokes, candidate)
        for i in range(thread, particles, threads):
            for axis in range(3):
                start[i, axis] = load(scene.positions, candidate, scene.order[i], axis)
            side_of(i, start, scratch.following[slot], frame)
        barrier()
        cx, cy, cz = middle(start)
        frame.side = mean_side(scratch.following[slot])
        for i in range(thread, particles, threads):
            see(i, candidate, start, rows[i], frame, scene)
        barrier()
        for item in range(thread, particles * (weights.embed.shape[1] / TILE), threads):
            i = item % particles
            embed(i, item / particles * TILE, scratch.h[slot], rows[i], weights)
        for i in range(thread, particles, threads):
            centre(i, start, scratch.x[slot], cx, cy, cz)
        barrier()
        return frame

    @wp.func
    def leave(slot: int, candidate: int, thread: int, frame: Frame, scene: Scene, weights: Weights, scratch: Scratch):
        """Displacements and positions."""
        h = scratch.h[slot]
        rows = scratch.rows[slot]
        following = scratch.following[slot]
        particles, threads = scene.order.shape[0], wp.block_dim()
        for item in range(thread, particles * (weights.embed.shape[1] / TILE), threads):
            i = item % particles
            hide_last(i, item / particles * TILE, h, rows[i], weights)
        barrier()
        for i in range(thread, particles, threads):
            displace(i, candidate, h, rows[i], scratch.x[slot], scratch.start[slot], following, frame, scene, weights)
            deliver(i, candidate, following, scene)

    @wp.kernel(**BLOCK_KERNEL)
    def predict(scene: Scene, weights: Weights, scratch: Scratch):
        slot, thread = wp.tid()
        for candidate in range(slot, scene.positions.shape[0], scratch.h.shape[0]):
            frame = enter(slot, candidate, thread, scene, weights, scratch)
            for layer in range(weights.receive.shape[0]):
                layers(slot, thread, layer, scene, weights, scratch)
            leave(slot, candidate, thread, frame, scene, weights, scratch)
            barrier()

    return predict


@functools.cache
def _layer_blocks() -> wp.Function:
    Scratch = _scratch_type(1)
    total, pool, mix_in, send = _pooling(1)
    measure, receive, follow = _messages(1)
    hide, update = _updates(1)

    @wp.func
    def layers(slot: int, thread: int, layer: int, scene: Scene, weights: Weights, scratch: Scratch):
        """One layer of the network, by all threads of a block."""
        h = scratch.h[slot]
        sent = scratch.sent[slot]
        x = scratch.x[slot]
        following = scratch.following[slot]
        pooled = scratch.pooled[slot]
        rows = scratch.rows[slot]
        edges = scratch.edges[slot]
        neighbors = scene.neighbors
        particles, count = neighbors.shape[0], neighbors.shape[1]
        threads = wp.block_dim()
        tiles = weights.embed.shape[1] / TILE
        for tile in range(thread, tiles, threads):
            total(tile * TILE, h, pooled)
        barrier()
        for tile in range(thread, tiles, threads):
            pool(tile * TILE, pooled, weights.pool[layer], 1.0 / float(particles))
        barrier()
        for item in range(thread, particles * tiles, threads):
            mix_in(item % particles, item / particles * TILE, h, pooled)
        barrier()
        for item in range(thread, particles * tiles, threads):
            send(item % particles, item / particles * TILE, h, sent, weights.send[layer])
        for item in range(thread, particles * count, threads):
            i = item % particles
            e = item / particles
            measure(i, neighbors[i, e], e, x, scratch.start[slot], edges[i])
        barrier()
        for item in range(thread, particles * tiles, threads):
            i = item % particles
            tile = item / particles
            receive(i, tile * TILE, 2 + tile, h, sent, edges[i], rows[i], neighbors, weights, layer)
        barrier()
        for item in range(thread, particles * tiles, threads):
            i = item % particles
            hide(i, item / particles * TILE, h, rows[i], weights, layer)
        for i in range(thread, particles, threads):
            follow(i, x, following, edges[i], neighbors)
        barrier()
        for item in range(thread, particles * tiles, threads):
            i = item % particles
            update(i, item / particles * TILE, h, rows[i], weights, layer)
        for i in range(thread, particles, threads):
            for axis in range(3):
                x[i, axis] = following[i, axis]
        barrier()

    return layers


class NetworkKernel:
    """A trained network on one object: positions [B, N, 3] (m) and strokes [B] in, positions after them out.

    The weights are read once, here. `rest` is the object's, with a batch of one.
    """

    def __init__(self, network: EGNN, rest: Rest):
        start_warp()
        self.network = network
        self.standing: dict[tuple[torch.Size, int, int], Standing] = {}
        self.weights = _packed(network, rest.neighbors.shape[-1], str(rest.positions.device))
        self.look_at(rest)

    def look_at(self, rest: Rest) -> None:
        """Predict for another object from now on, with as many neighbours of each particle."""
        self.standing.clear()
        neighbors = rest.neighbors[0].cpu().numpy()
        particles, count = neighbors.shape
        owner = np.repeat(np.arange(particles), count)
        order = bandwidth_order(np.stack([owner, neighbors.reshape(-1)], 1), particles)
        self.rest = rest.positions[0].contiguous()
        self.graph = [
            wp.array(np.ascontiguousarray(a, np.int32), dtype=wp.int32, device=str(rest.positions.device))
            for a in (order, np.argsort(order)[neighbors[order]])
        ]

    @torch.no_grad()
    def __call__(self, positions: Tensor, strokes: Strokes) -> Tensor:
        """`network(positions, strokes, rest)` in float32, without gradients."""
        grasps = torch.empty(len(positions), 4, device=positions.device)
        if self.network.picks:
            row = grasped_particle(positions, strokes)
            height = positions[torch.arange(len(row), device=row.device), row, 2:]
            grasps = torch.cat([self.rest[row], height], -1)
        given = positions, strokes.packed()[:, None], grasps[:, None]
        if positions.device.type == "cpu":
            return self._standing(positions.shape)(*given)
        out = torch.empty(positions.shape, device=positions.device)
        launch, kernel, arguments = self._prepare(*(a.contiguous() for a in given), out)
        launch.run(kernel, arguments)
        return out

    def _standing(self, shape: torch.Size) -> Standing:
        """The launch for so many candidates, by this thread."""
        key = shape, cores(), threading.get_ident()
        if key not in self.standing:
            if len(self.standing) == STANDING:
                self.standing.clear()
            self.standing[key] = Standing((shape, (shape[0], 1, 7), (shape[0], 1, 4), shape), self._prepare)
        return self.standing[key]

    def _prepare(
        self, positions: Tensor, strokes: Tensor, grasps: Tensor, out: Tensor
    ) -> tuple[Launch, wp.Kernel, list[Any]]:
        """What to launch for positions and out [B, N, 3], strokes [B, 1, 7] and grasps [B, 1, 4]."""
        scene = Scene()
        for name, array in (("positions", positions), ("strokes", strokes), ("grasps", grasps), ("out", out)):
            setattr(scene, name, wp.from_torch(array, requires_grad=False))
        scene.order, scene.neighbors = self.graph
        scene.rest = wp.from_torch(self.rest, requires_grad=False)
        batch, device = len(positions), positions.device
        particles, count = self.graph[1].shape
        hidden = self.weights.embed.shape[1]
        on_cpu = device.type == "cpu"
        launch = Launch(batch, device, LANES, particles * hidden // TILE)
        apart, parts = (1, 1) if on_cpu else (particles, hidden // TILE)
        scratch = _scratch_type(launch.lanes)()
        for name, shape in {
            "h": (particles, hidden),
            "sent": (particles, hidden),
            "x": (particles, 3),
            "following": (particles, 3),
            "start": (particles, 3),
            "pooled": (2, hidden),
            "rows": (apart, 2, max(hidden, FEATURES + PICK_FEATURES)),
            "edges": (apart, 2 + parts, count),
        }.items():
            setattr(scratch, name, launch.scratch(*shape))
        picks, mirror = self.network.picks, self.network.mirror
        kernel = _kernel(launch.lanes, picks, mirror) if on_cpu else _kernel_blocks(picks, mirror)
        return launch, kernel, [scene, self.weights, scratch]


def _packed(network: EGNN, count: int, device: str) -> Weights:
    """The network's weights as `_pack` makes them, made once for as long as they stay what they are."""
    state = count, device, tuple(parameter._version for parameter in network.parameters())
    if network not in _PACKED or _PACKED[network][0] != state:
        _PACKED[network] = state, _pack(network, count, device)
    return _PACKED[network][1]


_PACKED: "WeakKeyDictionary[EGNN, tuple[Any, Weights]]" = WeakKeyDictionary()


def _pack(network: EGNN, count: int, device: str) -> Weights:
    """The weights for particles with `count` neighbours, as the kernel reads them; see the module."""
    named = {name: value.detach().cpu().double().numpy() for name, value in network.named_parameters()}
    inputs, hidden, layers = named["embed.weight"].shape[1], len(named["embed.bias"]), len(network.layers)
    if network.head is None:
        zero = {
            "head.0.weight": (hidden, hidden),
            "head.0.bias": hidden,
            "head.2.weight": (3, hidden),
            "head.2.bias": 3,
        }
        named |= {name: np.zeros(shape) for name, shape in zero.items()}
    if not network.pool:
        named |= {f"layers.{i}.pool.weight": np.zeros((hidden, hidden)) for i in range(layers)}
    before, after, share = -math.log2(math.e), -math.log(2), 1 / count

    def stack(name: str) -> np.ndarray:
        return np.stack([named[f"layers.{i}.{name}"].T for i in range(layers)])

    mixed, wide = stack("update.0.weight"), hidden + -hidden % TILE
    values = {  # zeros fill each up to the shape given
        "embed": (named["embed.weight"].T, (inputs, wide)),
        "embed_bias": (named["embed.bias"], (wide,)),
        "pool": (stack("pool.weight"), (layers, wide, wide)),
        "receive": (stack("receive.weight") * before, (layers, wide, wide)),
        "receive_bias": (stack("receive.bias") * before, (layers, wide)),
        "send": (stack("send.weight") * before, (layers, wide, wide)),
        "distance": (stack("distance.weight") * before, (layers, 2, wide)),
        "coordinate": (stack("coordinate.weight")[..., 0] * after * share, (layers, wide)),
        "own": (mixed[:, :hidden] * before, (layers, wide, wide)),
        "message": (mixed[:, hidden:] * before * after * share, (layers, wide, wide)),
        "update_bias": (stack("update.0.bias") * before, (layers, wide)),
        "update": (stack("update.2.weight") * after, (layers, wide, wide)),
        "out_bias": (stack("update.2.bias"), (layers, wide)),
        "head": (named["head.0.weight"].T * before, (wide, wide)),
        "head_bias": (named["head.0.bias"] * before, (wide,)),
        "planar": (named["head.2.weight"].T * after, (wide, TILE)),
        "planar_bias": (named["head.2.bias"], (TILE,)),
        "lift": (named["lift.weight"].T, (wide, TILE)),
        "lift_bias": (named["lift.bias"], (TILE,)),
    }
    weights = Weights()
    for name, (value, shape) in values.items():
        padded = np.pad(value, [(0, want - has) for want, has in zip(shape, value.shape, strict=True)])
        setattr(weights, name, wp.array(padded.astype(np.float32), dtype=wp.float32, device=device))
    return weights
