"""Stage `segment`: the object's mask in every image, the hand left out."""

from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import MissingError
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
    version=2,
    run="piegraph_cli.stages.segment:run",
)


def run(inputs: dict[str, Any], params: SegmentParams, context: Context) -> Output:
    """Segment one sequence."""
    import numpy as np

    from piegraph_cli.perception import sam, segmentation
    from piegraph_cli.perception.others import without_others
    from piegraph_cli.recording.images import encode_masks
    from piegraph_cli.stages.images import cameras_of, color_of, depth_of, workspace_of

    frames, hands = inputs["frames"], inputs["hands"]
    if "mask" in frames.arrays and not params.prompts and not params.points:
        return _recorded(frames)
    cameras, count = cameras_of(frames), len(frames["time"])
    color = [color_of(frames).of_camera(c) for c in range(len(cameras))]
    depth = [depth_of(frames).of_camera(c, "depth") for c in range(len(cameras))]
    hand_px = hands["landmarks"].astype(np.float64)
    workspace = workspace_of(frames)
    seed = _seed(params, color, depth, cameras, hand_px, workspace, hands["end_effector"].astype(np.float64))
    network = _network(params) if params.segmenter == "sam" else None
    masks = []
    images, depths = without_others(color, depth, cameras, seed)
    for c, camera in enumerate(context.progress(cameras, "segment", len(cameras))):
        given = (images[c], depths[c], camera, hand_px[:, c], workspace, seed.frame, seed.masks[c], params)
        if network is None:
            masks.append(segmentation.segment_sequence(*given))
        else:
            box = params.prompts.get(camera.name)
            prompt = sam.SamPrompt(box=box) if box else None
            masks.append(sam.segment_sequence(network, *given, key_every=params.sam_every, prompt=prompt))
    area = np.stack([m.sum((1, 2)) for m in masks], 1)
    data, offsets = encode_masks(masks[c][f] for f in range(count) for c in range(len(cameras)))
    found = (area > 0).any(1).mean()
    quality = (
        f"object in {found:.0%} of {count} frames, {(area > 0).mean():.0%} of the images, {np.median(area):.0f} px"
    )
    return Output({"mask": data, "mask_offsets": offsets, "area": area, "time": frames["time"]}, quality, seed.warnings)


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


def _network(params: SegmentParams) -> Any:
    from piegraph_cli.perception.sam_models import load_sam

    if params.sam_checkpoint is None:
        raise MissingError(
            "--segmenter sam needs weights",
            "segment.sam_checkpoint",
            "piegraph doctor --fetch sam-vit-b, then --sam-checkpoint with the file it names",
        )
    return load_sam(params.sam_checkpoint, params.sam_model)


def _seed(params: SegmentParams, color, depth, cameras, hand_px, workspace, tips) -> "ObjectSeed":
    """Where the object is first: where prompts say, else found by geometry, touch and motion."""
    import numpy as np

    from piegraph_cli.perception.prompts import check_prompts, prompted_object
    from piegraph_cli.perception.seeds import ObjectSeed, find_object

    check_prompts(params, cameras)
    if params.segmenter == "sam" and not params.points and set(params.prompts) == {c.name for c in cameras}:
        return ObjectSeed(0, [np.zeros((camera.height, camera.width), bool) for camera in cameras])
    find = prompted_object if params.prompts or params.points else find_object
    return find(color, depth, cameras, hand_px, workspace, params, tips)
