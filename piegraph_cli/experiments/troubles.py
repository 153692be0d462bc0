"""The experiment `troubles`: recordings that are wrong on purpose, what ingest says of them, and whether that is right."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli.environments.params import SimulateParams, TroubleParams
from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.tables import as_json
from piegraph_cli.experiments.kinds import Kind, kinds
from piegraph_cli.experiments.params import TroublesParams
from piegraph_cli.files import atomic_file
from piegraph_cli.recording.checks import grouped
from piegraph_cli.recording.folders import list_sequences
from piegraph_cli.recording.geometry import View, check_geometry
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.sequence import read_sequence
from piegraph_cli.recording.timing import check_times
from piegraph_cli.stages.geometry import check_frames, views_of
from piegraph_cli.stages.simulate import record_sequences
from piegraph_cli.workspace.parallel import in_processes

GOOD = "good recordings"


@dataclass(frozen=True)
class Told:
    """What was said of one recording."""

    kind: str
    strength: str
    recording: str
    verdict: str
    text: str
    right: bool


def run_troubles(params: TroublesParams, folder: Path, jobs: int) -> list[Told]:
    """Render what is missing below `folder`/recordings, and look at everything."""
    found = kinds()
    good = [(env, TroubleParams(noise=noise)) for env in params.good for noise in params.noises]
    wrong = [(env, kind.trouble) for env in params.environments for kind in found if kind.trouble]
    base = [(env, TroubleParams()) for env in params.environments]
    folders = {key: folder / "recordings" / _name(*key) for key in dict.fromkeys([*good, *base, *wrong])}
    _parallel(jobs, [partial(_render, params, *key, path) for key, path in folders.items()])
    tasks = [partial(_good, folders[key]) for key in good]
    tasks += [partial(_good, path) for path in params.recordings]
    for env in params.environments:
        whole = folders[env, TroubleParams()]
        altered = [kind for kind in found if not kind.trouble]
        tasks.append(partial(_altered, altered, env, whole))
        tasks += [partial(_rendered, k, env, folders[env, k.trouble]) for k in found if k.trouble]
    return [told for some in _parallel(jobs, tasks) for told in some]


def _parallel(jobs: int, tasks: list[Any]) -> list[Any]:
    from tqdm import tqdm

    work = in_processes(tasks, jobs, in_order=True)
    return list(tqdm(work, total=len(tasks), desc="troubles", disable=None, leave=False))


def _name(environment: str, trouble: TroubleParams) -> str:
    usual = TroubleParams()
    changed = [(n, v) for n, v in trouble if v != getattr(usual, n) and n != "of"]
    return "-".join([environment, *(f"{name}{value:g}" for name, value in changed)])


def _render(params: TroublesParams, environment: str, trouble: TroubleParams, folder: Path) -> None:
    settings = SimulateParams.model_validate(
        {"environment": environment, "sequences": 1, "strokes": params.strokes, "seed": params.seed, "trouble": trouble}
    )
    record_sequences(folder, settings, jobs=1, force=False)


def _looked_at(sequence: Path) -> tuple[str, list[str]]:
    """Verdict and texts of ingest on a sequence."""
    settings = ReadParams()
    try:
        arrays, _ = read_sequence(sequence, settings)
        _, word, warnings = check_frames(arrays, settings, sequence)
    except DataError as error:
        return "bad", [error.message]
    return ("good" if word == "good" else "doubtful"), [w.removeprefix("geometry: ") for w in warnings]


def _good(recording: Path) -> list[Told]:
    found = []
    for sequence in list_sequences(recording, "auto"):
        verdict, texts = _looked_at(sequence)
        found.append(Told(GOOD, "", f"{recording.name}/{sequence.name}", verdict, "; ".join(texts), verdict == "good"))
    return found


def _rendered(kind: Kind, environment: str, recording: Path) -> list[Told]:
    verdict, texts = _looked_at(list_sequences(recording, "piegraph")[0])
    return [_told(kind, environment, verdict, [part for text in texts for part in (text, *text.split(": ", 1)[1:])])]


def _altered(altered: Sequence[Kind], environment: str, recording: Path) -> list[Told]:
    """What is said of a good recording that is altered."""
    sequence = list_sequences(recording, "piegraph")[0]
    arrays, _ = read_sequence(sequence, ReadParams())
    views = views_of(arrays, sequence)
    workspace = np.array(ReadParams().workspace).reshape(3, 2)
    found = []
    for kind in altered:
        if kind.change:
            verdict, texts = _geometry(kind.change(views), workspace)
        else:
            assert kind.times is not None
            verdict, texts = _clock(kind.times(arrays["stamp"][:, 0]))
        found.append(_told(kind, environment, verdict, texts))
    return found


def _geometry(views: list[View], workspace: np.ndarray) -> tuple[str, list[str]]:
    findings = grouped(check_geometry(views, workspace))
    return (findings[0].checks[0].verdict if findings else "good"), [finding.text for finding in findings]


def _clock(times: np.ndarray) -> tuple[str, list[str]]:
    try:
        warnings = check_times(times, "timestamps.txt")
    except DataError as error:
        return "bad", [error.message]
    return ("doubtful" if warnings else "good"), warnings


def _told(kind: Kind, environment: str, verdict: str, texts: Sequence[str]) -> Told:
    right = verdict != "good" and any(re.search(kind.cause, text) for text in texts)
    return Told(kind.name, kind.strength, environment, verdict, "; ".join(texts), right)


def write_troubles(told: Sequence[Told], folder: Path) -> tuple[dict[str, Any], list[str]]:
    """The table as an object and as lines; `folder`/report has it as a file of results too, with what was said."""
    rows = [_row(told, *kind) for kind in dict.fromkeys((t.kind, t.strength) for t in told)]
    wrong = [t for t in told if t.kind != GOOD]
    alarms = [t for t in told if t.kind == GOOD and not t.right]
    missed = [t for t in wrong if not t.right]
    lines = [f"{'trouble':38s} {'strength':14s}  bad  doubtful  good  right"]
    lines += [
        f"{r['trouble']:38s} {r['strength']:14s} {r['bad']:4d} {r['doubtful']:9d} {r['good']:5d}  "
        f"{r['right']} of {r['recordings']}"
        for r in rows
    ]
    lines += ["", f"{len(missed)} of {len(wrong)} not caught with their cause; {len(alarms)} false alarms"]
    lines += [f"  {t.kind}, {t.strength}, {t.recording}: {t.verdict}: {t.text}" for t in [*missed, *alarms]]
    value = {"rows": rows, "missed": len(missed), "wrong": len(wrong), "false_alarms": len(alarms)}
    said = [f"{t.kind} | {t.strength} | {t.recording} | {t.verdict} | {t.text}" for t in told]
    for name, text in (
        ("troubles.txt", "\n".join(lines)),
        ("troubles.json", as_json(value)),
        ("troubles_told.txt", "\n".join(said)),
    ):
        with atomic_file(folder / "report" / name) as temporary:
            temporary.write_text(text + "\n")
    return value, lines


def _row(told: Sequence[Told], kind: str, strength: str) -> dict[str, Any]:
    own = [t for t in told if (t.kind, t.strength) == (kind, strength)]
    counts = {verdict: sum(t.verdict == verdict for t in own) for verdict in ("bad", "doubtful", "good")}
    return (
        {"trouble": kind, "strength": strength} | counts | {"right": sum(t.right for t in own), "recordings": len(own)}
    )
