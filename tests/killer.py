"""Run a piegraph command and kill it with SIGKILL halfway through its N-th artifact: python killer.py N ARGUMENT ..."""

import os
import signal
import sys
from collections.abc import Iterator

left = int(sys.argv[1])
sys.argv = ["piegraph", *sys.argv[2:]]

from piegraph_cli.__main__ import main  # noqa: E402
from piegraph_cli.workspace import artifact  # noqa: E402

sealed = artifact.sealed


def half_and_die(image: bytes) -> Iterator[bytes]:
    """What is written of an artifact."""
    global left
    left -= 1
    seal, image = sealed(image)
    yield seal
    if left > 0:
        yield image
        return
    yield image[: len(image) // 2]
    os.kill(os.getpid(), signal.SIGKILL)


artifact.sealed = half_and_die
main()
