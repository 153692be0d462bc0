"""Stage `ingest`: a recorded sequence, checked, on one clock, as one file."""

import functools
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.recording.params import IngestParams, SequenceParams
from piegraph_cli.text import counted
from piegraph_cli.workspace.call import Call, Option, options_of
from piegraph_cli.workspace.stage import Context, Output, Stage, Unit

if TYPE_CHECKING:
    from piegraph_cli.workspace.run import Run

log = logging.getLogger("piegraph")

NEW_PLACE = "tell where it is now: piegraph ingest --run RUN --recording NEW_PLACE"

Place = tuple[Path, str]
"""A recording, and the name of a sequence's folder in it."""


def _units(run: "Run") -> Sequence[Unit]:
    """The sequences of all recordings; of one that is gone those that were read. Some are left out."""
    places = _places(run)
    for recording in run.params(STAGE.name).recording:
        if not recording.exists():
            _tell_gone(recording, sum(of == recording for of, _ in places.values()))
    return list(places)


@functools.cache
def _tell_gone(recording: Path, count: int) -> None:
    """Say it once a process."""
    message = "the recording %s is gone: its %d sequences stay as they were read; if it was moved, %s"
    log.warning(message, recording, count, NEW_PLACE)


def _places(run: "Run") -> dict[str, Place]:
    """Where each sequence is, by its name in this run."""
    return run.once(STAGE.name, _find_places)


def _find_places(run: "Run") -> dict[str, Place]:
    params = run.params(STAGE.name)
    if not params.recording:
        raise UsageError("this run has no recording", str(run.folder), "piegraph ingest --recording FOLDER --run RUN")
    twice = next((path for k, path in enumerate(params.recording) if path in params.recording[:k]), None)
    if twice:
        raise UsageError("ingest.recording: one recording is given twice", str(twice), "give each once")
    found: dict[str, Place] = {}
    boards: set[str] = set()
    gone = [path for path in params.recording if not path.exists() and _kept(run, path)]
    for recording in params.recording:
        if recording in gone:
            found |= {unit: (recording, unit) for unit in _kept(run, recording)}
            continue
        names, shown = _sequences(recording, params.layout)
        for name in names:
            unit = _unit_name(found, recording, name)
            found[unit] = (recording, name)
            boards |= {unit} if name in shown else set()
    where = ", ".join(map(str, params.recording))
    unknown = sorted(set(params.exclude) - {*found, ""})
    if unknown and not gone:
        raise UsageError(f"ingest.exclude: no sequence {unknown[0]}", where, f"sequences are {', '.join(found)}")
    left = {unit: place for unit, place in found.items() if unit not in boards | set(params.exclude)}
    if not left:
        raise DataError("every sequence is left out", where, "record one without the board, or exclude fewer")
    return left


def _sequences(recording: Path, layout: str) -> tuple[list[str], set[str]]:
    """Names of a recording's sequences, and those that show the calibration board."""
    from piegraph_cli.recording.folders import calibration_sequences, list_sequences

    folders = list_sequences(recording, layout)
    return [folder.name for folder in folders], calibration_sequences(folders)


def _kept(run: "Run", recording: Path) -> list[str]:
    """The sequences that this run has read from a recording."""
    files = sorted((run.folder / STAGE.writes).glob("[!.]*.h5"))
    headers = {path.stem: run.header(STAGE, path.stem) for path in files}
    return [unit for unit, header in headers.items() if header and header.params.get("recording") == str(recording)]


def _unit_name(taken: dict[str, Place], recording: Path, name: str) -> str:
    """A sequence's name; after those of the folders it lies in, as many as it takes, where earlier recordings have it."""
    above = recording.resolve().parts[1:]
    names = ("-".join([*above[len(above) - k :], name]) for k in range(len(above) + 1))
    unit = next((unit for unit in names if unit not in taken), None)
    if unit is None:
        raise DataError(f"the name {name} is taken by another recording", str(recording), "rename the folder")
    return unit


def _settings(run: "Run", unit: str) -> SequenceParams:
    """One sequence does not depend on which others there are."""
    params = run.params(STAGE.name)
    recording, sequence = _places(run)[unit]
    shared = params.model_dump(exclude={"recording", "exclude"})
    return SequenceParams(recording=recording, sequence=sequence, **shared)


def _options() -> dict[str, Option]:
    """Several recordings may be given, one after the other."""
    options = options_of(IngestParams)
    return {"recording": Option(list[Path], options.pop("recording").meaning)} | options


STAGE = Stage(
    "ingest",
    "read and check a recording",
    (),
    "frames",
    IngestParams,
    version=6,
    run="piegraph_cli.stages.ingest:run",
    units=_units,
    settings=_settings,
    call=Call(options=_options),
)


def sequence_folder(run: "Run", unit: str) -> Path:
    """The folder of a sequence of a run's recordings. Raises `UsageError` where the run has none, `DataError` if it is gone."""
    place = _places(run).get(unit)
    if place is None:
        where = ", ".join(map(str, run.params(STAGE.name).recording))
        raise DataError(f"there is no sequence {unit} any more", where, "put it back, or leave its results alone")
    return place[0] / place[1]


def run(inputs: dict[str, Any], params: SequenceParams, context: Context) -> Output:
    """Read one sequence, into a world whose table is z = 0."""
    from piegraph_cli.recording.ground import level, moved
    from piegraph_cli.recording.sequence import read_sequence
    from piegraph_cli.stages.geometry import check_frames

    folder = params.recording / params.sequence
    if not params.recording.exists():
        raise DataError("the recording is not there any more", str(params.recording), f"put it back, or {NEW_PLACE}")
    arrays, warnings = read_sequence(folder, params, progress=lambda frames: context.progress(frames, "frames"))
    checked, geometry, doubts = check_frames(arrays, params, folder)
    time, cameras = arrays["time"], arrays["camera_name"]
    quality = f"{counted(len(time), 'frame')}, {counted(len(cameras), 'camera')}, {time[-1] - time[0]:.1f} s"
    if any(params.table):
        T_table_world = level(params.table)
        arrays["T_world_camera"] = T_table_world @ arrays["T_world_camera"]
        arrays |= {name: moved(arrays[name], T_table_world) for name in ("end_effector",) if name in arrays}
        quality += f", z = 0 is the table at z = {params.table[0]:g} m of the recording"
    quality += f", geometry {geometry}"
    first = next(unit for unit, (recording, _) in _places(context.run).items() if recording == params.recording)
    if context.unit == first:
        board = _sequences(params.recording, params.layout)[1]
        warnings += [f"{name} is left out: by cameras.json it shows the calibration board" for name in sorted(board)]
    return Output(arrays | checked, quality, warnings + doubts)
