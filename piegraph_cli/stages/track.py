"""Stage `track`: material particles that follow the object through its clouds."""

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError
from piegraph_cli.params import mode_number
from piegraph_cli.physics.params import TrackParams
from piegraph_cli.workspace.stage import Context, Output, Stage

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.physics.tracking import TrackResult

STAGE = Stage(
    "track", "track particles", ("clouds",), "tracks", TrackParams, version=2, run="piegraph_cli.stages.track:run"
)

POOR = 0.008
"""Metres of residual above which the user is warned."""


def track_clouds(
    clouds: "Sequence[np.ndarray]",
    params: TrackParams = TrackParams(),
    *,
    hand: "np.ndarray | None" = None,
    grasp: "np.ndarray | None" = None,
    progress: Callable[..., Iterable] = iter,
) -> "TrackResult":
    """Follow material points of an object through its clouds, [P, 3] metres each, z up, the table at z = 0.

    `hand` [F, 3] (m) and `grasp` [F]: where the hand is, and whether it holds the object, for picks. Raises `DataError` for
    points that are not finite, naming the frame, and for a first cloud with too few of them. Source: paper, III-D.
    """
    from piegraph_cli.physics.tracking import track
    from piegraph_cli.process import set_up_torch

    set_up_torch()
    return track(clouds, params, hand, grasp, progress)


def run(inputs: dict[str, Any], params: TrackParams, context: Context) -> Output:
    """Track one sequence."""
    import numpy as np

    source = inputs["clouds"]
    clouds = np.split(source["points"], source["offsets"][1:-1])
    held = {"hand": source["end_effector"], "grasp": source["contact"]} if params.mode == "pick" else {}
    try:
        tracked = track_clouds(clouds, params, progress=lambda c: context.progress(c, "track", len(clouds)), **held)
    except DataError as error:
        raise DataError(error.message, f"{source.path}, {error.where or 'frame 0'}", error.hint) from None
    frames = len(clouds)
    arrays = {
        "positions": tracked.positions,
        "residual": tracked.residual,
        "visibility": tracked.weight,
        "mode": np.full(frames, mode_number(params.mode)),
        "end_effector": source["end_effector"],
        "contact": source["contact"],
        "time": source["time"],
    }
    residual = float(np.median(tracked.residual[~tracked.held])) if not tracked.held.all() else float("nan")
    quality = f"{frames} frames, residual {residual * 1000:.1f} mm (no accuracy: see docs/method.md)"
    warnings = []
    if tracked.held.any():
        warnings.append(
            f"{tracked.held.sum()} frames without a cloud, first {int(tracked.held.argmax())}: particles held still"
        )
    if residual > POOR:
        warnings.append(f"residual {residual * 1000:.1f} mm: look at the clouds with `piegraph report`")
    return Output(arrays, quality, warnings)
