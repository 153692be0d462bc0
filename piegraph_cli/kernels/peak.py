"""What a core can do at most: nothing but multiply-adds in registers, nothing but copies in its first cache."""

import functools

import warp as wp

from piegraph_cli.kernels.lanes import WIDE, vector

ACCUMULATORS = 10
"""Enough to hide the latency of one, few enough for the registers."""

OPTIONS = {"module": "unique", "enable_backward": False, "module_options": {"cpu_compiler_flags": WIDE}}
"""Of both kernels: unrolled, unlike the kernels of many lanes."""


@functools.cache
def multiply_add(width: int) -> wp.Kernel:
    """A kernel of independent fused multiply-adds on vectors of `width` floats."""
    vec = vector(width)

    @wp.kernel(**OPTIONS)
    def loop(first_group: int, slot: int, values: wp.array2d(dtype=vec), steps: int):
        factor = values[slot, 0]
        more = values[slot, 1]
        a = values[slot, 0]
        b = values[slot, 1]
        c = values[slot, 2]
        d = values[slot, 3]
        e = values[slot, 4]
        f = values[slot, 5]
        g = values[slot, 6]
        h = values[slot, 7]
        i = values[slot, 8]
        j = values[slot, 9]
        for _ in range(steps):
            a = wp.cw_mul(a, factor) + more
            b = wp.cw_mul(b, factor) + more
            c = wp.cw_mul(c, factor) + more
            d = wp.cw_mul(d, factor) + more
            e = wp.cw_mul(e, factor) + more
            f = wp.cw_mul(f, factor) + more
            g = wp.cw_mul(g, factor) + more
            h = wp.cw_mul(h, factor) + more
            i = wp.cw_mul(i, factor) + more
            j = wp.cw_mul(j, factor) + more
        values[slot, 0] = a
        values[slot, 1] = b
        values[slot, 2] = c
        values[slot, 3] = d
        values[slot, 4] = e
        values[slot, 5] = f
        values[slot, 6] = g
        values[slot, 7] = h
        values[slot, 8] = i
        values[slot, 9] = j

    return loop


@functools.cache
def copy_back_and_forth(width: int) -> wp.Kernel:
    """A kernel that copies rows of vectors of `width` floats to others and, reversed, back."""
    vec = vector(width)

    @wp.kernel(**OPTIONS)
    def loop(first_group: int, slot: int, a: wp.array2d(dtype=vec), b: wp.array2d(dtype=vec), steps: int):
        for _ in range(steps):
            for i in range(a.shape[1]):
                b[slot, i] = a[slot, i]
            for i in range(a.shape[1]):
                a[slot, i] = b[slot, a.shape[1] - 1 - i]

    return loop
