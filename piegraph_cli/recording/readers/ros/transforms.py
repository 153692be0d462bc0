"""Transforms between named frames, as `tf` publishes them."""

from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from piegraph_cli.errors import DataError


class Transforms:
    """A forest of frames: the pose of each in its parent, constant or over time."""

    def __init__(self, where: str):
        self.where = where
        self._edges: dict[str, tuple[str, list[float], list[np.ndarray]]] = {}

    def add(self, parent: str, child: str, time: float, pose: np.ndarray) -> None:
        """Add what a message says: the pose [4, 4] (m) of `child` in `parent` at `time` (s)."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if not np.isfinite(pose).all() or not np.isfinite(time):
            raise DataError(f"tf of {child} in {parent} is not finite at {time:.3f} s", self.where, "repair the bag")
        before, times, poses = self._edges.get(child, (parent, [], []))
        if before == parent:
            times.append(time)
            poses.append(pose)
            self._edges[child] = (parent, times, poses)

    def merged(self, others: Iterable["Transforms"]) -> "Transforms":
        """These and those of other bags of the same recording; where both have a frame, these count."""
        found = Transforms(self.where)
        for part in (*reversed(list(others)), self):
            found._edges |= part._edges
        return found

    @property
    def frames(self) -> list[str]:
        """All frames by name."""
        return sorted({*self._edges, *(parent for parent, _, _ in self._edges.values())})

    def times(self, base: str, frame: str) -> np.ndarray:
        """Times [T] (s, rising) at which `frame` is known to move in `base`: those of the edge that moves most often."""
        edges = set(self._up(frame)) ^ set(self._up(base))
        return np.unique(max((self._edges[e][1] for e in edges if e in self._edges), key=len, default=[]))

    def poses(self, base: str, frame: str, times: np.ndarray) -> np.ndarray | None:
        """The pose [T, 4, 4] of `frame` in `base` at `times` (s); None where nothing joins them."""
        base, frame = base.lstrip("/"), frame.lstrip("/")
        up, down = self._up(frame), self._up(base)
        if up[-1] != down[-1]:
            return None
        return np.linalg.inv(self._in_root(down, times)) @ self._in_root(up, times)

    def _up(self, frame: str) -> list[str]:
        """A frame and those above it, to the root."""
        path = [frame.lstrip("/")]
        while path[-1] in self._edges:
            parent = self._edges[path[-1]][0]
            if parent in path:
                raise DataError(f"tf goes in a circle at frame {parent}", self.where, "repair what publishes tf")
            path.append(parent)
        return path

    def _in_root(self, path: list[str], times: np.ndarray) -> np.ndarray:
        pose = np.broadcast_to(np.eye(4), (len(times), 4, 4))
        for frame in path[:-1]:
            pose = _at(*self._edges[frame][1:], times) @ pose
        return pose


def _at(stamps: list[float], poses: list[np.ndarray], times: np.ndarray) -> np.ndarray:
    """Poses [T, 4, 4] at `times`, between those of rising stamps; the first and the last hold beyond the ends."""
    known, first = np.unique(stamps, return_index=True)
    found = np.array(poses)[first]
    if len(known) == 1:
        return np.broadcast_to(found[0], (len(times), 4, 4))
    inside = times.clip(known[0], known[-1])
    result = np.tile(np.eye(4), (len(times), 1, 1))
    result[:, :3, :3] = Slerp(known, Rotation.from_matrix(found[:, :3, :3]))(inside).as_matrix()
    result[:, :3, 3] = np.stack([np.interp(inside, known, axis) for axis in found[:, :3, 3].T], 1)
    return result


def pose_of(transform: object, where: str) -> np.ndarray:
    """The matrix [4, 4] of a message `geometry_msgs/Transform`. Raises `DataError` for what is no rotation."""
    q, t = transform.rotation, transform.translation  # type: ignore[attr-defined]
    quaternion = np.array([q.x, q.y, q.z, q.w], float)
    if not abs(float(np.linalg.norm(quaternion)) - 1) < 0.01:
        raise DataError(
            f"a transform has a quaternion {quaternion.round(3).tolist()} not of length 1", where, "repair it"
        )
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    pose[:3, 3] = t.x, t.y, t.z
    return pose
