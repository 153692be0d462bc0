"""Words on the parts of one sequence: good, check, bad or not yet, each with its figure and what was said of it."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from piegraph_cli.evaluation.scores import AT_ENDS, SPOTS
from piegraph_cli.report.found import Found
from piegraph_cli.stages.hands import POOR
from piegraph_cli.stages.track import DOUBTFUL

Word = Literal["good", "check", "bad", "not yet"]
ORDER: tuple[Word, ...] = ("good", "not yet", "check", "bad")
"""From the least that is to be done."""
OF_CHECKS: dict[str, Word] = {"good": "good", "doubtful": "check", "bad": "bad"}
CHECK_TEXTS = ("verdict", "name", "camera", "text", "cause", "remedy")


@dataclass
class Part:
    """On one part of one sequence."""

    word: Word
    figure: str = ""
    value: float = float("nan")
    """What is averaged over the sequences."""
    todo: list[str] = field(default_factory=list)
    made: bool = True
    """Whether there is something to judge."""


def worst(words: Iterable[Word]) -> Word:
    """The one that most is to be done about."""
    return max(words, key=ORDER.index, default="not yet")


def sequence_parts(found: Found, name: str) -> dict[str, Part]:
    """The parts of one sequence that this run has stages for, in order."""
    judges = {"ingest": _recording, "hands": _hands, "segment": _masks, "track": _tracks}
    names = {"ingest": "recording", "hands": "hands", "segment": "masks", "track": "tracks"}
    if not found.has("track"):  # tracks of others, or of a simulation
        source = found.run.maker("tracks").name
        judges, names = {source: _tracks}, {source: "tracks"}
    parts: dict[str, Part] = {}
    for stage, judge in judges.items():
        row = found.rows[stage, name]
        if row["state"] == "fresh":
            part = judge(found, name)
            said = found.warnings.get((stage, name), [])
            if said:
                part.word, part.todo = worst([part.word, "check"]), said if judge is _recording else part.todo + said
        elif row["state"] == "failed":
            before = any(row["failure"] in earlier.todo for earlier in parts.values())
            part = Part("not yet", "failed before") if before else Part("bad", "failed", todo=[row["failure"]])
            part.made = False
        else:
            part = Part("not yet", "not made yet" if row["state"] == "missing" else row["reason"], made=False)
        parts[names[stage]] = part
    return parts


DAMAGED = Part("bad", "damaged", made=False)


def _recording(found: Found, name: str) -> Part:
    frames = found.read("frames", name, ("time", "camera_name", *(f"check_{column}" for column in CHECK_TEXTS)))
    if frames is None:
        return replace(DAMAGED)
    checks = zip(*(frames.texts(f"check_{column}") for column in CHECK_TEXTS), strict=True)
    odd = [check for check in checks if check[0] != "good"]
    figure = f"{len(frames['time'])} frames, {len(frames['camera_name'])} cameras"
    word = worst([OF_CHECKS.get(check[0], "check") for check in odd] or ["good"])
    todo = [f"{name}, {camera}: {'; '.join(filter(None, said))}\n  try: {do}" for _, name, camera, *said, do in odd]
    return Part(word, figure, float(len(frames["time"])), todo)


def _hands(found: Found, name: str) -> Part:
    hands = found.read("hands", name, ("observed",))
    if hands is None:
        return replace(DAMAGED)
    share = float(hands["observed"].mean())
    return Part("check" if share < POOR else "good", f"{share:.0%} of the frames", share)


def _masks(found: Found, name: str) -> Part:
    masks = found.read("masks", name, ("area",))
    if masks is None:
        return replace(DAMAGED)
    share = float((masks["area"] > 0).any(1).mean())
    return Part("check" if share < POOR else "good", f"{share:.0%} of the frames", share)


def _tracks(found: Found, name: str) -> Part:
    tracks = found.read("tracks", name, ("trust/doubt", "contact", "time"))
    if tracks is None:
        return replace(DAMAGED)
    said = found.warnings.get(("fuse", name), [])
    if "trust/doubt" not in tracks:
        return Part("check" if said else "good", f"{len(tracks['time'])} frames", todo=said)
    doubt = float(tracks["trust/doubt"].mean())
    figure = f"expected error {doubt * 1000:.1f} mm"
    limit = found.run.params("dataset").max_doubt
    word: Word = "bad" if doubt > limit else "check" if said or doubt > DOUBTFUL else "good"
    error = measured_error(found, name)
    if error is not None:
        figure += f", measured {error:.1f} mm"
        if error > DOUBTFUL * 1000:
            return Part("bad", figure, doubt, [*said, f"the tracks are {error:.0f} mm off the truth"])
    return Part(word, figure, doubt, said)


def measured_error(found: Found, name: str) -> float | None:
    """Mean distance (mm) of a sequence's tracks from the truth at stroke ends, or from spots that were clicked by hand."""
    scores = found.read("scores", name, ("score_name", "score_value"))
    if scores is None:
        return None
    for measure in (AT_ENDS, SPOTS):
        values = scores["score_value"][scores["score_name"] == measure.encode()]
        if np.isfinite(values).any():
            return float(np.nanmean(values))
    return None
