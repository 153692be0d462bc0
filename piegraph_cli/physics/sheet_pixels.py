"""Which triangle of a sheet each pixel of a camera shows, and where on it, as kernels of one thread each, for a CPU."""

from typing import NamedTuple

import numpy as np
import warp as wp

from piegraph_cli.physics.sheet_kernel import KERNEL, TINY, memory_of


@wp.kernel(**KERNEL)
def raster(
    pixels: wp.array(dtype=wp.vec3),
    triangles: wp.array2d(dtype=wp.int32),
    owner: wp.array2d(dtype=wp.int32),
    depth: wp.array2d(dtype=wp.float32),
    weights: wp.array2d(dtype=wp.vec3),
):
    """The nearest triangle at every pixel, from corners (column, row, depth in m); weights are those of its corners."""
    height = owner.shape[0]
    width = owner.shape[1]
    for t in range(triangles.shape[0]):
        a = pixels[triangles[t, 0]]
        b = pixels[triangles[t, 1]]
        c = pixels[triangles[t, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if wp.abs(area) > 1e-6 and wp.min(a[2], wp.min(b[2], c[2])) > 0.05:
            left = wp.max(0, int(wp.ceil(wp.min(a[0], wp.min(b[0], c[0])))))
            right = wp.min(width - 1, int(wp.floor(wp.max(a[0], wp.max(b[0], c[0])))))
            top = wp.max(0, int(wp.ceil(wp.min(a[1], wp.min(b[1], c[1])))))
            bottom = wp.min(height - 1, int(wp.floor(wp.max(a[1], wp.max(b[1], c[1])))))
            for row in range(top, bottom + 1):
                for column in range(left, right + 1):
                    u = float(column)
                    v = float(row)
                    wa = ((b[0] - u) * (c[1] - v) - (c[0] - u) * (b[1] - v)) / area
                    wb = ((c[0] - u) * (a[1] - v) - (a[0] - u) * (c[1] - v)) / area
                    wc = 1.0 - wa - wb
                    if wa >= 0.0 and wb >= 0.0 and wc >= 0.0:
                        inverse = wa / a[2] + wb / b[2] + wc / c[2]
                        z = 1.0 / inverse
                        if owner[row, column] < 0 or z < depth[row, column]:
                            owner[row, column] = t
                            depth[row, column] = z
                            weights[row, column] = wp.vec3(wa / a[2], wb / b[2], wc / c[2]) * z


@wp.kernel(**KERNEL)
def listed(
    owner: wp.array2d(dtype=wp.int32),
    weights: wp.array2d(dtype=wp.vec3),
    middle: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3),
    triangles: wp.array2d(dtype=wp.int32),
    origin: wp.vec3,
    pixels: wp.array2d(dtype=wp.int64),
    corners: wp.array2d(dtype=wp.int64),
    told: wp.array2d(dtype=wp.vec3),
    front: wp.array(dtype=wp.bool),
):
    """The pixels that show a triangle, row by row."""
    n = int(0)  # noqa: RUF046, UP018
    for row in range(owner.shape[0]):
        for column in range(owner.shape[1]):
            t = owner[row, column]
            if t >= 0:
                i = triangles[t, 0]
                j = triangles[t, 1]
                k = triangles[t, 2]
                share = weights[row, column]
                normal = wp.cross(middle[j] - middle[i], middle[k] - middle[i])
                normal = normal / wp.max(wp.length(normal), TINY)
                pixels[n, 0] = wp.int64(row)
                pixels[n, 1] = wp.int64(column)
                corners[n, 0] = wp.int64(i)
                corners[n, 1] = wp.int64(j)
                corners[n, 2] = wp.int64(k)
                told[0, n] = share
                told[1, n] = share[0] * faces[i] + share[1] * faces[j] + share[2] * faces[k]
                told[2, n] = normal
                front[n] = wp.dot(normal, origin - middle[i]) > 0.0
                n += 1


class Seen(NamedTuple):
    """P pixels that show a sheet, as `Surface` has them."""

    pixels: np.ndarray
    corners: np.ndarray
    weights: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    front: np.ndarray
    owner: np.ndarray
    along: np.ndarray


def seen(
    projected: np.ndarray,
    faces: np.ndarray,
    middle: np.ndarray,
    triangles: np.ndarray,
    origin: np.ndarray,
    shape: tuple[int, int],
) -> Seen:
    """What a camera at `origin` [3] sees in an image of that shape of triangles [T, 3] int32, the nearest at each pixel.

    Of every node [N, 3] float32: column, row and depth (m) in the image, its place (m) on the face towards the camera,
    and its place in the middle of the sheet.
    """
    owner, along, weights = np.full(shape, -1, np.int32), np.zeros(shape, np.float32), np.empty((*shape, 3), np.float32)
    nodes, net = memory_of(projected, vectors=True), memory_of(triangles)
    drawn = memory_of(owner), memory_of(weights, vectors=True)
    wp.launch(raster, 1, [nodes, net, drawn[0], memory_of(along), drawn[1]], device="cpu")
    count = int(np.count_nonzero(owner >= 0))
    pixels, corners, front = np.empty((count, 2), np.int64), np.empty((count, 3), np.int64), np.empty(count, bool)
    told = np.empty((3, count, 3), np.float32)
    if count:
        made = [memory_of(pixels), memory_of(corners), memory_of(told, vectors=True), memory_of(front)]
        given = [memory_of(middle, vectors=True), memory_of(faces, vectors=True), net, wp.vec3(*map(float, origin))]
        wp.launch(listed, 1, [*drawn, *given, *made], device="cpu")
    return Seen(pixels, corners, *told, front, owner, along)
