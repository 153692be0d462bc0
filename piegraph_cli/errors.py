"""The errors a user can cause or mend, each with the exit code the command line ends with."""

import shlex
from typing import Any


def command_line(*words: object) -> str:
    """A command of piegraph, to be pasted into a shell: what has spaces is quoted."""
    return shlex.join(["piegraph", *map(str, words)])


class PiegraphError(Exception):
    """What went wrong, where (file, sequence, frame, camera), and what to try next.

    `where` and `hint` may be empty. Raised anywhere; only the command line turns it into text and an exit code.
    """

    exit_code = 1
    kind = "bug"
    """The exit code in a word."""

    def __init__(self, message: str, where: str = "", hint: str = ""):
        super().__init__(message)
        self.message, self.where, self.hint = message, where, hint

    def __reduce__(self):
        return type(self), (self.message, self.where, self.hint)

    def __str__(self) -> str:
        text = f"{self.where}: {self.message}" if self.where else self.message
        return f"{text}\n  try: {self.hint}" if self.hint else text


class UsageError(PiegraphError):
    """A wrong command, option, parameter or recipe."""

    exit_code = 2
    kind = "usage"


class DataError(PiegraphError):
    """A recording, artifact, goal or other input that is missing, broken or unusable."""

    exit_code = 3
    kind = "data"


class InputError(DataError):
    """What a stage reads was not made yet."""

    kind = "input"


class MissingError(PiegraphError):
    """A package, weight file or device that this machine lacks."""

    exit_code = 4
    kind = "missing"


def error_object(error: PiegraphError) -> dict[str, Any]:
    """An error for programs."""
    return {
        "kind": error.kind,
        "message": error.message,
        "where": error.where or None,
        "try": error.hint or None,
        "exit_code": error.exit_code,
    }
