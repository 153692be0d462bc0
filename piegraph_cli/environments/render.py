"""Colour, depth and labels of a scene by ray casting (Embree): Lambert shading, lamps with shadows, a wooden table."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from piegraph_cli.environments import import_extra
from piegraph_cli.recording.camera import Camera

FLOOR, TABLE, OBJECT, HAND, OTHER = 0, 1, 2, 3, 4
_LAMPS = ((np.array([0.9, 0.55, 1.5]), 0.62), (np.array([-0.8, -0.1, 1.7]), 0.40))
_LAMP_RADIUS = 0.05
_AMBIENT = 0.36
_TABLE_HALF, _TABLE_THICK, _FLOOR_Z = 0.62, 0.03, -0.74
_QUAD = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))
_WOOD_SIZE = 1024
_LEVELS, _CELLS = ((0.0, _TABLE_HALF), (_FLOOR_Z, 8.0)), 256
"""Height and half width (m) of the planes on which shadows fall, and cells of their grids to either side."""
_NEAR = 2
"""A pixel farther from every part sees none of it, wherever in it one looks."""


@dataclass(frozen=True)
class Print:
    """A pattern on a surface."""

    coordinates: np.ndarray
    """[V, 3] column and row of each vertex in `image`, and the contrast of the pattern there."""
    image: np.ndarray
    """[rows, columns, 3] linear RGB."""
    base: np.ndarray
    """[3] linear RGB where the contrast is 0."""

    def albedo(self, coordinates: np.ndarray) -> np.ndarray:
        """Linear RGB [P, 3] at coordinates [P, 3]."""
        rows, columns = self.image.shape[:2]
        column, row = np.rint(coordinates[:, :2]).astype(int).clip(0, [columns - 1, rows - 1]).T
        return self.base + coordinates[:, 2:] * (self.image[row, column] - self.base)


@dataclass(frozen=True)
class Part:
    """One surface of the scene."""

    vertices: np.ndarray
    """[V, 3] metres, world."""
    triangles: np.ndarray
    """[T, 3]."""
    label: int
    colors: np.ndarray
    """[V, 3] linear RGB in 0..1 per vertex, or [1, 3] for the whole surface."""
    smooth: bool = False
    """Shade by normals interpolated over the surface instead of one per triangle."""
    print: Print | None = None
    """What is seen in place of the colours."""
    normals: np.ndarray = field(init=False)

    def __post_init__(self):
        corners = self.vertices[self.triangles]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        summed = np.zeros_like(self.vertices)
        for k in range(3):
            np.add.at(summed, self.triangles[:, k], flat)
        object.__setattr__(self, "normals", summed / np.maximum(np.linalg.norm(summed, axis=1, keepdims=True), 1e-12))


@dataclass(frozen=True)
class View:
    """What one camera would see without noise."""

    color: np.ndarray
    """[H, W, 3] RGB in 0..1, gamma encoded."""
    depth: np.ndarray
    """[H, W] metres along the optical axis, inf where nothing is."""
    label: np.ndarray
    """[H, W] `Part.label` of what is seen, -1 for nothing."""
    slope: np.ndarray
    """[H, W] cosine between the viewing ray and the surface normal."""


@dataclass(frozen=True)
class _Shaded:
    """What rays hit, and how it is lit."""

    points: np.ndarray
    """[P, 3] metres."""
    normals: np.ndarray
    """[P, 3] towards the camera."""
    albedo: np.ndarray
    """[P, 3] linear RGB."""
    ambient: np.ndarray
    """[P] light from everywhere."""
    direct: np.ndarray
    """[2, P] light from each lamp, were there no shadows."""
    lit: np.ndarray
    """[2, P] bool: what each lamp reaches."""
    color: np.ndarray
    """[P, 3] linear RGB as it is seen."""


class Solid:
    """A closed surface, vertices [V, 3] (m) and triangles [T, 3] facing outwards, that knows what lies inside it."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray):
        self._scene, self._mesh = _scene([(vertices, triangles)])
        a, b, c = (vertices[triangles[:, k], :2] for k in range(3))
        self._faces_up = (b - a)[:, 0] * (c - a)[:, 1] > (b - a)[:, 1] * (c - a)[:, 0]

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Which points [P, 3] (m) lie inside, bool [P]: those from where the way up first leaves the surface."""
        up = np.tile(np.array([0, 0, 1], np.float32), (len(points), 1))
        hit = _cast(self._scene, points.astype(np.float32), up)
        return (hit["geomID"] >= 0) & self._faces_up[hit["primID"]]


class Renderer:
    """Casts the rays of fixed cameras into changing scenes; the table and the floor are always there, and shaded once."""

    def __init__(self, cameras: list[Camera]):
        self.cameras = cameras
        self._rays = [_pixel_rays(camera, (0.0, 0.0)) for camera in cameras]
        self._quad_rays = [np.stack([_pixel_rays(camera, offset) for offset in _QUAD]) for camera in cameras]
        self._wood = wood_texture()
        self._room: dict[tuple[int, int], tuple[_Shaded, np.ndarray]] = {}
        """What is seen where no part is near, and on which cells that lies, by camera and sample."""

    def render(self, parts: list[Part], cameras: Sequence[int] | None = None) -> list[View]:
        """One view per camera (or of those that are named) of the table with `parts` on it."""
        surfaces = [*_room(), *parts]
        scene, meshes = _scene([(s.vertices, s.triangles) for s in surfaces])
        shadows = [_shadows(parts, quad) for quad in range(len(_QUAD))]
        chosen = range(len(self.cameras)) if cameras is None else cameras
        views = [self._view(scene, surfaces, k, shadows) for k in chosen]
        del meshes
        return views

    def depths(self, parts: list[Part]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Depth and slope of each camera's view, as `View` has them."""
        surfaces = [*_room(), *parts]
        scene, meshes = _scene([(s.vertices, s.triangles) for s in surfaces])
        seen = [self._surface(scene, surfaces, k)[:2] for k in range(len(self.cameras))]
        del meshes
        return seen

    def _surface(self, scene, surfaces: list[Part], k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depth, slope and label [H, W] of what a camera sees."""
        camera = self.cameras[k]
        shape = (camera.height, camera.width)
        hit = _cast(scene, camera.T_world_camera[:3, 3].astype(np.float32), self._rays[k])
        label = np.array([-1] + [s.label for s in surfaces])[hit["geomID"] + 1].reshape(shape)
        slope = np.abs(np.einsum("pc,pc->p", _unit(hit["Ng"]), _unit(self._rays[k]))).reshape(shape)
        return np.where(hit["geomID"] < 0, np.inf, hit["tfar"]).reshape(shape), slope, label

    def _view(self, scene, surfaces: list[Part], k: int, shadows: list[list[np.ndarray]]) -> View:
        depth, slope, label = self._surface(scene, surfaces, k)
        near = cv2.dilate((label > TABLE).astype(np.uint8), np.ones((2 * _NEAR + 1,) * 2, np.uint8)).ravel() > 0
        samples = [self._sample(scene, surfaces, k, quad, near, shadows) for quad in range(len(_QUAD))]
        color = np.clip(np.mean(samples, 0), 0, 1) ** (1 / 2.2)
        return View(color.reshape(*depth.shape, 3).astype(np.float32), depth, label, slope)

    def _sample(
        self, scene, surfaces: list[Part], k: int, quad: int, near: np.ndarray, shadows: list[list[np.ndarray]]
    ) -> np.ndarray:
        """Linear RGB [P, 3] of one ray per pixel; those that are not `near` [P] any part hit the room as always."""
        if (k, quad) not in self._room:
            shaded = self._shade_room(k, quad)
            self._room[k, quad] = shaded, _cells(shaded.points)
        room, cells = self._room[k, quad]
        color = room.color.copy()
        lit, darker = room.lit.copy(), np.zeros(len(color), bool)
        for number, place in enumerate(_lamps(quad)):
            there = np.flatnonzero(room.lit[number] & ~near & shadows[quad][number][cells])
            lit[number, there] = _lit(scene, room.points[there], room.normals[there], place)
            darker |= room.lit[number] & ~lit[number]
        dark = np.flatnonzero(darker)
        light = room.ambient[dark] + room.direct[0, dark] * lit[0, dark] + room.direct[1, dark] * lit[1, dark]
        color[dark] = room.albedo[dark] * light[:, None]
        fresh = np.flatnonzero(near)
        if len(fresh):
            rays = self._quad_rays[k][quad][fresh]
            color[fresh] = self._shade(scene, surfaces, self._origin(k), rays, quad).color
        return color

    def _origin(self, k: int) -> np.ndarray:
        return self.cameras[k].T_world_camera[:3, 3].astype(np.float32)

    def _shade_room(self, k: int, quad: int) -> "_Shaded":
        surfaces = _room()
        scene, meshes = _scene([(s.vertices, s.triangles) for s in surfaces])
        shaded = self._shade(scene, surfaces, self._origin(k), self._quad_rays[k][quad], quad)
        del meshes
        return shaded

    def _shade(self, scene, surfaces: list[Part], origin: np.ndarray, rays: np.ndarray, quad: int) -> "_Shaded":
        """What rays [P, 3] hit and how it is lit; `quad` moves the lamps, so that several samples give soft shadows."""
        hit = _cast(scene, origin, rays)
        points = origin + rays * hit["tfar"][:, None]
        normals, albedo = self._material(surfaces, hit, points)
        normals *= np.where(np.einsum("pc,pc->p", normals, rays)[:, None] > 0, np.float32(-1), np.float32(1))
        ambient = _AMBIENT * (0.7 + 0.3 * normals[:, 2])
        direct, lit = [], []
        for place, (_, power) in zip(_lamps(quad), _LAMPS, strict=True):
            direct.append(power * np.maximum(np.einsum("pc,pc->p", normals, _unit(place - points)), 0))
            lit.append(_lit(scene, points, normals, place))
        color = albedo * (ambient + direct[0] * lit[0] + direct[1] * lit[1])[:, None]
        color[hit["geomID"] < 0] = 0
        return _Shaded(points, normals, albedo, ambient, np.array(direct), np.array(lit), color)

    def _material(self, surfaces: list[Part], hit: dict, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit normals [P, 3] and linear RGB [P, 3] of what each ray hit."""
        normals, albedo = _unit(hit["Ng"]), np.zeros_like(points)
        for number, surface in enumerate(surfaces):
            here = np.flatnonzero(hit["geomID"] == number)
            if surface.label == TABLE:
                albedo[here] = self._grain(points[here])
            elif surface.print is not None:
                albedo[here] = surface.print.albedo(_interpolate(surface.print.coordinates, surface, hit, here))
            elif len(surface.colors) == 1:
                albedo[here] = surface.colors
            else:
                albedo[here] = _interpolate(surface.colors, surface, hit, here)
            if surface.smooth:
                normals[here] = _unit(_interpolate(surface.normals, surface, hit, here))
        return normals, albedo

    def _grain(self, points: np.ndarray) -> np.ndarray:
        column, row = (
            ((points[:, :2] + _TABLE_HALF) / (2 * _TABLE_HALF) * (_WOOD_SIZE - 1))
            .clip(0, _WOOD_SIZE - 1)
            .round()
            .astype(int)
            .T
        )
        return self._wood[row, column]


def _lamps(quad: int) -> list[np.ndarray]:
    """Where the lamps are [3] (m) for one of the samples of a pixel."""
    aside = np.array([*_QUAD[quad], 0.0])
    return [(position + _LAMP_RADIUS * 4 * aside).astype(np.float32) for position, _ in _LAMPS]


def _lit(scene, points: np.ndarray, normals: np.ndarray, lamp: np.ndarray) -> np.ndarray:
    """Which points [P, 3] the lamp at [3] reaches, bool [P]."""
    reach = np.ones(len(points), np.float32)
    return scene.run(points + 5e-4 * normals, lamp - points, dists=reach, query="OCCLUDED") != 0


def _shadows(parts: list[Part], quad: int) -> list[np.ndarray]:
    """Where on table and floor the parts may keep each lamp's light away: cells bool, as `_cells` counts them."""
    found = []
    for lamp in _lamps(quad):
        masks = []
        for level, half in _LEVELS:
            mask = np.zeros((_CELLS, _CELLS), np.uint8)
            for part in parts:
                below = (lamp[2] - level) / (lamp[2] - part.vertices[:, 2:])
                shadow = lamp[:2] + (part.vertices[:, :2] - lamp[:2]) * below
                hull = cv2.convexHull(_on_grid(shadow, half))
                cv2.fillConvexPoly(mask, hull, 1)
            masks.append(cv2.dilate(mask, np.ones((5, 5), np.uint8)))
        found.append(np.concatenate([*(mask.ravel() for mask in masks), [0]]) > 0)
    return found


def _cells(points: np.ndarray) -> np.ndarray:
    """The cell of table or floor in which points [P, 3] of the room lie; the last one is that of all others."""
    cells = np.full(len(points), len(_LEVELS) * _CELLS**2, np.int32)
    for number, (level, half) in enumerate(_LEVELS):
        at = np.flatnonzero(np.abs(points[:, 2] - level) < 0.01)
        column, row = _on_grid(points[at, :2], half).clip(0, _CELLS - 1).T
        cells[at] = (number * _CELLS + row) * _CELLS + column
    return cells


def _on_grid(points: np.ndarray, half: float) -> np.ndarray:
    """Places [P, 2] (m) as columns and rows [P, 2] of a grid that is so wide to either side."""
    return np.rint((points + half) / (2 * half) * (_CELLS - 1)).astype(np.int32)


def _interpolate(values: np.ndarray, surface: Part, hit: dict, here: np.ndarray) -> np.ndarray:
    """Per-vertex values [V, 3] at the hits `here` of a surface, float32 [len(here), 3]."""
    corners = surface.triangles[hit["primID"][here]]
    u, v = hit["u"][here], hit["v"][here]
    weights = np.stack([1 - u - v, u, v], 1)
    return np.einsum("pk,pkc->pc", weights, values.astype(np.float32)[corners])


def _scene(surfaces: list[tuple[np.ndarray, np.ndarray]]) -> tuple:
    """Embree's scene of (vertices [V, 3], triangles [T, 3]), and its meshes, which must live as long as the scene."""
    mesh = import_extra("embreex.mesh_construction").TriangleMesh
    scene = import_extra("embreex.rtcore_scene").EmbreeScene()
    return scene, [mesh(scene, v.astype(np.float32), t.astype(np.int32)) for v, t in surfaces]


def _cast(scene, origin: np.ndarray, rays: np.ndarray) -> dict[str, np.ndarray]:
    return scene.run(np.ascontiguousarray(np.broadcast_to(origin, rays.shape)), rays, query="INTERSECT", output=True)


def _pixel_rays(camera: Camera, offset: tuple[float, float]) -> np.ndarray:
    """World-frame rays [H * W, 3] through the pixels (moved by `offset`), one metre deep: hit distance is depth."""
    column, row = np.meshgrid(np.arange(camera.width) + offset[0], np.arange(camera.height) + offset[1])
    rays = camera.rays(np.column_stack([column.ravel(), row.ravel()]))
    return np.ascontiguousarray(rays @ camera.T_world_camera[:3, :3].T, np.float32)


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.sqrt(np.einsum("pc,pc->p", vectors, vectors))
    return vectors / np.maximum(length, vectors.dtype.type(1e-12))[:, None]


def _room() -> list[Part]:
    def slab(half: float, z: float, label: int, color: tuple[float, float, float]) -> Part:
        corners = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])
        return Part(corners, np.array([[0, 1, 2], [0, 2, 3]]), label, np.array([color]))

    return [slab(15.0, _FLOOR_Z, FLOOR, (0.23, 0.24, 0.26)), slab(_TABLE_HALF, 0.0, TABLE, (1.0, 1.0, 1.0))]


def wood_texture(seed: int = 7) -> np.ndarray:
    """Linear RGB [S, S, 3] of a table top made of planks along x, each with its own tone and grain."""

    rng, size = np.random.default_rng(seed), _WOOD_SIZE
    row = np.mgrid[:size, :size][0].astype(np.float32)
    planks = 7
    plank = np.minimum((row / size * planks).astype(int), planks - 1)
    wander = 9 * _stretched_noise(rng, size // 24, size // 200)
    rings = np.sin((row + wander + 37 * plank) * (0.16 + 0.02 * (plank % 3)))
    fibre = _stretched_noise(rng, size, size // 50)
    tone = rng.uniform(0.86, 1.08, planks)[plank] * (1 + 0.07 * rings + 0.045 * fibre)
    seam = np.abs((row / size * planks) % 1 - 0.5) > 0.494
    tone = np.where(seam, 0.55 * tone, tone)
    return (np.array([0.47, 0.30, 0.165]) * tone[..., None]).astype(np.float32)


def _stretched_noise(rng: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    """Unit-variance noise [S, S] with that many independent values down and across."""
    import cv2

    noise = cv2.resize(
        rng.standard_normal((rows, columns), np.float32), (_WOOD_SIZE,) * 2, interpolation=cv2.INTER_CUBIC
    )
    return noise / noise.std()
