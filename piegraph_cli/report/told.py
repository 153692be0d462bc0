"""What `piegraph report` tells programs with `--json`, as models."""

from typing import Literal

from piegraph_cli.stages.results import Result


class Verdict(Result):
    """On one part of a run."""

    part: str
    word: Literal["good", "check", "bad", "not yet"]
    figure: str
    """What the word rests on."""
    todo: list[str]
    """What to do about it."""
    command: str
    """What makes what is missing; empty where nothing is."""
    anchor: str
    """Of the section of the page that shows more."""


class LeftOut(Result):
    """Units of a stage that are not in a report."""

    stage: str
    state: Literal["stale", "missing", "failed", "damaged"]
    units: list[str]
    why: str
    command: str
    """What makes them."""


class Reported(Result):
    """A report that was written."""

    report: str
    """File."""
    verdicts: list[Verdict]
    left_out: list[LeftOut]
