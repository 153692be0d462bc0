"""Stage `fuse`: one cloud of the object per frame from all cameras, and whether the hand touches it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.perception.params import FuseParams
from piegraph_cli.workspace.stage import Context, Output, Stage

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.workspace.artifact import Artifact

STAGE = Stage(
    "fuse",
    "fuse the object's cloud",
    ("frames", "hands", "masks"),
    "clouds",
    FuseParams,
    version=5,
    run="piegraph_cli.stages.fuse:run",
)


def run(inputs: dict[str, Any], params: FuseParams, context: Context) -> Output:
    """Fuse one sequence."""
    import numpy as np

    from piegraph_cli.perception.clouds import fuse
    from piegraph_cli.recording.images import ImageStack
    from piegraph_cli.stages.images import cameras_of, depth_of, workspace_of

    frames, masks, hands = inputs["frames"], inputs["masks"], inputs["hands"]
    cameras, depth, workspace = cameras_of(frames), depth_of(frames), workspace_of(frames)
    mask = ImageStack(masks["mask"], masks["mask_offsets"], len(cameras), "mask")
    every = range(len(cameras))
    clouds = []
    for f in context.progress(range(len(frames["time"])), "frames"):
        images = [mask.mask(f, c) for c in every], [depth.depth(f, c) for c in every]
        clouds.append(fuse(*images, cameras, workspace, params.voxel_size))
    sizes = np.array([len(cloud) for cloud in clouds])
    if not sizes.any():
        raise DataError(
            f"no camera sees the object with depth in frames 0 to {len(sizes) - 1}",
            str(frames.path),
            "look at the masks with `piegraph report`; check ingest.workspace",
        )
    touching, held = _handled(hands, clouds, params)
    arrays = {
        "points": np.concatenate(clouds),
        "offsets": np.concatenate([[0], sizes.cumsum()]),
        "end_effector": _holding(hands, held),
        "contact": touching,
        "mode": np.where(held, PICK, PUSH).astype(np.uint8),
        "time": frames["time"],
    }
    quality = f"{np.median(sizes):.0f} points a frame, {(sizes > 0).mean():.0%} of the frames, contact in {touching.mean():.0%}"
    quality += f", {held.mean():.0%} held" if held.any() else ""
    warnings = [] if touching.any() else ["the hand never touches the object: no stroke will be found in this sequence"]
    return Output(arrays, quality, warnings)


def _holding(hands: "Artifact", held: "np.ndarray") -> "np.ndarray":
    """The end-effector's path [F, 3] (m), that of a hand being its pinch where it holds the object."""
    from piegraph_cli.perception.pinch import held_points

    if not held.any() or "opening" in hands:
        return hands["end_effector"]
    return held_points(hands["keypoints"], hands["end_effector"], held)


def _handled(hands: "Artifact", clouds: "Sequence[np.ndarray]", params: FuseParams) -> "tuple[np.ndarray, np.ndarray]":
    """The frames [F] bool of contact, and those in which the object is held."""
    from piegraph_cli.perception.clouds import contact, grasped, while_closed
    from piegraph_cli.perception.pinch import picks, with_picks

    touching = contact(hands["end_effector"], clouds, params.contact_radius)
    if "opening" in hands:
        touching = while_closed(touching, hands["opening"], params.closed)
        return touching, grasped(touching, hands["opening"], params.closed)
    held = picks(hands["landmarks"], hands["end_effector"], clouds, 2 * params.contact_radius)
    return with_picks(touching, held), held
