"""The object's masks in all images: where it is first, by prompts or by itself, and its mask in every camera from there."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from piegraph_cli.errors import MissingError
from piegraph_cli.perception import sam, segmentation
from piegraph_cli.perception.others import without_others
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.prompts import check_prompts, prompted_object
from piegraph_cli.perception.seeds import ObjectSeed, find_object
from piegraph_cli.recording.camera import Camera

Images = Sequence[Sequence[np.ndarray]]
"""`[camera][frame]`, read lazily."""


def seed_object(
    color: Images,
    depth: Images,
    cameras: Sequence[Camera],
    hand_px: np.ndarray,
    workspace: np.ndarray,
    params: SegmentParams,
    tips: np.ndarray,
) -> ObjectSeed:
    """Where the object is first: where prompts say, else found by geometry, touch and motion.

    Arguments as `seeds.find_object`. Raises `UsageError` for prompts that are none, `DataError` where nothing is found.
    """
    check_prompts(params, cameras)
    if params.segmenter == "sam" and not params.points and set(params.prompts) == {c.name for c in cameras}:
        return ObjectSeed(0, [np.zeros((camera.height, camera.width), bool) for camera in cameras])
    find = prompted_object if params.prompts or params.points else find_object
    return find(color, depth, cameras, hand_px, workspace, params, tips)


def follow_object(
    color: Images,
    depth: Images,
    cameras: Sequence[Camera],
    hand_px: np.ndarray,
    workspace: np.ndarray,
    params: SegmentParams,
    tips: np.ndarray,
    seed: ObjectSeed,
    over: Callable[[Callable[[int], np.ndarray], Iterable[int]], Iterable[np.ndarray]] = map,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
    within: range | None = None,
) -> list[np.ndarray]:
    """The object's masks from its seed on: one [F, H, W] bool for each camera.

    Arguments as `seed_object`; `over` is `map` or what does its work, `progress` gives the frames it is given; in frames
    that are not `within` masks are empty.
    Raises `DataError` for a camera that does not see the object, `MissingError` for a segmenter without weights.
    """
    network = _network(params) if params.segmenter == "sam" else None
    images, depths = without_others(color, depth, cameras, seed)

    def masks_of(c: int) -> np.ndarray:
        given = (images[c], depths[c], cameras[c], hand_px[:, c], workspace, seed.frame, seed.masks[c], params, tips)
        if network is None:
            return segmentation.segment_sequence(*given, progress=progress, within=within)
        box = params.prompts.get(cameras[c].name)
        prompt = sam.SamPrompt(box=box) if box else None
        return sam.segment_sequence(
            network, *given, key_every=params.sam_every, prompt=prompt, progress=progress, within=within
        )

    return list(over(masks_of, range(len(cameras))))


def _network(params: SegmentParams) -> Any:
    from piegraph_cli.perception.sam_models import load_sam

    if params.sam_checkpoint is None:
        raise MissingError(
            "--segmenter sam needs weights",
            "segment.sam_checkpoint",
            "piegraph doctor --fetch sam-vit-b, then --sam-checkpoint with the file it names",
        )
    return load_sam(params.sam_checkpoint, params.sam_model)
