"""Which part of a sheet each pixel of a camera shows, were the sheet in a given state; sums over such pixels per particle."""

from dataclasses import dataclass

import cv2
import numpy as np

from piegraph_cli.physics.sheet_images import Lens, Shot
from piegraph_cli.physics.sheet_kernel import Cloth
from piegraph_cli.physics.sheet_mesh import SheetMesh

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

    def depth(self, lens: Lens) -> np.ndarray:
        """[P] metres along the optical axis."""
        return (self.points - lens.origin) @ lens.camera.T_world_camera[:3, 2].astype(np.float32)


def faces_of(mesh: SheetMesh, x: np.ndarray, normals: np.ndarray, lens: Lens) -> np.ndarray:
    """The places [N, 3] float32 (m) of nodes x [N, 3], with normals [N, 3], on the face that is towards a camera."""
    side = np.sign(np.einsum("nk,nk->n", normals, lens.origin - x))
    return (x + mesh.half * side[:, None] * normals).astype(np.float32)


def shades_before(surface: Surface, old: Surface, shot: Shot, faces: np.ndarray) -> np.ndarray:
    """The shade [P] of each pixel's place on the sheet in the image before, NaN where another triangle hid it.

    `faces` [N, 3] (m) is where the nodes were in that image, `old` what it showed.
    """
    place = np.einsum("pk,pkc->pc", surface.weights, faces[surface.corners])
    projected = shot.lens.project(place)
    at = projected[:, :2]
    near = np.rint(at).astype(np.int32)
    column, row = near.T.clip(0, [[shot.grey.shape[1] - 1], [shot.grey.shape[0] - 1]])
    shown = (near == np.stack([column, row], 1)).all(1) & (shot.mask[row, column] > 0)
    same = old.owner[row, column]
    shown &= (same >= 0) & (np.abs(old.along[row, column] - projected[:, 2]) < LAYER)
    shades = cv2.remap(shot.grey, at[:, None, 0], at[:, None, 1], cv2.INTER_LINEAR)[:, 0].astype(np.float32)
    return np.where(shown, shades, np.nan)


def visible(cloth: Cloth, x: np.ndarray, normals: np.ndarray, lens: Lens) -> Surface:
    """What a camera sees of a sheet whose nodes are at x [N, 3] (m), with normals [N, 3]: the nearest layer at each pixel."""
    mesh, camera = cloth.mesh, lens.camera
    faces = faces_of(mesh, x, normals, lens)
    owner, along, weights = cloth.seen(lens.project(faces), camera.height, camera.width)
    pixels = np.argwhere(owner >= 0)
    triangle = owner[pixels[:, 0], pixels[:, 1]]
    a, b, c = (x[mesh.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    front = np.einsum("tk,tk->t", normal, lens.origin - a) > 0
    corners, share = mesh.triangles[triangle], weights[pixels[:, 0], pixels[:, 1]]
    points = np.einsum("pk,pkc->pc", share, faces[corners])
    return Surface(pixels, corners, share, points, normal[triangle].astype(np.float32), front[triangle], owner, along)


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
        at, share, nodes = corners.ravel(), sign * weights.ravel().astype(np.float64), len(self.weight)
        self.weight += np.bincount(at, share, nodes)
        for k in range(3):
            self.way[:, k] += np.bincount(at, share * np.repeat(ways[:, k], 3), nodes)

    def mean(self) -> np.ndarray:
        """[N, 3] metres; 0 where nothing is asked."""
        return self.way / np.maximum(self.weight, 1e-12)[:, None]

    def agreed(self) -> "Sums":
        """The same without pixels that ask for another way than those around them: they show another layer."""
        kept, mean = Sums(len(self.weight)), self.mean().astype(np.float32)
        kept.way[:], kept.weight[:] = self.way, self.weight
        for corners, weights, ways in self.parts:
            off = np.linalg.norm(ways - np.einsum("pk,pkc->pc", weights, mean[corners]), axis=1)
            odd = off >= max(ODD, ODDER * float(np.median(off))) if len(off) else off > 0
            kept._count(corners[odd], weights[odd], ways[odd], -1)
        nothing = kept.weight < LEAST
        kept.way[nothing], kept.weight[nothing] = 0.0, 0.0
        return kept
