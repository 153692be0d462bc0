"""Run a piegraph command and kill it with SIGKILL halfway through its N-th artifact: python killer.py N ARGUMENT ..."""

import os
import signal
import sys
from pathlib import Path

left = int(sys.argv[1])
sys.argv = ["piegraph", *sys.argv[2:]]
write_bytes = Path.write_bytes


def write_half_and_die(self: Path, data: bytes) -> int:
    global left
    left -= 1
    if left > 0:
        return write_bytes(self, data)
    write_bytes(self, data[: len(data) // 2])
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


Path.write_bytes = write_half_and_die

from piegraph_cli.commands.program import main  # noqa: E402

main()
