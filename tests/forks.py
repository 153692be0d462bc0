"""A process that has imported PyTorch and forks for each command line, so that hundreds of them need not import it again.

A request is a line of JSON on stdin: `arguments`, `folder`, `environment`, and the files `stdout` and `stderr`; `cores`, those
that it may use, and `mounts`, a process whose file systems it is to see. The answer is the exit code. What is forked is what
`piegraph` starts with: a process of its own, its packages not yet used.
"""

import ctypes
import gc
import json
import os
import sys
from typing import Any


def import_all() -> None:
    """What most commands import, and takes long."""
    import piegraph_cli.dynamics.models
    import piegraph_cli.planning.search  # noqa: F401


def serve() -> None:
    import_all()
    from piegraph_cli.__main__ import main

    gc.collect()
    gc.freeze()  # or every child would copy all of this memory when it looks for garbage at its end
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            become(json.loads(line))
            main()
        _, status = os.waitpid(child, 0)
        print(os.waitstatus_to_exitcode(status), flush=True)


def become(request: dict[str, Any]) -> None:
    """Take the place of a process that was started with this folder, environment and these files."""
    if request.get("mounts"):
        place = os.open(f"/proc/{request['mounts']}/ns/mnt", os.O_RDONLY)
        if ctypes.CDLL(None, use_errno=True).setns(place, 0):
            raise OSError(ctypes.get_errno(), "no entry into the file systems of another process")
    if request.get("cores"):
        os.sched_setaffinity(0, request["cores"])
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
    for number, name in enumerate((os.devnull, request["stdout"], request["stderr"])):
        os.dup2(os.open(name, flags if number else os.O_RDONLY), number)
    sys.argv = ["piegraph", *request["arguments"]]
