"""Quasi-static pushing of a rigid body on a table by a round pusher, a candidate per thread, in Warp.

The body meets the table's friction as an ellipsoidal limit surface; the pusher's friction is Coulomb's, so that it sticks,
slides to either side, or leaves. Source: Goyal, Ruina, Papadopoulos (1991); Lynch, Maekawa, Tanie (1992).
"""

import functools
from typing import Any

import torch
import warp as wp
from torch import Tensor

from piegraph_cli.kernels.lanes import KERNEL, Launch

STRIDE = 5e-4
"""Metres of the pusher in a step of the integration."""


@functools.cache
def _kernel() -> Any:
    @wp.func
    def nearest(edges: wp.array3d(dtype=wp.float32), of: int, p: wp.vec2) -> wp.vec3:
        """The nearest point of an outline, and 1 where p is outside, -1 inside."""
        best, least, side = wp.vec2(0.0, 0.0), float(1e12), float(1.0)  # noqa: UP018 - Warp takes a literal for a constant
        for k in range(edges.shape[1]):
            a = wp.vec2(edges[of, k, 0], edges[of, k, 1])
            b = wp.vec2(edges[of, k, 2], edges[of, k, 3]) - a
            share = wp.clamp(wp.dot(p - a, b) / wp.max(wp.dot(b, b), 1e-12), 0.0, 1.0)
            q = a + share * b
            apart = wp.dot(p - q, p - q)
            if apart < least:
                best, least = q, apart
            if ((a[1] > p[1]) != (a[1] + b[1] > p[1])) and p[0] < a[0] + (p[1] - a[1]) / b[1] * b[0]:
                side = -side
        return wp.vec3(best[0], best[1], side)

    @wp.func
    def twist(r: wp.vec2, n: wp.vec2, depth: float, slip: float, friction: float, c: float) -> wp.vec3:
        """Motion of the centre of friction and turn, for a contact at r from it that yields by `depth` along n."""
        t = wp.vec2(-n[1], n[0])
        i = 1.0 / (c * c)
        mobility = wp.mat22(1.0 + r[1] * r[1] * i, -r[0] * r[1] * i, -r[0] * r[1] * i, 1.0 + r[0] * r[0] * i)
        force = wp.inverse(mobility) * (depth * n + slip * t)
        along, across = wp.dot(force, n), wp.dot(force, t)
        if wp.abs(across) > friction * along:
            edge = n + friction * wp.sign(across) * t
            yields = wp.dot(n, mobility * edge)
            if yields > 1e-3:
                force = depth / yields * edge
        return wp.vec3(force[0], force[1], (r[0] * force[1] - r[1] * force[0]) * i)

    @wp.kernel(**KERNEL)
    def push(
        first: int,
        slot: int,
        each: int,
        edges: wp.array3d(dtype=wp.float32),
        poses: wp.array2d(dtype=wp.float32),
        strokes: wp.array2d(dtype=wp.float32),
        numbers: wp.array2d(dtype=wp.float32),
        stride: float,
        moved: wp.array2d(dtype=wp.float32),
    ):
        b = first + wp.tid()
        of = b // each
        friction, c, given = numbers[b, 0], numbers[b, 1], numbers[b, 2]
        centre = wp.vec2(numbers[b, 3], numbers[b, 4])
        yaw = poses[b, 2]
        turn = wp.mat22(wp.cos(yaw), -wp.sin(yaw), wp.sin(yaw), wp.cos(yaw))
        place = wp.vec2(poses[b, 0], poses[b, 1]) + turn * centre
        start = wp.vec2(strokes[b, 0], strokes[b, 1])
        along = wp.vec2(strokes[b, 2], strokes[b, 3]) - start
        steps = int(wp.ceil(wp.length(along) / stride))
        step = along / float(steps)
        p = wp.transpose(turn) * (start - place) + centre
        reach = given
        met = nearest(edges, of, p)
        if met[2] > 0.0:  # a pusher that is measured too near touches at the beginning, and moves nothing by it
            reach = wp.min(given, wp.max(wp.length(p - wp.vec2(met[0], met[1])), 0.001))
        for k in range(steps):
            turn = wp.mat22(wp.cos(yaw), -wp.sin(yaw), wp.sin(yaw), wp.cos(yaw))
            p = wp.transpose(turn) * (start + float(k + 1) * step - place) + centre
            met = nearest(edges, of, p)
            q, side = wp.vec2(met[0], met[1]), met[2]
            apart = wp.length(q - p)
            depth = reach - side * apart
            if depth > 0.0 and apart > 1e-7:
                n = side * (q - p) / apart
                slip = wp.dot(wp.transpose(turn) * step, wp.vec2(-n[1], n[0]))
                motion = twist(q - centre, n, depth, slip, friction, c)
                place += turn * wp.vec2(motion[0], motion[1])
                yaw += motion[2]
        turn = wp.mat22(wp.cos(yaw), -wp.sin(yaw), wp.sin(yaw), wp.cos(yaw))
        place -= turn * centre
        moved[b, 0] = place[0]
        moved[b, 1] = place[1]
        moved[b, 2] = yaw

    return push


def push(edges: Tensor, poses: Tensor, strokes: Tensor, numbers: Tensor, stride: float = STRIDE) -> Tensor:
    """Poses [B, 3] (x, y (m), yaw (rad)) of a body after one straight stroke each, from poses [B, 3].

    edges [E, 4]: ends of the outline's pieces in the body's frame (m), or [K, E, 4] for K outlines, each for B / K
    candidates in a row; strokes [B, 4]: start and end of the pusher (m);
    numbers [B, 5]: friction with the pusher, length c that converts turning into sliding (m), distance that the pusher's
    centre keeps from the outline (m), centre of friction in the body's frame (m).
    """
    moved = torch.empty_like(poses)
    launch = Launch(len(poses), poses.device, cpu_lanes=1)
    edges = edges if edges.ndim == 3 else edges[None]
    arrays = [wp.from_torch(a.contiguous()) for a in (edges, poses, strokes, numbers)]
    arguments = [max(len(poses) // len(edges), 1), *arrays, stride, wp.from_torch(moved)]
    if poses.is_cuda:
        stream = wp.stream_from_torch(torch.cuda.current_stream(poses.device))
        wp.launch(_kernel(), len(poses), [0, 0, *arguments], device=str(poses.device), stream=stream)
    else:
        launch.run(_kernel(), arguments)
    return moved
