"""Settings of the environment that let calls of a program fail, through the library that `shim.c` is compiled to."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

SOURCE = Path(__file__).with_suffix(".c")


def build(folder: Path) -> Path | None:
    """Compile the library into a folder; None where there is no compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or sys.platform != "linux":
        return None
    library = folder / "shim.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, SOURCE, "-ldl"], check=True)
    return library


def environment(library: Path, root: Path, calls: str, **settings: object) -> dict[str, str]:
    """For a process whose calls below `root` fail, or are noted; `settings` as `shim.c` has them."""
    given = {"root": root, "calls": calls} | settings
    return os.environ | {f"SHIM_{k.upper()}": str(v) for k, v in given.items()} | {"LD_PRELOAD": str(library)}
