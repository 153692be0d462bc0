"""What this machine has of what piegraph needs, and how to mend what is missing."""

import importlib.metadata
import shutil
import subprocess
import sys
from dataclasses import dataclass

from piegraph_cli.weights import WEIGHTS, cache_folder

REQUIRED = ("torch", "open3d", "mediapipe", "cv2", "segment_anything", "h5py", "scipy", "matplotlib", "warp", "jinja2")
OPTIONAL = {
    **dict.fromkeys(("pymunk", "mujoco", "gymnasium", "trimesh", "embreex", "skimage"), "sim"),
    "rosbags": "ros",
    "viser": "view",
    "pyrealsense2": "realsense",
    "ray": "cluster",
}
LIBRARIES_HINT = "on Debian or Ubuntu: sudo apt-get install libgl1 libegl1 libgles2 libx11-6 libudev1 libusb-1.0-0"


@dataclass(frozen=True)
class Check:
    """One thing looked at."""

    name: str
    ok: bool
    needed: bool
    detail: str


def check_machine() -> list[Check]:
    """Packages by importing them in a process of their own (a missing system library may end it), weights, GPU, disk."""
    checks = [Check("python", (3, 10) <= sys.version_info[:2] < (3, 13), True, sys.version.split()[0])]
    checks += [_import(name, True, LIBRARIES_HINT) for name in REQUIRED]
    checks += [_import(name, False, f"pip install 'piegraph[{extra}]'") for name, extra in OPTIONAL.items()]
    for name, weights in WEIGHTS.items():
        path = cache_folder() / weights.file
        detail = str(path) if path.is_file() else f"piegraph doctor --fetch {name}"
        checks.append(Check(name, path.is_file(), name == "hand-landmarker", detail))
    gpu = _run("import torch; print(torch.cuda.get_device_name(0) if torch.cuda.is_available() else '')")
    checks.append(Check("cuda", bool(gpu.strip()), False, gpu.strip() or "none: the CPU is used"))
    free = shutil.disk_usage(".").free / 1e9
    checks.append(Check("disk", free > 1, True, f"{free:.0f} GB free"))
    return checks


def _import(module: str, needed: bool, hint: str) -> Check:
    if module == "segment_anything":
        code = "from piegraph_cli.perception.sam_models import import_segment_anything as f; f(); print('ok')"
    else:
        code = f"import {module}; print('ok')"
    output = _run(code)
    if output.strip().endswith("ok"):
        return Check(module, True, needed, _version(module))
    reason = output.strip().splitlines()[-1] if output.strip() else "import ended the process"
    return Check(module, False, needed, f"{reason}; {hint}")


def _version(module: str) -> str:
    names = importlib.metadata.packages_distributions().get(module, [])
    return f"{names[0]} {importlib.metadata.version(names[0])}" if names else ""


def _run(code: str) -> str:
    try:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    except subprocess.TimeoutExpired:
        return "took more than two minutes"
    return done.stdout if done.returncode == 0 else done.stderr
