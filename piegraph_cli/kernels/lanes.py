"""What the kernels share: Warp set up quietly, vectors with one candidate per lane, and launches on all cores.

On a CPU a thread works on a group of candidates, one in each lane of a vector, so that every operation serves a full
register. On a GPU a vector has one lane, and the threads of a block share the particles of one candidate. The formulas
are the same functions for both; what differs is the kernel that calls them. Arrays of candidates stay [B, ...] outside:
a kernel gathers a group when it begins with it and scatters it when it ends.
"""

import atexit
import functools
import itertools
import logging
import os
import platform
import shutil
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

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

Share = TypeVar("Share")
Part = TypeVar("Part")

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
"""Options of every kernel of a CPU: a module each, so that only those in use are compiled."""

BLOCK_KERNEL: dict[str, Any] = {
    "module": "unique",
    "enable_backward": False,
    "module_options": {"fast_math": True},
    "launch_bounds": (512, 2),
}
"""Those of a GPU: quotients and roots as it estimates them, and registers for two of the largest blocks."""

BLOCKS = 16
"""Candidates that each multiprocessor of a GPU has scratch memory for: as many as it can hold, in blocks of two warps."""

MOST_THREADS = 512
"""Of a GPU's block, so that its registers suffice."""


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
    except (OSError, MissingError) as error:
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


def _each(work: Callable[[Share], Part], shares: Sequence[Share]) -> list[Part]:
    """What `work` makes of each share, one per core: the first in this thread, which would only wait."""
    others = [_workers().submit(work, share) for share in shares[1:]]
    return [work(shares[0]), *(other.result() for other in others)]


def in_parts(work: Callable[[slice], Part], count: int, size: int) -> list[Part]:
    """What `work` makes of each `size` of `count` things, in their order, on all cores.

    For operations of PyTorch on candidates that are independent of each other: parts whose arrays stay in the cache are
    faster on one core too.
    """
    parts = [slice(first, first + size) for first in range(0, count, size)]
    edges = [k * len(parts) // cores() for k in range(cores() + 1)]
    shares = [parts[low:high] for low, high in itertools.pairwise(edges) if high > low]
    return [made for share in _each(lambda share: [work(part) for part in share], shares) for made in share]


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
    """How a batch of candidates is spread over a device, and the scratch memory that it needs there.

    A CPU's kernels take (first group, slot, *arguments), a launch per core with one thread, which works through groups
    of candidates. A GPU's take the arguments alone: a block of threads works on one candidate at a time.
    """

    batch: int
    device: torch.device
    cpu_lanes: int
    items: int = 1
    """Things within a candidate, such as particles, that the threads of a block share out."""

    def __post_init__(self):
        start_warp()

    @property
    def lanes(self) -> int:
        """Candidates in a group."""
        return self.cpu_lanes if self.device.type == "cpu" else 1

    @property
    def groups(self) -> int:
        """Groups in the batch."""
        return -(-self.batch // self.lanes)

    @property
    def slots(self) -> int:
        """Groups worked on at a time, each with scratch memory of its own: one per core, or blocks to fill a GPU."""
        at_a_time = cores() if self.device.type == "cpu" else BLOCKS * _multiprocessors(self.device)
        return min(at_a_time, self.groups)

    @property
    def threads(self) -> int:
        """Threads of a GPU's block: whole warps, as few as do the items in the same number of rounds.

        Few blocks are as large as they may be, to be done soon; many are smaller, so that one works while another waits.
        """
        few = self.groups <= 2 * _multiprocessors(self.device)
        rounds = -(-self.items // (MOST_THREADS if few else MOST_THREADS // 2))
        return -(-self.items // (32 * rounds)) * 32

    def scratch(self, *shape: int) -> wp.array:
        """Vectors [slots, *shape], not initialised; on a GPU neighbours along the first axis of `shape` lie side by side.

        There the memory is PyTorch's, which knows in which stream it is used: Warp's would be given to others meanwhile.
        """
        kind = vector(self.lanes)
        if self.device.type == "cpu":
            return wp.empty((self.slots, *shape), dtype=kind, device="cpu")
        memory = torch.empty((self.slots, *reversed(shape), 1), device=self.device)
        axes = (0, *range(len(shape), 0, -1), len(shape) + 1)
        return wp.from_torch(memory.permute(axes), dtype=kind)

    def run(self, kernel: wp.Kernel, arguments: Sequence[Any]) -> None:
        """Run the kernel over all groups."""
        device = wp.get_device(str(self.device))
        if device.is_cuda:
            stream = wp.stream_from_torch(torch.cuda.current_stream(self.device))
            size = (self.slots, self.threads)
            wp.launch(kernel, size, list(arguments), device=device, stream=stream, block_dim=self.threads)
            return
        _each(wp.Launch.launch, self.commands(kernel, arguments))

    def commands(self, kernel: wp.Kernel, arguments: Sequence[Any]) -> list[wp.Launch]:
        """What a CPU does to run the kernel, one command per core; each can be given again while the arguments last."""
        _load(kernel)
        edges = [w * self.groups // self.slots for w in range(self.slots + 1)]
        return [  # the work of Python is done first: threads that wait for each other there lose milliseconds
            wp.launch(kernel, edges[w + 1] - edges[w], [edges[w], w, *arguments], device="cpu", record_cmd=True)
            for w in range(self.slots)
        ]


@functools.cache
def _multiprocessors(device: torch.device) -> int:
    return torch.cuda.get_device_properties(device).multi_processor_count


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
""")
def barrier():
    """Wait for all threads of the block."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __syncthreads_or(mine);
#else
    return mine;
#endif
""")
def any_thread(mine: int) -> int:
    """Whether `mine` is not zero in any thread of the block, which all wait for each other."""


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


@functools.cache
def roots(lanes: int) -> tuple[Any, Any, Any]:
    """Kernel functions that a vector has no operator for: its root, one over it, and the quotient of two."""
    vec = vector(lanes)

    @wp.func
    def root(a: vec) -> vec:
        r = vec()
        for k in range(lanes):
            r[k] = wp.sqrt(a[k])
        return r

    @wp.func
    def inverse_root(a: vec) -> vec:
        r = vec()
        for k in range(lanes):
            r[k] = 1.0 / wp.sqrt(a[k])
        return r

    @wp.func
    def quotient(a: vec, b: vec) -> vec:
        r = vec()
        for k in range(lanes):
            r[k] = a[k] / b[k]
        return r

    return root, inverse_root, quotient


def bandwidth_order(pairs: np.ndarray, particles: int) -> np.ndarray:
    """An order [N] of particles in which those joined by pairs [S, 2] are near, so that caches hold what is worked on."""
    ones = np.ones(len(pairs))
    graph = coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(particles, particles)).tocsr()
    return reverse_cuthill_mckee(graph + graph.T, symmetric_mode=True).astype(np.int64)
