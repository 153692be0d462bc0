"""A hand with a simple mesh, for the tests of hands and recordings."""

import json
import struct

import numpy as np
import pytest

from piegraph_cli.environments import hand as hands


@pytest.fixture(scope="session")
def glb(tmp_path_factory):
    """A hand with the real joint names whose mesh is a small triangle around every joint."""
    names = ["wrist", *(name for chain in hands.CHAINS.values() for name in chain)]
    joints = np.zeros((len(names), 3))
    for row, (finger, chain) in enumerate(hands.CHAINS.items()):
        for k, name in enumerate(chain):
            side = -0.02 * (2 - row)
            joints[names.index(name)] = (
                [0.0, -0.03 - 0.03 * k, side] if finger != "thumb" else [-0.01, -0.03 - 0.02 * k, -0.05]
            )
    offsets = np.array([[0.006, 0, 0], [-0.004, 0, 0.006], [-0.004, 0, -0.006]])
    points = (joints[:, None] + offsets).reshape(-1, 3).astype(np.float32)
    owners = np.zeros((len(points), 4), np.uint8)
    owners[:, 0] = np.repeat(np.arange(len(names)), 3)
    shares = np.tile(np.float32([1, 0, 0, 0]), (len(points), 1))
    triangles = np.arange(len(points), dtype=np.uint16)
    blobs = [(points, 5126, "VEC3"), (owners, 5121, "VEC4"), (shares, 5126, "VEC4"), (triangles, 5123, "SCALAR")]
    views, accessors, body = [], [], b""
    for blob, kind, shape in blobs:
        accessors.append({"bufferView": len(views), "componentType": kind, "count": len(blob), "type": shape})
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": blob.nbytes})
        body += blob.tobytes() + b"\0" * (-blob.nbytes % 4)
    gltf = {
        "nodes": [{"name": n, "translation": j.tolist()} for n, j in zip(names, joints, strict=True)],
        "skins": [{"joints": list(range(len(names)))}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}, "indices": 3}]}],
        "accessors": accessors,
        "bufferViews": views,
    }
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body)) + struct.pack("<I4s", len(text), b"JSON")
    path = tmp_path_factory.mktemp("hand") / "right.glb"
    path.write_bytes(header + text + struct.pack("<I4s", len(body), b"BIN\0") + body)
    return path


@pytest.fixture(scope="session")
def hand(glb):
    return hands.load_hand(glb)
