"""What a benchmark row says, how it is timed, and what the machine can do at most."""

import contextlib
import functools
import os
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import torch

from piegraph_cli.errors import DataError
from piegraph_cli.kernels import lanes
from piegraph_cli.kernels.peak import ACCUMULATORS, copy_back_and_forth, multiply_add
from piegraph_cli.text import Column, Table

REPEATS = 9
WITHIN = 0.2
"""Seconds that one measurement lasts at most, in repeats of what is measured; slower things are measured fewer times."""

FMA_STEPS = 4_000_000
COPY_STEPS = 10_000
COPIED = 1 << 11
"""Floats of each row that is copied within the first cache: 8 KB."""

IN_MEMORY = 1 << 26
"""Floats copied that no cache holds: 256 MB."""


@dataclass(frozen=True)
class Row:
    """One measurement."""

    subject: str
    case: str
    seconds: float
    """Median of one repeat."""
    cores: int = 1
    error: float | None = None
    """Largest deviation from the reference, metres."""
    flop: float | None = None
    """Operations of the method on floats, as the reference's formulas have them; comparisons and integers are free."""
    bytes: float | None = None
    """Loaded from and stored to arrays."""
    reference_seconds: float | None = None
    """The reference on the same input in the same run."""
    share: float | None = None
    """Of the peak of the cores used, or of the GPU."""
    device: str = "cpu"

    def as_dict(self) -> dict[str, Any]:
        """The row and what follows from it."""
        rate = {"gflops": self.flop / self.seconds / 1e9} if self.flop else {}
        ratio = {"ratio": self.reference_seconds / self.seconds} if self.reference_seconds else {}
        return {name: value for name, value in asdict(self).items() if value is not None} | rate | ratio


def table(rows: list[Row]) -> Table:
    """Rows for people."""
    heads = [
        ("cores", 5),
        ("median", 10),
        ("error", 10),
        ("GFlop/s", 8),
        ("of peak", 8),
        ("reference", 10),
        ("ratio", 7),
    ]
    told = []
    for row in rows:
        values = row.as_dict()
        error = f"{row.error:.1e} m" if row.error is not None else ""
        rate = f"{values['gflops']:.1f}" if "gflops" in values else ""
        share = f"{row.share:.0%}" if row.share is not None else ""
        reference = _time(row.reference_seconds) if row.reference_seconds else ""
        ratio = f"{values['ratio']:.1f}x" if "ratio" in values else ""
        name, cores = f"{row.subject} {row.case}", str(row.cores) if row.device == "cpu" else "GPU"
        told.append((name, cores, _time(row.seconds), error, rate, share, reference, ratio))
    return Table([Column("", 44), *(Column(name, width, right=True) for name, width in heads)], told)


def _time(seconds: float) -> str:
    return (
        f"{seconds:.2f} s"
        if seconds >= 1
        else f"{seconds * 1e3:.3g} ms"
        if seconds >= 1e-3
        else f"{seconds * 1e6:.3g} us"
    )


def median_seconds(work: Callable[[], Any], repeats: int = REPEATS) -> float:
    """Median time of `work`."""
    return statistics.median(measure(work, repeats))


def measure(work: Callable[[], Any], repeats: int) -> list[float]:
    """Times of `work`, which runs before to warm up; quick work is repeated within a measurement."""
    work()
    begin = time.perf_counter()
    work()
    once = time.perf_counter() - begin
    times = max(1, round(WITHIN / repeats / max(once, 1e-7)))
    measured = [once] if times == 1 else []
    while len(measured) < repeats:
        begin = time.perf_counter()
        for _ in range(times):
            work()
        measured.append((time.perf_counter() - begin) / times)
    return measured


def check(what: str, error: float, allowed: float) -> float:
    """The error, if it is allowed. Raises `DataError` otherwise: the speed of wrong results means nothing."""
    if not error <= allowed:
        raise DataError(f"deviates from its reference by {error:.2e} m, more than {allowed:g} m", f"bench {what}")
    return error


@contextlib.contextmanager
def on_cores(count: int) -> Iterator[None]:
    """Kernels use `count` cores."""
    before = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = str(count)
    lanes.cores.cache_clear()
    try:
        yield
    finally:
        os.environ.pop("OMP_NUM_THREADS")
        if before is not None:
            os.environ["OMP_NUM_THREADS"] = before
        lanes.cores.cache_clear()


@functools.cache
def peak(cores: int) -> float:
    """Operations a second of a loop of fused multiply-adds in registers: the best run of three vector widths."""
    with on_cores(cores):
        return max(_fma_rate(width, cores) for width in (8, 16, 32))


def machine_rows() -> list[Row]:
    """Peaks of one core and of all, and copies within the cache and within memory."""
    rows = []
    for cores in core_counts():
        rate = peak(cores)
        rows.append(Row("machine", "fused multiply-adds, 1 GFlop", 1e9 / rate, cores, flop=1e9, share=1.0))
    rows.append(_copy("copy in the first cache", cache_rate()))
    source, target = torch.ones(IN_MEMORY), torch.empty(IN_MEMORY)
    seconds = median_seconds(functools.partial(target.copy_, source))
    rows.append(_copy("copy in memory", 8 * IN_MEMORY / seconds))
    return rows


def _copy(what: str, rate: float) -> Row:
    return Row("machine", f"{what}, {rate / 1e9:.0f} GB/s", 1e9 / rate, bytes=1e9)


@functools.cache
def cache_rate() -> float:
    """Bytes a second that one core loads and stores when it copies within its first cache."""
    width = 128
    launch = lanes.Launch(width, torch.device("cpu"), width)
    rows = [launch.scratch(COPIED // width) for _ in range(2)]
    for row in rows:
        row.zero_()
    with on_cores(1):
        seconds = min(measure(lambda: launch.run(copy_back_and_forth(width), [*rows, COPY_STEPS]), REPEATS))
    return 2.0 * 8 * COPIED * COPY_STEPS / seconds


def core_counts() -> list[int]:
    """One core, and all."""
    return sorted({1, lanes.cores()})


def _fma_rate(width: int, cores: int) -> float:
    launch = lanes.Launch(cores * width, torch.device("cpu"), width)
    values = launch.scratch(ACCUMULATORS)
    values.zero_()
    seconds = min(measure(lambda: launch.run(multiply_add(width), [values, FMA_STEPS]), REPEATS))
    return 2.0 * width * ACCUMULATORS * FMA_STEPS * cores / seconds
