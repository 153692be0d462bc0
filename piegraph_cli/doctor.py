"""What this machine has of what piegraph needs, and how to mend what is missing."""

import functools
import importlib.metadata
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from piegraph_cli.weights import WEIGHTS, cache_folder

NEEDED = ("torch", "warp", "segment_anything", "open3d", "mediapipe", "cv2", "h5py", "scipy", "matplotlib", "jinja2")
OPTIONAL = {
    **dict.fromkeys(("pymunk", "mujoco", "gymnasium", "trimesh", "embreex", "skimage"), "sim"),
    "rosbags": "ros",
    "viser": "view",
    "pyrealsense2": "realsense",
    "ray": "cluster",
}
LIBRARIES_HINT = "on Debian or Ubuntu: sudo apt-get install libgl1 libegl1 libgles2 libx11-6 libudev1 libusb-1.0-0"
WITH_TORCH = 3
"""The first of those that are needed import PyTorch, and share a process; it takes about as long as all others in one."""
PATIENCE = 120.0
"""Seconds for the packages of one process."""

IMPORT = """
import importlib, sys
for name in sys.argv[1:]:
    try:
        if name == "cuda":
            import torch
            said = torch.cuda.get_device_name(0) if torch.cuda.is_available() else ""
        elif name == "segment_anything":
            from piegraph_cli.perception.sam_models import import_segment_anything
            said = import_segment_anything().__name__
        else:
            said = importlib.import_module(name).__name__
        print("ok", name, said, flush=True)
    except Exception as error:
        print("failed", name, f"{type(error).__name__}: {error}".splitlines()[0], flush=True)
"""


@dataclass(frozen=True)
class Check:
    """One thing looked at."""

    name: str
    ok: bool
    needed: bool
    detail: str


def check_machine() -> list[Check]:
    """What is needed, then what is optional: Python, packages, weights, GPU, disk.

    Packages are imported, in processes of their own: a missing system library may end these.
    """
    first, rest = [*NEEDED[:WITH_TORCH], "cuda"], [*NEEDED[WITH_TORCH:], *OPTIONAL]
    with ThreadPoolExecutor(2) as pool:
        imported = {name: found for some in pool.map(_import, (first, rest)) for name, found in some.items()}
    free = shutil.disk_usage(".").free / 1e9
    checks = [
        Check("python", (3, 10) <= sys.version_info[:2] < (3, 13), True, sys.version.split()[0]),
        Check("disk", free > 1, True, f"{free:.0f} GB free"),
        *(_package(name, imported[name], True, LIBRARIES_HINT) for name in NEEDED),
        *(_weights(name) for name in WEIGHTS),
        *(_package(name, imported[name], False, f"pip install 'piegraph[{of}]'") for name, of in OPTIONAL.items()),
    ]
    ok, gpu = imported["cuda"]
    checks.append(Check("cuda", ok and bool(gpu), False, gpu if ok and gpu else "none: the CPU is used"))
    return sorted(checks, key=lambda check: not check.needed)


def _weights(name: str) -> Check:
    path = cache_folder() / WEIGHTS[name].file
    detail = str(path) if path.is_file() else f"piegraph doctor --fetch {name}"
    return Check(name, path.is_file(), name == "hand-landmarker", detail)


def _package(name: str, found: tuple[bool, str], needed: bool, hint: str) -> Check:
    ok, said = found
    return Check(name, ok, needed, _version(name) if ok else f"{said}; {hint}")


def _version(module: str) -> str:
    names = _distributions().get(module, [])
    return f"{names[0]} {importlib.metadata.version(names[0])}" if names else ""


@functools.cache
def _distributions() -> Mapping[str, list[str]]:
    return importlib.metadata.packages_distributions()


def _import(names: Sequence[str]) -> dict[str, tuple[bool, str]]:
    """By name, whether it can be imported, and what was said. Where one ends the process, another goes on after it."""
    found: dict[str, tuple[bool, str]] = {}
    while left := [name for name in names if name not in found]:
        for line in _run(left):
            word, name, text = [*line.split(" ", 2), "", ""][:3]
            if word in ("ok", "failed") and name in left:
                found[name] = word == "ok", text
        if still := [name for name in left if name not in found]:
            found[still[0]] = False, "importing it ended the process"
    return found


def _run(names: Sequence[str]) -> list[str]:
    """What a process that imports these says, as far as it comes."""
    command = [sys.executable, "-c", IMPORT, *names]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        return process.communicate(timeout=PATIENCE)[0].splitlines()
    except subprocess.TimeoutExpired:
        process.kill()
        return process.communicate()[0].splitlines()
