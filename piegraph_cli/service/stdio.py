"""JSON lines: a request on each line of stdin, its answer on the next line of stdout. All else that is printed is on stderr."""

import os
import sys
from collections.abc import Iterator
from typing import BinaryIO

from piegraph_cli.service.requests import MOST_BYTES
from piegraph_cli.service.service import Service


def serve_lines(service: Service) -> None:
    """Answer until stdin ends, or nobody reads stdout any more."""
    sys.stdout.flush()
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)  # what libraries print must not stand between answers
        try:
            for line in lines(sys.stdin.buffer):
                answers.write(service.reply(line).text + b"\n")
                answers.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), answers.fileno())  # closing would write once more


def lines(stream: BinaryIO) -> Iterator[bytes]:
    """The lines that are not empty; of one that is too long its beginning, one byte longer than what is allowed."""
    while line := stream.readline(MOST_BYTES + 1):
        rest = line
        while len(rest) > MOST_BYTES and not rest.endswith(b"\n"):  # without keeping it
            rest = stream.readline(MOST_BYTES + 1)
        if line.strip():
            yield line
