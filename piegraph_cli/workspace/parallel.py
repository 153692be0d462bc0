"""One function over many items: one after the other, in processes of this machine (joblib), or on a Ray cluster."""

import contextlib
import logging
import multiprocessing
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

from piegraph_cli.errors import MissingError, PiegraphError
from piegraph_cli.signals import end_with, held_back

Item = TypeVar("Item")
Result = TypeVar("Result")

log = logging.getLogger("piegraph")

RETRIES = 5
"""How often an item is tried again on Ray when the node or process that works on it dies."""


def each(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    jobs: int,
    backend: str,
    lost: Callable[[Item, PiegraphError], Result],
) -> Iterator[Result]:
    """The result of `work(item)` for every item, as they come; `lost(item, error)` for one that kills its processes.

    `jobs` processes work at a time on this machine; on a cluster, one per core of it. `work` handles its own errors.
    """
    if backend == "ray":
        yield from _on_ray(work, items, lost)
    elif jobs == 1:
        yield from map(work, items)
    else:
        yield from in_processes([partial(work, item) for item in items], jobs)


def in_processes(tasks: Sequence[Callable[[], Result]], jobs: int, in_order: bool = False) -> Iterator[Result]:
    """What tasks give, worked on by so many processes of this machine, which end with this one, however it ends."""
    from multiprocessing import resource_tracker

    warnings.filterwarnings("ignore", message=".*joblib will operate in serial mode")
    import joblib
    from joblib.externals.loky.backend.resource_tracker import ensure_running
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    # joblib replaces workers that have grown, which is no news to a user; nor is what is left of a killed process
    warnings.filterwarnings("ignore", message="A worker stopped while some jobs were given to the executor")
    os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker:UserWarning")
    if jobs > 1 and (why := _no_semaphores()):
        log.warning(
            "one process in place of %d: processes cannot share semaphores here (%s); mount /dev/shm", jobs, why
        )
        jobs = 1
    watch: dict[str, Any] = {"initializer": end_with, "initargs": (os.getpid(),)} if jobs > 1 else {}
    parallel = joblib.Parallel(n_jobs=jobs, return_as="generator" if in_order else "generator_unordered", **watch)
    try:
        if jobs > 1:
            ensure_running()
            resource_tracker.ensure_running()  # where these start they let the signals through
        with held_back():
            found = parallel(joblib.delayed(task)() for task in tasks)
        yield from found
    except TerminatedWorkerError:
        raise MissingError(
            "a worker process was killed, for want of memory perhaps", hint="fewer --jobs; what is done is kept"
        ) from None


def _no_semaphores() -> str:
    """Why processes of this machine cannot wait for each other; empty where they can."""
    try:
        multiprocessing.get_context("spawn").Semaphore()
    except (OSError, ImportError) as error:
        return str(error)
    return ""


def _on_ray(
    work: Callable[[Item], Result], items: Sequence[Item], lost: Callable[[Item, PiegraphError], Result]
) -> Iterator[Result]:
    with contextlib.redirect_stdout(sys.stderr), _cluster() as ray:  # Ray tells of dead nodes on stdout
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(_call).options(name="piegraph")
        waiting = {task.remote(work, item): item for item in items}
        while waiting:
            (done,), _ = ray.wait(list(waiting))
            item = waiting.pop(done)
            try:
                yield ray.get(done)
            except ray.exceptions.RayError as error:
                reason = str(error).splitlines()[0]
                hint = "look at the memory of the cluster's nodes; what is done is kept"
                yield lost(item, MissingError(f"lost {RETRIES + 1} times: {reason}", hint=hint))


def _call(work: Callable[[Item], Result], item: Item) -> Result:
    return work(item)


@contextlib.contextmanager
def _cluster() -> Iterator[Any]:
    """Ray, connected to the cluster at RAY_ADDRESS or the one that runs on this machine."""
    try:
        import ray
    except ImportError:
        raise MissingError("ray is not installed", hint="pip install 'piegraph[cluster]'") from None
    os.environ.setdefault("RAY_gcs_server_port_wait_time_s", "1")  # one try, of 40 s: by default it tries for minutes
    try:
        ray.init(address="auto", log_to_driver=False, logging_level=logging.ERROR)
    except ConnectionError:
        where = os.environ.get("RAY_ADDRESS", "")
        hint = "ray start --head, or RAY_ADDRESS=HOST:PORT; one machine alone needs no --backend"
        raise MissingError("no Ray cluster answers", where, hint) from None
    try:
        yield ray
    finally:
        ray.shutdown()
