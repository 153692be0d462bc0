"""Stage `segment`: the object's mask in every image, the hand left out."""

from typing import TYPE_CHECKING, Any

from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.workspace.stage import Context, Output, Stage

if TYPE_CHECKING:
    from piegraph_cli.perception.seeds import ObjectSeed
    from piegraph_cli.workspace.artifact import Artifact

STAGE = Stage(
    "segment",
    "mask the object",
    ("frames", "hands"),
    "masks",
    SegmentParams,
    version=3,
    run="piegraph_cli.stages.segment:run",
)


def run(inputs: dict[str, Any], params: SegmentParams, context: Context) -> Output:
    """Segment one sequence."""
    import numpy as np

    from piegraph_cli.perception.object_masks import follow_object, seed_object
    from piegraph_cli.recording.images import encode_masks
    from piegraph_cli.stages.images import cameras_of, color_of, depth_of, workspace_of

    frames, hands = inputs["frames"], inputs["hands"]
    if "mask" in frames.arrays and not params.prompts and not params.points:
        return _recorded(frames)
    cameras, count = cameras_of(frames), len(frames["time"])
    color = [color_of(frames).of_camera(c) for c in range(len(cameras))]
    depth = [depth_of(frames).of_camera(c, "depth") for c in range(len(cameras))]
    hand_px, tips = hands["landmarks"].astype(np.float64), hands["end_effector"].astype(np.float64)
    given = color, depth, cameras, hand_px, workspace_of(frames), params, tips
    seed = seed_object(*given)
    masks = follow_object(*given, seed, progress=context.counting(len(cameras) * count, "images"))
    area = np.stack([m.sum((1, 2)) for m in masks], 1)
    data, offsets = encode_masks(masks[c][f] for f in range(count) for c in range(len(cameras)))
    found = (area > 0).any(1).mean()
    quality = (
        f"object in {found:.0%} of {count} frames, {(area > 0).mean():.0%} of the images, {np.median(area):.0f} px"
    )
    warnings = [*seed.warnings, *_picture(seed, color, cameras, context)]
    return Output({"mask": data, "mask_offsets": offsets, "area": area, "time": frames["time"]}, quality, warnings)


def _picture(seed: "ObjectSeed", color, cameras, context: Context) -> list[str]:
    """Where something is to be known of the choice, a picture of it in RUN/report, and the line that says so."""
    from PIL import Image

    from piegraph_cli.evaluation.overlays import draw_things, label, tile
    from piegraph_cli.files import atomic_file

    if not seed.warnings:
        return []
    things = [seed.masks, *(part.masks for part in seed.others)]
    row = [
        label(draw_things(color[c][seed.frame], [masks[c] for masks in things]), f"{camera.name}, frame {seed.frame}")
        for c, camera in enumerate(cameras)
    ]
    path = context.run.folder / "report" / f"{context.unit}_object.png"
    path.parent.mkdir(exist_ok=True)
    with atomic_file(path) as temporary:
        Image.fromarray(tile([row[: len(row) // 2], row[len(row) // 2 :]] if len(row) > 2 else [row])).save(
            temporary, "PNG"
        )
    return [f"{path} shows what was taken (1) and what else lies there"]


def _recorded(frames: "Artifact") -> Output:
    """The masks that came with the recording; empty ones for images without."""
    import numpy as np

    from piegraph_cli.recording.images import ImageStack, encode_masks

    sizes, count = frames["image_size"], len(frames["time"])
    stack = ImageStack(frames["mask"], frames["mask_offsets"], len(sizes), "mask")
    masks = [
        stack.mask(f, c) if stack.has(f, c) else np.zeros(sizes[c][::-1], bool)
        for f in range(count)
        for c in range(len(sizes))
    ]
    area = np.array([mask.sum() for mask in masks]).reshape(count, -1)
    data, offsets = encode_masks(masks)
    quality = f"masks of the recording, in {(area > 0).mean():.0%} of the images, {np.median(area):.0f} px"
    lost = int((~(area > 0).any(1)).sum())
    warnings = [f"{lost} of {count} frames have no mask in the recording"] if lost else []
    return Output({"mask": data, "mask_offsets": offsets, "area": area, "time": frames["time"]}, quality, warnings)
