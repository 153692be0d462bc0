"""Stage `score`: tracking against spots that a person clicked, and all of a simulated recording against its truth.h5."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.evaluation.params import ScoreParams
from piegraph_cli.stages import ingest
from piegraph_cli.workspace.stage import Context, Output, Stage, Unit

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.evaluation.spots import Distance, Sighting
    from piegraph_cli.recording.clicks import Click
    from piegraph_cli.workspace.artifact import Artifact
    from piegraph_cli.workspace.run import Run


def _units(run: "Run") -> Sequence[Unit]:
    """The sequences that have a truth or clicks, or were scored before the recording went."""
    names = [n for n in run.units(ingest.STAGE) if n]
    files = (lambda n: _truth_file(run, n), lambda n: clicks_file(run, n), lambda n: run.path("scores", n))
    return [n for n in names if any(file(n).is_file() for file in files)]


def _settings(run: "Run", unit: str) -> ScoreParams:
    """A sequence depends on its own clicks alone. Raises `UsageError` for clicks of a sequence that is none."""
    folder = _clicks_folder(run)
    if run.params(STAGE.name).clicks is not None and not folder.is_dir():
        raise UsageError("score.clicks: no such folder", str(folder), "give a folder with a SEQUENCE.csv for each")
    names = {*run.units(ingest.STAGE), *run.params(ingest.STAGE.name).exclude}
    odd = sorted(file for file in folder.glob("[!.]*.csv") if file.stem not in names)
    if odd:
        raise UsageError(f"there is no sequence {odd[0].stem}", str(odd[0]), "name the file after its sequence")
    file = clicks_file(run, unit)
    return ScoreParams(clicks=file if file.is_file() else None)


STAGE = Stage(
    "score",
    "score tracking against spots clicked by hand, or a simulated recording against its truth",
    ("frames", "hands", "masks", "clouds", "tracks"),
    "scores",
    ScoreParams,
    version=1,
    run="piegraph_cli.stages.score:run",
    units=_units,
    settings=_settings,
)


def _clicks_folder(run: "Run") -> Path:
    return run.params(STAGE.name).clicks or run.folder / "clicks"


def clicks_file(run: "Run", sequence: str) -> Path:
    """Where the spots of a sequence are kept that a person clicked."""
    return _clicks_folder(run) / f"{sequence}.csv"


def told_by_truth(run: "Run", sequence: str) -> bool:
    """Whether the scores of a sequence say where its particles truly were: it has a truth.h5, or its recording is gone."""
    return _truth_file(run, sequence).is_file() or not ingest.sequence_folder(run, sequence).exists()


def _truth_file(run: "Run", sequence: str) -> Path:
    return ingest.sequence_folder(run, sequence) / "truth.h5"


def read_truth(run: "Run", sequence: str) -> "Artifact | None":
    """The truth of a sequence in the run's world, whose table is z = 0, or None for a recording that has none."""
    from piegraph_cli.recording.ground import level, moved
    from piegraph_cli.workspace.artifact import read_artifact

    try:
        path = _truth_file(run, sequence)
    except DataError:  # what is gone has no truth
        return None
    if not path.is_file():
        return None
    truth, T = read_artifact(path, "truth", foreign=True), level(run.params(ingest.STAGE.name).table)
    points = {"particles", "vertices", "hand_keypoints", "end_effector"} & truth.arrays.keys()
    placed = {name: moved(truth[name], T) for name in points}
    placed |= {name: T @ values for name, values in truth.arrays.items() if name.startswith("pose/")}
    return replace(truth, arrays=truth.arrays | placed)


def run(inputs: dict[str, Any], params: ScoreParams, context: Context) -> Output:
    """Score one sequence; one whose truth is gone, and that has no clicks, gives no scores and no true positions."""
    import numpy as np

    from piegraph_cli.evaluation.scores import AT_ENDS, score_sequence, spot_scores
    from piegraph_cli.evaluation.truth import carry_with_mesh
    from piegraph_cli.stages.images import source_frames

    tracked = inputs["tracks"]["positions"]
    truth = read_truth(context.run, str(context.unit))
    scores: list[tuple[str, float]] = []
    true = np.zeros((0, *tracked.shape[1:]), np.float32)
    if truth is not None:
        rows = source_frames(inputs["frames"])
        true = carry_with_mesh(tracked[0], truth["vertices"][rows], truth["triangles"], 0).astype(np.float32)
        scores = list(score_sequence(inputs, truth.arrays, true, rows))
    at_ends = [value for name, value in scores if name == AT_ENDS]
    quality = [f"{np.mean(at_ends):.1f} mm from the truth at stroke ends"] if at_ends else []
    warnings: list[str] = []
    if params.clicks is not None:
        found, told, warnings = score_clicks(inputs, params.clicks)
        scores += spot_scores(found)
        quality.append(told)
    arrays = {
        "score_name": np.array([name for name, _ in scores], "S128"),
        "score_value": np.array([value for _, value in scores], float),
        "true_positions": true,
    }
    return Output(arrays, "; ".join(quality) or "no truth to score against", warnings)


def score_clicks(inputs: dict[str, Any], file: Path) -> tuple[list["Distance"], str, list[str]]:
    """How far tracked particles carry clicked spots beside later clicks, the same in a line, and what is to be known of it.

    `inputs` are frames, masks and tracks of the sequence. Raises `DataError` naming the line of a click that is none.
    """
    from piegraph_cli.evaluation.scores import told_spots
    from piegraph_cli.evaluation.spots import distances
    from piegraph_cli.recording.clicks import read_clicks

    clicks = read_clicks(file)
    if not clicks:
        raise DataError("has no line of clicks", str(file), "click in piegraph view, or remove the file")
    spots, lost = _spots(clicks, inputs["frames"], inputs["masks"])
    try:
        found = distances(inputs["tracks"]["positions"], spots)
    except DataError as error:
        raise DataError(error.message, f"{file}, {error.where}", error.hint) from None
    warnings = [f"{file}: {text}" for text in lost]
    warnings += [
        f"{file}: spot {name} is placed in one frame only, which tells nothing: click it in later frames too"
        for name, sightings in spots.items()
        if len(sightings) == 1
    ]
    return found, told_spots(found, len({click.camera for click in clicks})), warnings


def _spots(
    clicks: list["Click"], frames: "Artifact", masks: "Artifact"
) -> tuple[dict[str, dict[int, "Sighting"]], list[str]]:
    """Where spots are, by name and frame of the run, and a word on clicks that do not tell where."""
    from piegraph_cli.evaluation.spots import Seen, locate
    from piegraph_cli.recording.images import ImageStack
    from piegraph_cli.stages.images import cameras_of, depth_of

    cameras, depth = {camera.name: (c, camera) for c, camera in enumerate(cameras_of(frames))}, depth_of(frames)
    mask = ImageStack(masks["mask"], masks["mask_offsets"], len(cameras), "mask")
    groups: dict[tuple[str, int], list[Click]] = {}
    for click in clicks:
        groups.setdefault((click.spot, _frame_of(click, cameras, frames["source_frame"])), []).append(click)
    spots: dict[str, dict[int, Sighting]] = {}
    lost = []
    for (name, frame), group in groups.items():
        seen = [
            Seen(camera, (one.column, one.row), depth.depth(frame, c), mask.mask(frame, c))
            for one in group
            for c, camera in [cameras[one.camera]]
        ]
        try:
            sighting = locate(seen)
        except DataError as error:
            lines = ", ".join(one.where.rpartition(", ")[2] for one in group)
            where = f"{group[0].where.rpartition(', ')[0]}, spot {name}, {lines}"
            raise DataError(error.message, where, error.hint) from None
        if sighting is None:
            lost.append(f"spot {name}, frame {group[0].frame}: no sure depth under it: click it in a second camera too")
        else:
            spots.setdefault(name, {})[frame] = sighting
    return spots, lost


def _frame_of(click: "Click", cameras: dict, source: "np.ndarray") -> int:
    """The run's frame of a click. Raises `DataError` for a camera, a frame or a pixel that there is not."""
    import numpy as np

    if click.camera not in cameras:
        raise DataError(f"there is no camera {click.camera}", click.where, f"its cameras are {', '.join(cameras)}")
    c, camera = cameras[click.camera]
    if not (0 <= click.column < camera.width and 0 <= click.row < camera.height):
        message = (
            f"column {click.column:g}, row {click.row:g} is outside the image of {camera.width} x {camera.height} px"
        )
        raise DataError(message, click.where, "click inside the image")
    found = np.flatnonzero(source[:, c] == click.frame)
    if len(found) == 0:
        known = source[source[:, c] >= 0, c]
        hint = f"its images go from {known.min()} to {known.max()}" if len(known) else "it has no images"
        raise DataError(f"camera {click.camera} has no image {click.frame} in this run", click.where, hint)
    return int(found[0])
