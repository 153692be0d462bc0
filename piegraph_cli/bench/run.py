"""All benchmarks by name, one after the other, and the roofline of what they measured."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from pathlib import Path

import torch
from matplotlib.figure import Figure

from piegraph_cli.bench import gpu
from piegraph_cli.bench.kernels import network_rows, spring_rows
from piegraph_cli.bench.measure import Row, cache_rate, machine_rows, peak
from piegraph_cli.bench.perception import check_checkout, perception_rows
from piegraph_cli.bench.pipeline import plan_rows, track_rows, train_rows
from piegraph_cli.bench.sheet import sheet_rows
from piegraph_cli.bench.viewer import viewer_rows
from piegraph_cli.bench.workspace import workspace_rows
from piegraph_cli.errors import UsageError
from piegraph_cli.process import set_up_torch

OF_A_RUN = ("perception", "view")
PICTURES = (".png", ".svg")


def run_benchmarks(subjects: list[str], run: Path | None, against: Path | None = None) -> Iterator[Row]:
    """Rows of the machine, then of each subject; of all of them where none is named. Those `OF_A_RUN` need one.

    It is compared with another commit in the checkout `against`.
    """
    set_up_torch()
    known: dict[str, Callable[[], Iterator[Row]]] = {
        "sms": spring_rows,
        "egnn": network_rows,
        "plan": plan_rows,
        "track": lambda: chain(track_rows(), sheet_rows()),
        "train": train_rows,
        "workspace": workspace_rows,
        "perception": partial(perception_rows, run, against),
        "view": partial(viewer_rows, run),
    }
    unknown = [subject for subject in subjects if subject not in known]
    if unknown:
        raise UsageError(f"no benchmark {unknown[0]}", "bench", f"one of {', '.join(known)}")
    needing = [subject for subject in subjects if subject in OF_A_RUN]
    if needing and run is None:
        raise UsageError("a run with hands, masks, clouds and tracks is needed", f"bench {needing[0]}", "--run RUN")
    if against is not None:
        check_checkout(against)
    yield from machine_rows()
    has_gpu = torch.cuda.is_available()
    if has_gpu:
        yield from gpu.machine_rows()
    for subject in subjects or [name for name in known if name not in OF_A_RUN or run is not None]:
        yield from known[subject]()
        if has_gpu and subject in gpu.ROWS:
            yield from gpu.ROWS[subject]()


def check_picture(path: Path) -> None:
    """Refuse a picture that could not be written when all is measured. Raises UsageError."""
    if path.suffix not in PICTURES or not path.parent.is_dir():
        hint = f"a file in a folder that exists, ending in {' or '.join(PICTURES)}"
        raise UsageError(f"cannot write a picture to {path}", "bench --roofline", hint)


def draw_roofline(rows: list[Row]) -> Figure:
    """What each kernel reached against what arithmetic and copies in the cache allow, on one core."""
    figure = Figure(figsize=(7, 4.6), layout="constrained")
    axes = figure.subplots()
    cache = cache_rate()
    ends = [0.1, 10.0]
    corner = peak(1) / cache
    axes.plot([ends[0], corner, ends[1]], [cache * ends[0] / 1e9, peak(1) / 1e9, peak(1) / 1e9], color="0.3", lw=1.2)
    axes.annotate(
        f"multiply-adds, {peak(1) / 1e9:.0f} GFlop/s", (ends[1], peak(1) / 1e9), ha="right", va="bottom", fontsize=8
    )
    axes.annotate(
        f"copy in the first cache, {cache / 1e9:.0f} GB/s", (ends[0] * 1.1, cache * ends[0] * 0.7 / 1e9), fontsize=8
    )
    for subject, color, marker in (("sms", "#1f4e9c", "o"), ("egnn", "#d62728", "s")):
        mine = [
            row
            for row in rows
            if row.subject == subject and row.flop and row.bytes and (row.device, row.cores) == ("cpu", 1)
        ]
        x = [(row.flop or 0) / (row.bytes or 1) for row in mine]
        y = [(row.flop or 0) / row.seconds / 1e9 for row in mine]
        axes.scatter(x, y, s=22, color=color, marker=marker, label=subject, zorder=3)
    axes.set(xscale="log", yscale="log", xlabel="operations per byte loaded or stored", ylabel="GFlop/s on one core")
    axes.set(xlim=ends, ylim=(5, 2 * peak(1) / 1e9))
    axes.grid(alpha=0.3, which="both")
    axes.legend(loc="lower right")
    return figure
