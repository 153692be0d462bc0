"""Stage `track`: material particles that follow the object through its clouds."""

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError
from piegraph_cli.params import PICK, PUSH, mode_number
from piegraph_cli.physics.params import TrackParams
from piegraph_cli.workspace.stage import Context, Output, Stage

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.physics.tracking import TrackResult
    from piegraph_cli.physics.visibility import View
    from piegraph_cli.workspace.artifact import Artifact

STAGE = Stage(
    "track",
    "track particles",
    ("frames", "masks", "clouds"),
    "tracks",
    TrackParams,
    version=6,
    run="piegraph_cli.stages.track:run",
)

UNTOLD = 1
"""Frames from the last in which the hand was seen, or to the next, that a hand that holds the object still leads it."""

DOUBTFUL = 0.015
"""Metres of expected error above which the user is told where to look."""


def track_clouds(
    clouds: "Sequence[np.ndarray]",
    params: TrackParams = TrackParams(),
    *,
    hand: "np.ndarray | None" = None,
    grasp: "np.ndarray | None" = None,
    views: "Sequence[Sequence[View]] | None" = None,
    time: "np.ndarray | None" = None,
    progress: Callable[..., Iterable] = iter,
) -> "TrackResult":
    """Follow material points of an object through its clouds, [P, 3] metres each, z up, the table at z = 0.

    `hand` [F, 3] (m) and `grasp` [F]: where the hand is, and whether it holds the object, for picks. `views`: per frame
    what each camera sees; without them everything counts as seen. `time` [F] (s, by default 5 Hz). Raises `DataError` for
    points that are not finite, naming the frame, and for a first cloud with too few of them. Source: paper, III-D.
    """
    from piegraph_cli.physics.tracking import track
    from piegraph_cli.process import set_up_torch

    set_up_torch()
    return track(clouds, params, hand, grasp, progress, views, time)


def run(inputs: dict[str, Any], params: TrackParams, context: Context) -> Output:
    """Track one sequence."""
    import numpy as np

    from piegraph_cli.stages.images import Views

    source = inputs["clouds"]
    clouds = np.split(source["points"], source["offsets"][1:-1])
    mode, held = _handling(source, params)
    views = Views(inputs["frames"], inputs["masks"])
    try:
        tracked = track_clouds(
            clouds,
            params,
            views=views,
            time=source["time"],
            progress=lambda c: context.progress(c, "frames", len(clouds)),
            **held,
        )
    except DataError as error:
        raise DataError(error.message, f"{source.path}, {error.where or 'frame 0'}", error.hint) from None
    frames, told = len(clouds), ", a sheet" if tracked.sheet else ""
    arrays = {
        "positions": tracked.positions,
        "residual": tracked.residual,
        "visibility": tracked.weight,
        "mode": mode,
        "end_effector": source["end_effector"],
        "contact": source["contact"],
        "time": source["time"],
    }
    if params.association == "nearest":  # what slides along the surface lies as well in the cloud as what does not
        told = f"residual {tracked.residual.mean() * 1000:.1f} mm; how far off is not known: particles slide"
        return Output(arrays, f"{frames} frames, {told}", _lost(tracked))
    arrays |= {"trust/doubt": tracked.doubt, "trust/misfit": tracked.misfit}
    quality = f"{frames} frames{told}, expected error {tracked.doubt.mean() * 1000:.1f} mm"
    return Output(arrays, quality, _lost(tracked) + _doubts(tracked))


def _handling(source: "Artifact", params: TrackParams) -> "tuple[np.ndarray, dict[str, np.ndarray]]":
    """Of clouds, each frame's mode [F], and where there are picks the hand [F, 3] (m) and whether it holds [F]."""
    import numpy as np

    frames = len(source["time"])
    if params.mode == "auto":
        mode = source["mode"] if "mode" in source else np.full(frames, PUSH)
    else:
        mode = np.full(frames, mode_number(params.mode))
    grasp = source["contact"] & (mode == PICK) & _told(source["end_effector"])
    return mode, {"hand": _filled(source["end_effector"]), "grasp": grasp} if grasp.any() else {}


def _told(hand: "np.ndarray") -> "np.ndarray":
    """Frames [F] bool in which a hand's path [F, 3] (m) is known, or soon before and soon after: not where a straight line
    would stand for a whole stroke."""
    import numpy as np

    known = np.flatnonzero(np.isfinite(hand).all(1))
    apart = np.abs(np.arange(len(hand))[:, None] - known[None]) if len(known) else np.full((len(hand), 1), len(hand))
    return apart.min(1) <= UNTOLD


def _filled(hand: "np.ndarray") -> "np.ndarray":
    """The hand's path [F, 3] (m) on straight lines where it is not known, as it may be while it holds the object."""
    import numpy as np

    frames, known = np.arange(len(hand)), np.isfinite(hand).all(1)
    if not known.any():
        return hand
    return np.stack([np.interp(frames, frames[known], axis[known]) for axis in hand.T], 1).astype(hand.dtype)


def _lost(tracked: "TrackResult") -> list[str]:
    """Words on frames without a cloud, and on a lost object."""
    warnings = []
    if tracked.held.any():
        first = int(tracked.held.argmax())
        warnings.append(f"{tracked.held.sum()} frames without a cloud, first {first}: particles held still")
    if tracked.lost.any():
        first = int(tracked.lost.argmax())
        end = "; it is not found again, so the sequence ends there" if tracked.lost[first:].all() else ""
        warnings.append(
            f"{tracked.lost.sum()} frames in which the object is not where it can be, first {first}: no examples{end}"
        )
    return warnings


def _doubts(tracked: "TrackResult") -> list[str]:
    """A word on where to look, where much is in doubt."""
    mean, worst = tracked.doubt.mean(), int(tracked.doubt.argmax())
    if mean <= DOUBTFUL:
        return []
    return [f"expected error {mean * 1000:.1f} mm: look at frame {worst} with `piegraph report`"]
