"""What the kernels share: Warp set up quietly, vectors with one candidate per lane, and launches on all cores.

A kernel's thread works on a group of candidates, one in each lane of a vector, so that every operation of the CPU serves
a full register; on a GPU a group is one candidate. Arrays of candidates stay [B, ...] outside: a thread gathers its
group when it begins and scatters it when it ends.
"""

import atexit
import functools
import logging
import os
import platform
import shutil
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import torch
import warp as wp
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from piegraph_cli.errors import MissingError
from piegraph_cli.process import quiet_native
from piegraph_cli.weights import cache_folder

log = logging.getLogger("piegraph")

WIDE = wp.config.cpu_compiler_flags + (" -mprefer-vector-width=512" if platform.machine() == "x86_64" else "")
"""Whole registers where the CPU has them: by itself the compiler takes half of AVX-512 on Intel's, and kernels take half
as long again."""

FLAGS = "-ffp-contract=fast -freciprocal-math -fapprox-func -mrecip=all"
"""Fused multiply-adds, and quotients and roots from the CPU's estimates and a Newton step, within a few last bits. Sums
keep their order: the network's power of two is lost otherwise."""

KERNEL = {
    "module": "unique",
    "enable_backward": False,
    "module_options": {"max_unroll": 0, "cpu_compiler_flags": f"{WIDE} {FLAGS}"},
}
"""Options of every kernel: a module each, so that only those in use are compiled."""


@functools.cache
def start_warp() -> None:
    """Start Warp without a word, compiled kernels kept in the user's cache."""
    wp.config.log_level = wp.LOG_ERROR
    wp.config.kernel_cache_dir = str(_kernel_folder())
    with quiet_native():  # no CUDA driver is no news
        wp.init()


def _kernel_folder() -> Path:
    """A writable folder for compiled kernels: the user's cache, else a temporary one that ends with the process."""
    try:
        folder = cache_folder() / "kernels"
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError) as error:  # RuntimeError: no home
        log.warning("no writable cache (%s): kernels are compiled anew, some seconds; set XDG_CACHE_HOME", error)
        temporary = tempfile.mkdtemp(prefix="piegraph-kernels-")
        atexit.register(shutil.rmtree, temporary, ignore_errors=True)
        return Path(temporary)


@functools.cache
def cores() -> int:
    """Cores that kernels use: what the process may, or OMP_NUM_THREADS, which limits the workers of `--jobs`."""
    given = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]  # a list is for nested levels
    return int(given) if given.isdigit() and int(given) else joblib.cpu_count()


@functools.cache
def _workers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cores(), thread_name_prefix="kernels")


def _load(kernel: wp.Kernel) -> None:
    """Compile a kernel, or load it compiled, as a launch on the CPU would; before that, so that threads do not do it twice.

    Raises `MissingError` naming the cache, where Warp raises what it will: for a full disk, or files cut short.
    """
    try:
        kernel.module.load("cpu", block_dim=1)
    except Exception as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        hint = "delete that folder, and see that its disk has space"
        raise MissingError(
            f"kernels cannot be compiled or loaded: {reason}", wp.config.kernel_cache_dir, hint
        ) from error


@dataclass(frozen=True)
class Launch:
    """How a batch of candidates is spread over a device, and the scratch memory that it needs there."""

    batch: int
    device: torch.device
    cpu_lanes: int

    @property
    def lanes(self) -> int:
        """Candidates in a group."""
        return self.cpu_lanes if self.device.type == "cpu" else 1

    @property
    def groups(self) -> int:
        """Threads of the kernel."""
        return -(-self.batch // self.lanes)

    @property
    def slots(self) -> int:
        """Groups worked on at a time, each with scratch memory of its own: one per core of a CPU, all on a GPU."""
        return min(cores(), self.groups) if self.device.type == "cpu" else self.groups

    def scratch(self, *shape: int) -> wp.array:
        """Vectors [slots, *shape], not initialised; those of neighbouring slots lie side by side on a GPU."""
        kind = vector(self.lanes)
        if self.device.type == "cpu":
            return wp.empty((self.slots, *shape), dtype=kind, device="cpu")
        return wp.empty((*shape, self.slots), dtype=kind, device=str(self.device)).transpose(
            (len(shape), *range(len(shape)))
        )

    def run(self, kernel: wp.Kernel, arguments: Sequence[Any]) -> None:
        """Run `kernel(first group, first slot, slots per group, *arguments)` over all groups."""
        device = wp.get_device(str(self.device))
        if device.is_cuda:
            stream = wp.stream_from_torch(torch.cuda.current_stream(self.device))
            wp.launch(kernel, self.groups, [0, 0, 1, *arguments], device=device, stream=stream)
            return
        _load(kernel)
        edges = [w * self.groups // self.slots for w in range(self.slots + 1)]
        commands = [  # the work of Python is done first: threads that wait for each other there lose milliseconds
            wp.launch(kernel, edges[w + 1] - edges[w], [edges[w], w, 0, *arguments], device=device, record_cmd=True)
            for w in range(self.slots)
        ]
        if self.slots == 1:
            commands[0].launch()
        else:
            list(_workers().map(wp.Launch.launch, commands))


@functools.cache
def vector(lanes: int) -> type:
    """The type of `lanes` floats."""
    start_warp()
    return wp.types.vector(lanes, wp.float32)


@functools.cache
def accessors(lanes: int) -> tuple[Any, Any]:
    """Kernel functions that load a vector of [B, rows, columns] for a group, and store one.

    Lanes beyond the last candidate work on its copies, and are not stored.
    """
    vec = vector(lanes)

    @wp.func
    def load(a: wp.array3d(dtype=wp.float32), group: int, row: int, column: int) -> vec:
        r = vec()
        for k in range(lanes):
            r[k] = a[wp.min(group * lanes + k, a.shape[0] - 1), row, column]
        return r

    @wp.func
    def store(a: wp.array3d(dtype=wp.float32), group: int, row: int, column: int, value: vec):
        for k in range(lanes):
            if group * lanes + k < a.shape[0]:
                a[group * lanes + k, row, column] = value[k]

    return load, store


def bandwidth_order(pairs: np.ndarray, particles: int) -> np.ndarray:
    """An order [N] of particles in which those joined by pairs [S, 2] are near, so that caches hold what is worked on."""
    ones = np.ones(len(pairs))
    graph = coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(particles, particles)).tocsr()
    return reverse_cuthill_mckee(graph + graph.T, symmetric_mode=True).astype(np.int64)
