"""JSON lines: a request on each line of a stream, its answer on the next line of another."""

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import BinaryIO

from piegraph_cli.service.requests import MOST_BYTES
from piegraph_cli.service.service import Service


def serve_lines(service: Service, requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer until the requests end, or nobody reads the answers any more."""
    with contextlib.suppress(BrokenPipeError):
        for line in lines(requests):
            answers.write(service.reply(line).text + b"\n")
            answers.flush()


def lines(stream: BinaryIO) -> Iterator[bytes]:
    """The lines that are not empty; of one that is too long its beginning, one byte longer than what is allowed."""
    while line := stream.readline(MOST_BYTES + 1):
        rest = line
        while len(rest) > MOST_BYTES and not rest.endswith(b"\n"):  # without keeping it
            rest = stream.readline(MOST_BYTES + 1)
        if len(line) > MOST_BYTES or line.strip():
            yield line


@contextlib.contextmanager
def stdout_alone() -> Iterator[BinaryIO]:
    """This process's stdout for answers alone: what libraries print meanwhile goes to stderr."""
    sys.stdout.flush()
    own = os.dup(1)
    os.dup2(2, 1)
    try:
        yield os.fdopen(own, "wb", closefd=False)
    finally:
        os.dup2(own, 1)
        os.close(own)
