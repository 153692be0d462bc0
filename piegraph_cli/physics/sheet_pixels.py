"""Which triangle of a sheet each pixel of a camera shows, and where on it, as kernels of one thread each, for a CPU."""

from collections.abc import Sequence

import numpy as np
import warp as wp

from piegraph_cli.physics.sheet_kernel import KERNEL, TINY, memory_of


@wp.kernel(**KERNEL)
def raster(
    projected: wp.array2d(dtype=wp.vec3),
    triangles: wp.array2d(dtype=wp.int32),
    windows: wp.array2d(dtype=wp.int32),
    owner: wp.array(dtype=wp.int32),
    depth: wp.array(dtype=wp.float32),
    weights: wp.array(dtype=wp.vec3),
):
    """The nearest triangle at every pixel, from corners (column, row, depth in m); weights are those of its corners."""
    for camera in range(windows.shape[0]):
        height = windows[camera, 1]
        width = windows[camera, 2]
        for t in range(triangles.shape[0]):
            a = projected[camera, triangles[t, 0]]
            b = projected[camera, triangles[t, 1]]
            c = projected[camera, triangles[t, 2]]
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
                            z = 1.0 / (wa / a[2] + wb / b[2] + wc / c[2])
                            at = windows[camera, 0] + row * width + column
                            if owner[at] < 0 or z < depth[at]:
                                owner[at] = t
                                depth[at] = z
                                weights[at] = wp.vec3(wa / a[2], wb / b[2], wc / c[2]) * z


@wp.kernel(**KERNEL)
def listed(
    owner: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.vec3),
    windows: wp.array2d(dtype=wp.int32),
    origins: wp.array(dtype=wp.vec3),
    middle: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.vec3),
    triangles: wp.array2d(dtype=wp.int32),
    pixels: wp.array2d(dtype=wp.int64),
    corners: wp.array2d(dtype=wp.int64),
    told: wp.array2d(dtype=wp.vec3),
    front: wp.array(dtype=wp.bool),
):
    """The pixels that show a triangle, camera by camera and row by row."""
    n = int(0)  # noqa: RUF046, UP018
    for camera in range(windows.shape[0]):
        for row in range(windows[camera, 1]):
            for column in range(windows[camera, 2]):
                at = windows[camera, 0] + row * windows[camera, 2] + column
                t = owner[at]
                if t >= 0:
                    i = triangles[t, 0]
                    j = triangles[t, 1]
                    k = triangles[t, 2]
                    w = weights[at]
                    normal = wp.cross(middle[j] - middle[i], middle[k] - middle[i])
                    normal = normal / wp.max(wp.length(normal), TINY)
                    pixels[n, 0] = wp.int64(row)
                    pixels[n, 1] = wp.int64(column)
                    corners[n, 0] = wp.int64(i)
                    corners[n, 1] = wp.int64(j)
                    corners[n, 2] = wp.int64(k)
                    told[0, n] = w
                    told[1, n] = w[0] * faces[camera, i] + w[1] * faces[camera, j] + w[2] * faces[camera, k]
                    told[2, n] = normal
                    front[n] = wp.dot(normal, origins[camera] - middle[i]) > 0.0
                    n += 1


def seen(
    projected: np.ndarray,
    faces: np.ndarray,
    middle: np.ndarray,
    triangles: np.ndarray,
    origins: np.ndarray,
    shapes: Sequence[tuple[int, int]],
) -> list[tuple[np.ndarray, ...]]:
    """What C cameras at `origins` [C, 3] see in images of those shapes of triangles [T, 3] int32, the nearest at each pixel.

    Of every node, float32: column, row and depth (m) in each image [C, N, 3], its places (m) on the face towards each camera
    [C, N, 3] and in the middle of the sheet [N, 3]. The arrays of a `Surface` for each, in its order.
    """
    ends = np.cumsum([height * width for height, width in shapes])
    windows = np.array([[end - h * w, h, w] for end, (h, w) in zip(ends, shapes, strict=True)], np.int32)
    owner, along = np.full(ends[-1], -1, np.int32), np.zeros(ends[-1], np.float32)
    weights = np.empty((ends[-1], 3), np.float32)
    net, parts, drawn = memory_of(triangles), memory_of(windows), (memory_of(owner), memory_of(weights, vectors=True))
    images = [drawn[0], memory_of(along), drawn[1]]
    wp.launch(raster, 1, [memory_of(projected, vectors=True), net, parts, *images], device="cpu")
    counts = [int(np.count_nonzero(owner[end - h * w : end] >= 0)) for end, (h, w) in zip(ends, shapes, strict=True)]
    count = sum(counts)
    pixels, corners, front = np.empty((count, 2), np.int64), np.empty((count, 3), np.int64), np.empty(count, bool)
    told = np.empty((3, count, 3), np.float32)
    if count:
        given = [memory_of(values, vectors=True) for values in (origins, middle, faces)]
        made = [memory_of(pixels), memory_of(corners), memory_of(told, vectors=True), memory_of(front)]
        wp.launch(listed, 1, [*drawn, parts, *given, net, *made], device="cpu")
    lists = [np.split(values, np.cumsum(counts)[:-1]) for values in (pixels, corners, *told, front)]
    whole = [np.split(values, ends[:-1]) for values in (owner, along)]
    return [(*(one[k] for one in lists), *(one[k].reshape(shape) for one in whole)) for k, shape in enumerate(shapes)]
