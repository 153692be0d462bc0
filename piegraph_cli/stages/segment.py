"""Stage `segment`: the object's mask in every image, the hand left out."""

from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import UsageError
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.workspace.stage import Context, Output, Stage

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.perception.object_masks import Images
    from piegraph_cli.perception.seeds import ObjectSeed
    from piegraph_cli.recording.camera import Camera
    from piegraph_cli.workspace.artifact import Artifact
    from piegraph_cli.workspace.run import Run

    Given = tuple[Images, Images, list[Camera], np.ndarray, np.ndarray, SegmentParams, np.ndarray]


def _settings(run: "Run", unit: str) -> SegmentParams:
    """One sequence does not depend on the prompts of others. Raises `UsageError` for those of a sequence that is none."""
    params: SegmentParams = run.params(STAGE.name)
    unknown = sorted(params.sequences() - {*run.units(STAGE), *run.params("ingest").exclude})
    if unknown:
        names = ", ".join(str(name) for name in run.units(STAGE))
        message = f"segment.prompts or segment.points: there is no sequence {unknown[0]}"
        raise UsageError(message, str(run.folder / "recipe.toml"), f"sequences are {names}")
    return params.of(unit)


STAGE = Stage(
    "segment",
    "mask the object",
    ("frames", "hands"),
    "masks",
    SegmentParams,
    version=3,
    run="piegraph_cli.stages.segment:run",
    settings=_settings,
)


def run(inputs: dict[str, Any], params: SegmentParams, context: Context) -> Output:
    """Segment one sequence."""
    import numpy as np

    from piegraph_cli.perception.object_masks import follow_object, seed_object
    from piegraph_cli.recording.images import encode_masks

    frames, hands = inputs["frames"], inputs["hands"]
    if "mask" in frames.arrays and not params.prompts and not params.points:
        return _recorded(frames)
    given = _given(frames, hands, params)
    color, _, cameras, *_ = given
    count = len(frames["time"])
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


def _given(frames: "Artifact", hands: "Artifact", params: SegmentParams) -> "Given":
    """What finding and following the object need of a sequence."""
    import numpy as np

    from piegraph_cli.stages.images import cameras_of, color_of, depth_of, workspace_of

    cameras = cameras_of(frames)
    color = [color_of(frames).of_camera(c) for c in range(len(cameras))]
    depth = [depth_of(frames).of_camera(c, "depth") for c in range(len(cameras))]
    hand_px, tips = hands["landmarks"].astype(np.float64), hands["end_effector"].astype(np.float64)
    return color, depth, cameras, hand_px, workspace_of(frames), params, tips


def foresee_masks(
    frames: "Artifact", hands: "Artifact", params: SegmentParams
) -> tuple[int, list["np.ndarray"], list[str]]:
    """What `run` would make of one frame, the one in which it finds the object: its number, the mask [H, W] bool in each
    camera, and the warnings. Raises as `run` does.
    """
    from piegraph_cli.perception.object_masks import follow_object, seed_object

    if "mask" in frames.arrays and not params.prompts and not params.points:
        return 0, _recorded_masks(frames, 0), []
    given = _given(frames, hands, params)
    seed = seed_object(*given)
    masks = follow_object(*given, seed, within=range(seed.frame, seed.frame + 1))
    return seed.frame, [of_camera[seed.frame] for of_camera in masks], list(seed.warnings)


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


def _recorded_masks(frames: "Artifact", frame: int) -> list["np.ndarray"]:
    """The masks of a frame that came with the recording."""
    import numpy as np

    from piegraph_cli.recording.images import ImageStack

    sizes = frames["image_size"]
    stack = ImageStack(frames["mask"], frames["mask_offsets"], len(sizes), "mask")
    return [stack.mask(frame, c) if stack.has(frame, c) else np.zeros(size[::-1], bool) for c, size in enumerate(sizes)]


def _recorded(frames: "Artifact") -> Output:
    """The masks that came with the recording; empty ones for images without."""
    import numpy as np

    from piegraph_cli.recording.images import encode_masks

    count = len(frames["time"])
    masks = [mask for f in range(count) for mask in _recorded_masks(frames, f)]
    area = np.array([mask.sum() for mask in masks]).reshape(count, -1)
    data, offsets = encode_masks(masks)
    quality = f"masks of the recording, in {(area > 0).mean():.0%} of the images, {np.median(area):.0f} px"
    lost = int((~(area > 0).any(1)).sum())
    warnings = [f"{lost} of {count} frames have no mask in the recording"] if lost else []
    return Output({"mask": data, "mask_offsets": offsets, "area": area, "time": frames["time"]}, quality, warnings)
