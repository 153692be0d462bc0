"""Verdicts on the parts of a run: a word, the figure it rests on, and what to do about it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from piegraph_cli.report.found import Found
from piegraph_cli.report.words import Part, Word, measured_error, worst
from piegraph_cli.stages import STAGES
from piegraph_cli.text import counted

MANY = 0.5
"""Share of the sequences that makes a part bad where they are."""
FEW = 3
"""So much is said of what to do; the sequences have it all."""


@dataclass(frozen=True)
class Verdict:
    """On one part of the run."""

    part: str
    word: Word
    figure: str
    todo: list[str] = field(default_factory=list)
    command: str = ""
    anchor: str = ""
    """Of the section of the page that shows more."""


def part_verdict(found: Found, part: str, stage: str, of: Mapping[str, Part]) -> Verdict:
    """On one part of all sequences."""
    there = {name: one for name, one in of.items() if one.made}
    failed = [name for name, one in of.items() if one.word == "bad"]
    waiting = [name for name, one in of.items() if one.word == "not yet"]
    command = found.command(STAGES[stage], waiting[0] if waiting else None) if waiting else ""
    if len(waiting) == len(of):
        return Verdict(part, "not yet", _why_not(found, stage), command=command)
    word = worst(one.word for one in of.values() if one.word != "not yet")
    if word == "bad" and len(failed) < MANY * len(of):
        word = "check"
    figure = FIGURES[part](found, there) if there else "none could be made"
    if failed and len(failed) < len(of):
        figure += f"; {len(failed)} of {len(of)} bad"
    if waiting:
        word, figure = worst([word, "check"]), f"{figure}; {len(waiting)} of {len(of)} sequences have none yet"
    said = [text if name in text else f"{name}: {text}" for name, one in of.items() for text in one.todo]
    more = [f"and {len(said) - FEW} more, at the sequences"] if len(said) > FEW else []
    return Verdict(part, word, figure, said[:FEW] + more, command, "sequences")


def _why_not(found: Found, stage: str) -> str:
    states = {row["state"]: row for (name, _), row in found.rows.items() if name == stage}
    return f"out of date: {states['stale']['reason']}" if "stale" in states else "not made yet"


def _of_recording(found: Found, there: Mapping[str, Part]) -> str:
    odd = [name for name, one in there.items() if one.word != "good"]
    told = f"geometry and clocks to be looked at in {', '.join(odd[:FEW])}" if odd else "geometry and clocks good"
    return f"{counted(len(there), 'sequence')}, {sum(one.value for one in there.values()):.0f} frames; {told}"


def _of_hands(found: Found, there: Mapping[str, Part]) -> str:
    return f"hand or tool in {_mean(there):.0%} of the frames{_least(there)}"


def _of_masks(found: Found, there: Mapping[str, Part]) -> str:
    return f"object in {_mean(there):.0%} of the frames{_least(there)}"


def _of_tracks(found: Found, there: Mapping[str, Part]) -> str:
    known = {name: one for name, one in there.items() if np.isfinite(one.value)}
    if not known:
        source = found.run.maker("tracks").name
        return f"{counted(len(there), 'sequence')}; {SOURCES.get(source, 'how far off they are is not known')}"
    name, most = max(known.items(), key=lambda item: item[1].value)
    figure = f"expected error {_mean(known) * 1000:.1f} mm; most in {name}, {most.value * 1000:.1f} mm"
    measured = [error for name in there if (error := measured_error(found, name)) is not None]
    return figure + (f"; measured {np.mean(measured):.1f} mm" if measured else "")


SOURCES = {"simulate": "of a simulation, which knows where each particle is", "import": "as others measured them"}
FIGURES = {"recording": _of_recording, "hands": _of_hands, "masks": _of_masks, "tracks": _of_tracks}


def _least(of: Mapping[str, Part]) -> str:
    """The sequence that has least, where that is less than the others."""
    name, least = min(of.items(), key=lambda item: item[1].value)
    return f"; least in {name}, {least.value:.0%}" if _mean(of) - least.value >= 0.005 else ""


def _mean(of: Mapping[str, Part]) -> float:
    return float(np.mean([one.value for one in of.values()]))
