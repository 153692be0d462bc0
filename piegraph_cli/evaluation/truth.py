"""Scores of a simulated recording's perception and tracking against what was true. Only scoring reads the truth."""

import numpy as np

MILLIMETRE = 1000.0


def carry_with_mesh(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, start: int) -> np.ndarray:
    """Where material points [N, 3] at frame `start` are in every frame: [F, N, 3] (m).

    vertices [F, V, 3] (m) is the true surface in motion, triangles [T, 3]. Each point keeps its barycentric place on the
    nearest triangle and its offset along that triangle's frame.
    """
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.ascontiguousarray(vertices[start], np.float32), triangles.astype(np.uint32))
    found = scene.compute_closest_points(np.ascontiguousarray(points, np.float32))
    corners = triangles[found["primitive_ids"].numpy().astype(np.int64)]
    u, v = found["primitive_uvs"].numpy().T.astype(np.float64)
    weights = np.stack([1 - u - v, u, v], -1)
    foot = np.einsum("nk,fnkc->fnc", weights, vertices[:, corners].astype(np.float64))
    axes = _triangle_frames(vertices[:, corners].astype(np.float64))
    local = np.einsum("nic,nc->ni", axes[start], points - foot[start])
    return foot + np.einsum("fnic,ni->fnc", axes, local)


def _triangle_frames(corners: np.ndarray) -> np.ndarray:
    """Orthonormal frames [F, N, 3, 3], axes in rows, of triangles [F, N, 3, 3]."""
    first = corners[:, :, 1] - corners[:, :, 0]
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    normal = np.cross(first, corners[:, :, 2] - corners[:, :, 0])
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.stack([first, np.cross(normal, first), normal], -2)


def surface_distance(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distances [P] (m) of points [P, 3] to a surface: vertices [V, 3], triangles [T, 3]."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.ascontiguousarray(vertices, np.float32), triangles.astype(np.uint32))
    return scene.compute_distance(np.ascontiguousarray(points, np.float32)).numpy()


def mask_iou(found: np.ndarray, true: np.ndarray) -> float:
    """Intersection over union of two masks [H, W]; 1 where both are empty."""
    union = int(np.logical_or(found, true).sum())
    return int(np.logical_and(found, true).sum()) / union if union else 1.0


def hand_scores(seen: np.ndarray, end_effector: np.ndarray, true_end_effector: np.ndarray) -> dict[str, np.ndarray]:
    """Share of frames with a hand in which one camera or more found it, and planar end-effector errors (mm).

    seen [F, C]; end_effector, true_end_effector [F, 3] (m, NaN where unknown or absent).
    """
    present = np.isfinite(true_end_effector).all(-1)
    error = np.linalg.norm(end_effector[:, :2] - true_end_effector[:, :2], axis=-1) * MILLIMETRE
    return {
        "frames with the hand found": np.asarray(seen.any(1))[present].astype(float),
        "end-effector error [mm]": error[present & np.isfinite(error)],
    }


def track_errors(positions: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Mean particle error per frame [F] (mm) of positions [F, N, 3] (m)."""
    return np.linalg.norm(positions - true, axis=-1).mean(-1) * MILLIMETRE
