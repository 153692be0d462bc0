"""One command line's answer: what `--json` prints, in the same envelope whether the command succeeded or failed."""

import contextlib
import logging
import sys
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from typing import Any

from piegraph_cli import __version__
from piegraph_cli.errors import error_object as error_object


class Answer(logging.Handler):
    """What the envelope of one command line is made of: it gathers warnings as they are logged."""

    def __init__(self, command: str | None):
        super().__init__(logging.WARNING)
        self.command = command
        self.result: dict[str, Any] | None = None
        self.warnings: list[str] = []
        self.error: dict[str, Any] | None = None
        self.told = False
        """Whether stdout has all that it shall have: then nothing is printed at the end."""

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a warning; what is logged as an error comes as the command's error."""
        if record.levelno == logging.WARNING:
            self.warnings.append(record.getMessage())

    def text(self) -> str:
        """The envelope as JSON."""
        from piegraph_cli.evaluation.tables import as_json

        names = ("command", "version", "result", "warnings", "error")
        found = (self.command, __version__, self.result, self.warnings, self.error)
        return as_json(dict(zip(names, found, strict=True)))


_answers: ContextVar[Answer] = ContextVar("answer")


def answer() -> Answer:
    """That of the command line at work."""
    return _answers.get()


def wants_json(arguments: Sequence[str]) -> bool:
    """Whether a command line asks for JSON, even one that cannot be understood otherwise."""
    options = arguments[: list(arguments).index("--")] if "--" in arguments else arguments
    return "--json" in options


@contextlib.contextmanager
def answering(command: str | None) -> Iterator[Answer]:
    """Gather the answer of a command line, and let its log go to stderr."""
    log, made = logging.getLogger("piegraph"), Answer(command)
    stderr = logging.StreamHandler(sys.stderr)
    stderr.setLevel(logging.INFO)
    stderr.setFormatter(logging.Formatter("%(message)s"))
    before, level, token = log.handlers, log.level, _answers.set(made)
    log.handlers = [stderr, made]
    log.setLevel(logging.DEBUG)
    try:
        yield made
    finally:
        log.handlers = before
        log.setLevel(level)
        _answers.reset(token)
