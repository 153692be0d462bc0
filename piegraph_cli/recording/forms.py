"""What the fields of cameras.json look like, for messages about such as were written otherwise."""

from typing import Any

_POSE = "give 4 rows of 4 numbers, the last one 0, 0, 0, 1; of a quaternion or a rotation vector make the matrix first"
_LENS = "give 3 rows of 3 numbers: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
FORMS: dict[Any, str] = {"K": _LENS, "depth_K": _LENS, "T_world_camera": _POSE, "T_color_depth": _POSE} | {
    "T_world_robot": _POSE,
    "distortion": "give one list of 4, 5, 8, 12 or 14 numbers in OpenCV's order",
    "cameras": "give an object that has each camera under its name",
}
"""How to write what a field of cameras.json holds."""


def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON. Raises `KeyError` for a name that is there twice, of which readers take the last."""
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise KeyError(name)
        found[name] = value
    return found
