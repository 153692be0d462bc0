"""The trained network as a kernel: predictions for many candidate strokes on one object.

The truth is `dynamics.egnn`; this holds to it within 1e-5 m and is tested so. All candidates share the graph of the
object at rest. A group of candidates runs through the whole network, particle by particle, so that what it works on
stays in the cache. Weights are packed for it: those before a SiLU are scaled by -log2 e and those after by the inverse,
which leaves one power of two and one division of it, -log2(e) silu(t) = s / (1 + 2^s) with s = -log2(e) t.
"""

import functools
import math
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from piegraph_cli.dynamics.action import FEATURES, NEAR, PICK_FEATURES, grasped_particle
from piegraph_cli.dynamics.egnn import DECIMETRE, EGNN, Rest
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.kernels.lanes import KERNEL, Launch, accessors, bandwidth_order, start_warp, vector

LANES = 64
"""Candidates in a group on a CPU. Measured: 16 and 32 take two to three times as long, being unrolled, not vectorised."""

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


@functools.cache
def _kernel(lanes: int, picks: bool, mirror: bool) -> wp.Kernel:
    """The kernel for groups of `lanes` candidates."""
    vec = vector(lanes)
    load, store = accessors(lanes)
    zero, one = vec(0.0), vec(1.0)

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

    @wp.func
    def root(a: vec) -> vec:
        r = vec()
        for k in range(lanes):
            r[k] = wp.sqrt(a[k])
        return r

    @wp.func
    def quotient(a: vec, b: vec) -> vec:
        r = vec()
        for k in range(lanes):
            r[k] = a[k] / b[k]
        return r

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
    def put(rows: wp.array2d(dtype=vec), row: int, o: int, a: vec, b: vec, c: vec, d: vec):
        rows[row, o] = a
        rows[row, o + 1] = b
        rows[row, o + 2] = c
        rows[row, o + 3] = d

    @wp.func
    def bias(b: wp.array(dtype=wp.float32), o: int):
        return vec(b[o]), vec(b[o + 1]), vec(b[o + 2]), vec(b[o + 3])

    @wp.func
    def offset(x: wp.array2d(dtype=vec), i: int, j: int):
        return x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]

    @wp.kernel(**KERNEL)
    def predict(
        first_group: int,
        first_slot: int,
        apart: int,
        positions: wp.array3d(dtype=wp.float32),
        strokes: wp.array3d(dtype=wp.float32),
        grasps: wp.array3d(dtype=wp.float32),
        out: wp.array3d(dtype=wp.float32),
        order: wp.array(dtype=wp.int32),
        neighbors: wp.array2d(dtype=wp.int32),
        rest: wp.array2d(dtype=wp.float32),
        weights: Weights,
        features: wp.array3d(dtype=vec),
        sent: wp.array3d(dtype=vec),
        states: wp.array3d(dtype=vec),
        nexts: wp.array3d(dtype=vec),
        starts: wp.array3d(dtype=vec),
        edges: wp.array3d(dtype=vec),
        rows: wp.array3d(dtype=vec),
    ):
        group = first_group + wp.tid()
        slot = first_slot + wp.tid() * apart
        h = features[slot]
        send = sent[slot]
        x = states[slot]
        following = nexts[slot]
        start = starts[slot]
        edge = edges[slot]
        row = rows[slot]
        particles = order.shape[0]
        count = neighbors.shape[1]
        hidden = weights.embed.shape[1]

        cx = zero
        cy = zero
        cz = zero
        for i in range(particles):
            for axis in range(3):
                start[i, axis] = load(positions, group, order[i], axis)
            cx += start[i, 0]
            cy += start[i, 1]
            cz += start[i, 2]
        share = 1.0 / float(particles)
        cx = cx * share
        cy = cy * share
        cz = cz * share
        ex = load(strokes, group, 0, 2)
        ey = load(strokes, group, 0, 3)
        hx = ex - load(strokes, group, 0, 0)
        hy = ey - load(strokes, group, 0, 1)
        length = root(wp.cw_mul(hx, hx) + wp.cw_mul(hy, hy))
        hx = quotient(hx, length)
        hy = quotient(hy, length)
        mode = load(strokes, group, 0, 4)
        object_side = one
        if wp.static(mirror):
            object_side = zero
            for i in range(particles):
                object_side += squash(beside(start[i, 0] - ex, start[i, 1] - ey, hx, hy))
            object_side = object_side * share

        for i in range(particles):
            dx = start[i, 0] - ex
            dy = start[i, 1] - ey
            row[0, 0] = (wp.cw_mul(dx, hx) + wp.cw_mul(dy, hy)) * SCALE
            row[0, 1] = beside(dx, dy, hx, hy)
            row[0, 2] = start[i, 2] * SCALE
            row[0, 3] = length * SCALE
            row[0, 4] = mode
            row[0, 5] = squash(row[0, 0])
            row[0, 6] = squash(row[0, 0] + row[0, 3])
            row[0, 7] = squash(row[0, 1])
            row[0, 8] = wp.max(row[0, 1], -row[0, 1])
            row[0, 9] = wp.max(row[0, 7], -row[0, 7])
            row[0, 1] = wp.cw_mul(row[0, 1], object_side)
            row[0, 7] = wp.cw_mul(row[0, 7], object_side)
            if wp.static(picks):
                gx = vec(rest[order[i], 0]) - load(grasps, group, 0, 0)
                gy = vec(rest[order[i], 1]) - load(grasps, group, 0, 1)
                gz = vec(rest[order[i], 2]) - load(grasps, group, 0, 2)
                reach = root(wp.cw_mul(gx, gx) + wp.cw_mul(gy, gy) + wp.cw_mul(gz, gz))
                slack = wp.max(root(wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy)) - reach, zero)
                row[0, 10] = wp.cw_mul(mode, load(strokes, group, 0, 5))
                row[0, 11] = wp.cw_mul(mode, load(strokes, group, 0, 6))
                row[0, 12] = wp.cw_mul(mode, reach) * SCALE
                row[0, 13] = wp.cw_mul(mode, slack) * SCALE
                row[0, 14] = wp.cw_mul(mode, start[i, 2] - load(grasps, group, 0, 3)) * SCALE
            for o in range(0, hidden, TILE):
                a, b, c, d = bias(weights.embed_bias, o)
                a, b, c, d = linear(row, 0, weights.embed, o, a, b, c, d)
                put(h, i, o, a, b, c, d)
        for i in range(particles):
            start[i, 0] = (start[i, 0] - cx) * SCALE
            start[i, 1] = (start[i, 1] - cy) * SCALE
            start[i, 2] = (start[i, 2] - cz) * SCALE
            for axis in range(3):
                x[i, axis] = start[i, axis]

        for layer in range(weights.receive.shape[0]):
            w_receive = weights.receive[layer]
            w_send = weights.send[layer]
            w_distance = weights.distance[layer]
            w_coordinate = weights.coordinate[layer]
            for o in range(0, hidden, TILE):
                put(row, 0, o, zero, zero, zero, zero)
                for i in range(particles):
                    put(
                        row,
                        0,
                        o,
                        row[0, o] + h[i, o],
                        row[0, o + 1] + h[i, o + 1],
                        row[0, o + 2] + h[i, o + 2],
                        row[0, o + 3] + h[i, o + 3],
                    )
            for o in range(0, hidden, TILE):
                a, b, c, d = linear(row, 0, weights.pool[layer], o, zero, zero, zero, zero)
                for i in range(particles):
                    put(
                        h,
                        i,
                        o,
                        h[i, o] + a * share,
                        h[i, o + 1] + b * share,
                        h[i, o + 2] + c * share,
                        h[i, o + 3] + d * share,
                    )
            for i in range(particles):
                for o in range(0, hidden, TILE):
                    a, b, c, d = linear(h, i, w_send, o, zero, zero, zero, zero)
                    put(send, i, o, a, b, c, d)
            for i in range(particles):
                for e in range(count):
                    j = neighbors[i, e]
                    dx, dy, dz = offset(x, i, j)
                    edge[0, e] = root(wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy) + wp.cw_mul(dz, dz) + vec(1.0e-12))
                    dx, dy, dz = offset(start, i, j)
                    edge[1, e] = wp.cw_mul(dx, dx) + wp.cw_mul(dy, dy) + wp.cw_mul(dz, dz)
                    edge[2, e] = zero
                for o in range(0, hidden, TILE):
                    a, b, c, d = bias(weights.receive_bias[layer], o)
                    a, b, c, d = linear(h, i, w_receive, o, a, b, c, d)
                    sa = zero
                    sb = zero
                    sc = zero
                    sd = zero
                    for e in range(count):
                        j = neighbors[i, e]
                        near = edge[0, e]
                        was = edge[1, e]
                        ma = gate(a + send[j, o] + near * w_distance[0, o] + was * w_distance[1, o])
                        mb = gate(b + send[j, o + 1] + near * w_distance[0, o + 1] + was * w_distance[1, o + 1])
                        mc = gate(c + send[j, o + 2] + near * w_distance[0, o + 2] + was * w_distance[1, o + 2])
                        md = gate(d + send[j, o + 3] + near * w_distance[0, o + 3] + was * w_distance[1, o + 3])
                        sa += ma
                        sb += mb
                        sc += mc
                        sd += md
                        edge[2, e] = (
                            edge[2, e]
                            + ma * w_coordinate[o]
                            + mb * w_coordinate[o + 1]
                            + mc * w_coordinate[o + 2]
                            + md * w_coordinate[o + 3]
                        )
                    put(row, 1, o, sa, sb, sc, sd)
                ux = x[i, 0]
                uy = x[i, 1]
                uz = x[i, 2]
                for e in range(count):
                    dx, dy, dz = offset(x, i, neighbors[i, e])
                    push = quotient(edge[2, e], edge[0, e] + one)
                    ux += wp.cw_mul(dx, push)
                    uy += wp.cw_mul(dy, push)
                    uz += wp.cw_mul(dz, push)
                following[i, 0] = ux
                following[i, 1] = uy
                following[i, 2] = uz
                for o in range(0, hidden, TILE):
                    a, b, c, d = bias(weights.update_bias[layer], o)
                    a, b, c, d = linear(h, i, weights.own[layer], o, a, b, c, d)
                    a, b, c, d = linear(row, 1, weights.message[layer], o, a, b, c, d)
                    put(row, 0, o, gate(a), gate(b), gate(c), gate(d))
                for o in range(0, hidden, TILE):
                    a, b, c, d = bias(weights.out_bias[layer], o)
                    a, b, c, d = linear(row, 0, weights.update[layer], o, a, b, c, d)
                    put(h, i, o, h[i, o] + a, h[i, o + 1] + b, h[i, o + 2] + c, h[i, o + 3] + d)
            for i in range(particles):
                for axis in range(3):
                    x[i, axis] = following[i, axis]

        for i in range(particles):
            for o in range(0, hidden, TILE):
                a, b, c, d = bias(weights.head_bias, o)
                a, b, c, d = linear(h, i, weights.head, o, a, b, c, d)
                put(row, 0, o, gate(a), gate(b), gate(c), gate(d))
            particle_side = one
            if wp.static(mirror):
                dx = load(positions, group, order[i], 0) - ex
                dy = load(positions, group, order[i], 1) - ey
                particle_side = squash(beside(dx, dy, hx, hy))
            a, b, c, d = bias(weights.planar_bias, 0)
            px, py, pw, d = linear(row, 0, weights.planar, 0, a, b, c, d)
            py = wp.cw_mul(py, particle_side) + wp.cw_mul(pw, object_side)
            a, b, c, d = bias(weights.lift_bias, 0)
            pz, b, c, d = linear(h, i, weights.lift, 0, a, b, c, d)
            following[i, 0] = (x[i, 0] - start[i, 0] + wp.cw_mul(hx, px) - wp.cw_mul(hy, py)) / SCALE
            following[i, 1] = (x[i, 1] - start[i, 1] + wp.cw_mul(hy, px) + wp.cw_mul(hx, py)) / SCALE
            following[i, 2] = (x[i, 2] - start[i, 2] + pz) / SCALE
        for i in range(particles):
            for axis in range(3):
                moved = load(positions, group, order[i], axis) + following[i, axis]
                store(out, group, order[i], axis, moved)

    return predict


class NetworkKernel:
    """A trained network on one object: positions [B, N, 3] (m) and strokes [B] in, positions after them out.

    The weights are read once, here. `rest` is the object's, with a batch of one.
    """

    def __init__(self, network: EGNN, rest: Rest):
        start_warp()
        self.network = network
        self.weights = _pack(network, rest.neighbors.shape[-1], str(rest.positions.device))
        self.look_at(rest)

    def look_at(self, rest: Rest) -> None:
        """Predict for another object from now on, with as many neighbours of each particle."""
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
        launch = Launch(len(positions), positions.device, LANES)
        particles, count = self.graph[1].shape
        hidden = self.weights.embed.shape[1]
        grasps = torch.empty(len(positions), 4, device=positions.device)
        if self.network.picks:
            row = grasped_particle(positions, strokes)
            height = positions[torch.arange(len(row), device=row.device), row, 2:]
            grasps = torch.cat([self.rest[row], height], -1)
        out = torch.empty_like(positions)
        arguments: list[Any] = [
            positions.contiguous(),
            strokes.packed()[:, None],
            grasps[:, None].contiguous(),
            out,
        ]
        arguments += [*self.graph, self.rest, self.weights]
        arguments += [launch.scratch(particles, hidden) for _ in range(2)]
        arguments += [launch.scratch(particles, 3) for _ in range(3)]
        arguments += [launch.scratch(3, count), launch.scratch(2, max(hidden, FEATURES + PICK_FEATURES))]
        launch.run(_kernel(launch.lanes, self.network.picks, self.network.mirror), arguments)
        return out


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
