"""Which part of a sheet each pixel of a camera shows, were the sheet in a given state; sums over such pixels per particle."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piegraph_cli.physics.sheet_images import Lens, Shot, sampled
from piegraph_cli.physics.sheet_kernel import Cloth
from piegraph_cli.physics.sheet_mesh import SheetMesh
from piegraph_cli.physics.sheet_pixels import seen

LAYER = 0.004
"""Metres along the optical axis within which what is seen is the same layer."""
LEAST = 1e-9
"""Summed weight below which nothing is asked."""
ODD, ODDER = 0.006, 2.5
"""Metres, and times the usual difference, from the ways asked for around it beyond which a pixel's way is left out."""


@dataclass(frozen=True, eq=False)
class Surface:
    """P pixels of a camera that show the sheet."""

    pixels: np.ndarray
    """[P, 2] row and column."""
    corners: np.ndarray
    """[P, 3] nodes of the triangle that is seen."""
    weights: np.ndarray
    """[P, 3] their weights."""
    points: np.ndarray
    """[P, 3] metres: the place on the sheet's face."""
    normals: np.ndarray
    """[P, 3] unit normals of the triangles."""
    front: np.ndarray
    """[P] bool: whether it is the face that lay above in the first frame."""
    owner: np.ndarray
    """[H, W] triangle, -1 where none is seen."""
    along: np.ndarray
    """[H, W] metres to it, along the optical axis."""

    @cached_property
    def flat(self) -> np.ndarray:
        """[P] the pixels, counted row by row."""
        return self.pixels[:, 0] * self.owner.shape[1] + self.pixels[:, 1]

    @cached_property
    def depth(self) -> np.ndarray:
        """[P] metres along the optical axis."""
        return self.along.take(self.flat)


def faces_of(mesh: SheetMesh, x: np.ndarray, normals: np.ndarray, lens: Lens) -> np.ndarray:
    """The places [N, 3] float32 (m) of nodes x [N, 3], with normals [N, 3], on the face that is towards a camera."""
    side = np.sign(np.einsum("nk,nk->n", normals, lens.origin - x))
    return (x + mesh.half * side[:, None] * normals).astype(np.float32)


def shades_before(surface: Surface, old: Surface, shot: Shot, faces: np.ndarray) -> np.ndarray:
    """The shade [P] of each pixel's place on the sheet in the image before, NaN where another triangle hid it.

    `faces` [N, 3] (m) is where the nodes were in that image, `old` what it showed.
    """
    height, width = shot.grey.shape
    across, down, far = shot.lens.project(spread(surface.corners, surface.weights, faces)).T
    near, below = np.rint(across).astype(np.int32), np.rint(down).astype(np.int32)
    column, row = near.clip(0, width - 1), below.clip(0, height - 1)
    at = row * width + column
    shown = (near == column) & (below == row) & (shot.mask.take(at) > 0)
    shown &= (old.owner.take(at) >= 0) & (np.abs(old.along.take(at) - far) < LAYER)
    shades = sampled(shot.grey, across, down).astype(np.float32)
    return np.where(shown, shades, np.float32(np.nan))


def spread(corners: np.ndarray, weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values [P, ...] at pixels by the weights [P, 3] of corners [P, 3], the nodes having values [N, ...]."""
    shares = weights.reshape(*weights.shape, *[1] * (values.ndim - 1))
    first, second, third = (shares[:, k] * values.take(corners[:, k], 0) for k in range(3))
    return first + second + third


def visible(cloth: Cloth, x: np.ndarray, normals: np.ndarray, lenses: Sequence[Lens]) -> list[Surface]:
    """What cameras see of a sheet whose nodes are at x [N, 3] (m), with normals [N, 3]: the nearest layer at each pixel."""
    faces = np.stack([faces_of(cloth.mesh, x, normals, lens) for lens in lenses])
    projected = np.stack([lens.project(places) for lens, places in zip(lenses, faces, strict=True)])
    origins, shapes = np.stack([lens.origin for lens in lenses]), [lens.rays.shape[:2] for lens in lenses]
    middle = np.ascontiguousarray(x, np.float32)
    return [Surface(*one) for one in seen(projected, faces, middle, cloth.mesh.triangles, origins, shapes)]


def length(ways: np.ndarray) -> np.ndarray:
    """[P] of ways [P, 2 or 3]."""
    return np.sqrt(np.einsum("pc,pc->p", ways, ways))


class Sums:
    """Ways that pixels ask of the sheet, summed per node by the weights of the triangles that they show."""

    def __init__(self, nodes: int):
        self.way = np.zeros((nodes, 3))
        """[N, 3] metres, times weights."""
        self.weight = np.zeros(nodes)
        self.parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, corners: np.ndarray, weights: np.ndarray, ways: np.ndarray) -> None:
        """Ways [P, 3] (m) of pixels that show triangles with corners [P, 3] with weights [P, 3]."""
        self.parts.append((corners, weights, ways))
        self._count(corners, weights, ways, 1)

    def _count(self, corners: np.ndarray, weights: np.ndarray, ways: np.ndarray, sign: int) -> None:
        at, shares, nodes = corners.ravel(), sign * weights.astype(np.float64), len(self.weight)
        self.weight += np.bincount(at, shares.ravel(), nodes)
        for k in range(3):
            self.way[:, k] += np.bincount(at, (shares * ways[:, k, None]).ravel(), nodes)

    def mean(self) -> np.ndarray:
        """[N, 3] metres; 0 where nothing is asked."""
        return self.way / np.maximum(self.weight, 1e-12)[:, None]

    def agreed(self) -> "Sums":
        """The same without pixels that ask for another way than those around them: they show another layer."""
        kept, mean = Sums(len(self.weight)), self.mean().astype(np.float32)
        kept.way[:], kept.weight[:] = self.way, self.weight
        for corners, weights, ways in self.parts:
            off = length(ways - spread(corners, weights, mean))
            odd = np.flatnonzero(off >= max(ODD, ODDER * float(np.median(off)))) if len(off) else np.arange(0)
            kept._count(corners[odd], weights[odd], ways[odd], -1)
        nothing = kept.weight < LEAST
        kept.way[nothing], kept.weight[nothing] = 0.0, 0.0
        return kept
