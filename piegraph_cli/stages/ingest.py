"""Stage `ingest`: a recorded sequence, checked, on one clock, as one file."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.recording.params import IngestParams
from piegraph_cli.workspace.stage import Context, Output, Stage, Unit

if TYPE_CHECKING:
    from piegraph_cli.workspace.run import Run


def _units(run: "Run") -> Sequence[Unit]:
    """The sequences of the recording; those that were read, where it is gone. Some are left out."""
    from piegraph_cli.recording.folders import calibration_sequences, list_sequences

    params = run.params(STAGE.name)
    recording, exclude = recording_of(run), set(params.exclude)
    if not recording.exists() and (run.folder / "frames").is_dir():
        read = sorted(path.stem for path in (run.folder / "frames").glob("[!.]*.h5"))
        return [name for name in read if name not in exclude]
    folders = list_sequences(recording, params.layout)
    names = [folder.name for folder in folders]
    unknown = sorted(exclude - {*names, ""})
    if unknown:
        raise UsageError(
            f"ingest.exclude: no sequence {unknown[0]}", str(recording), f"sequences are {', '.join(names)}"
        )
    exclude |= calibration_sequences(folders)
    left = [name for name in names if name not in exclude]
    if not left:
        raise DataError("every sequence is left out", str(recording), "record one without the board, or exclude fewer")
    return left


def _settings(run: "Run", unit: str) -> IngestParams:
    """One sequence does not depend on which others are left out."""
    return run.params(STAGE.name).model_copy(update={"exclude": ()})


STAGE = Stage(
    "ingest",
    "read and check a recording",
    (),
    "frames",
    IngestParams,
    version=3,
    run="piegraph_cli.stages.ingest:run",
    units=_units,
    settings=_settings,
)


def recording_of(run: "Run") -> Path:
    """The recording folder of a run. Raises `UsageError` where it has none."""
    recording: Path | None = run.params(STAGE.name).recording
    if recording is None:
        raise UsageError("this run has no recording", str(run.folder), "piegraph ingest --recording FOLDER --run RUN")
    return recording


def run(inputs: dict[str, Any], params: IngestParams, context: Context) -> Output:
    """Read one sequence of the recording folder."""
    from piegraph_cli.recording.folders import calibration_sequences, list_sequences
    from piegraph_cli.recording.sequence import read_sequence
    from piegraph_cli.stages.geometry import check_frames

    folder = recording_of(context.run) / str(context.unit)
    arrays, warnings = read_sequence(folder, params, progress=lambda frames: context.progress(frames, "ingest"))
    checked, geometry, doubts = check_frames(arrays, params, folder)
    time, cameras = arrays["time"], arrays["camera_name"]
    quality = f"{len(time)} frames, {len(cameras)} cameras, {time[-1] - time[0]:.1f} s, geometry {geometry}"
    if context.unit == context.run.units(STAGE)[0]:
        board = calibration_sequences(list_sequences(folder.parent, params.layout))
        warnings += [f"{name} is left out: by cameras.json it shows the calibration board" for name in sorted(board)]
    return Output(arrays | checked, quality, warnings + doubts)
