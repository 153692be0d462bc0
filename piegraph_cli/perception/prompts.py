"""The object as a user points it out: boxes and points in the first frame, carried to other cameras by their place."""

from collections.abc import Sequence

import numpy as np

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.perception.choice import Chooser
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.parts import CELL, Part, View, boxed, cells, masks_near, parts_of, view_of
from piegraph_cli.perception.seeds import ObjectSeed
from piegraph_cli.recording.camera import Camera

MOST = 0.5
"""Share of a part's pixels inside a box from which the box means it."""
NEAR_POINT = 0.015
"""Distance (m) on the table from a part at which a point still means it."""


def check_prompts(params: SegmentParams, cameras: Sequence[Camera]) -> None:
    """Raise UsageError where a prompt names no camera, or is no box or point of its image."""
    by_name = {camera.name: camera for camera in cameras}
    for setting, prompts in (("prompts", params.prompts), ("points", params.points)):
        for name, pixels in prompts.items():
            if name not in by_name:
                known = ", ".join(by_name)
                raise UsageError(
                    f"segment.{setting} names no camera of this recording: {name}", hint=f"its cameras are {known}"
                )
            size = by_name[name].width, by_name[name].height
            low, high = pixels[:2], pixels[-2:]
            outside = high[0] < 0 or high[1] < 0 or low[0] >= size[0] or low[1] >= size[1]
            if outside or (len(pixels) == 4 and (low[0] >= high[0] or low[1] >= high[1])):
                raise UsageError(
                    f"segment.{setting}.{name} = {list(pixels)} is not inside the image of {size[0]} x {size[1]} px",
                    hint="a box is left, top, right, bottom; a point is column, row",
                )


def prompted_object(
    images: Sequence[Sequence[np.ndarray]],
    depths: Sequence[Sequence[np.ndarray]],
    cameras: Sequence[Camera],
    hand_px: np.ndarray,
    workspace: np.ndarray,
    params: SegmentParams,
    tips: np.ndarray,
) -> ObjectSeed:
    """The object in the first frame that `params.prompts` and `params.points` mean; arguments as `seeds.find_object`.

    Whole parts are taken that lie mostly inside every box, or under a point; else what of the boxes stands out. Cameras
    without a prompt get what lies at the same place of the table. Raises DataError where a prompt meets nothing.
    """
    views = [
        view_of(images[c][0], depths[c][0], camera, hand_px[0, c], workspace, params)
        for c, camera in enumerate(cameras)
    ]
    parts = parts_of(views, workspace, params)
    boxes = {c: _inside(params.prompts[k.name], k) for c, k in enumerate(cameras) if k.name in params.prompts}
    meant = [part for part in parts if boxes and all(_share(part.masks[c], box) >= MOST for c, box in boxes.items())]
    for c, camera in enumerate(cameras):
        if camera.name in params.points:
            meant.append(_under(params.points[camera.name], parts, views[c], cameras, c))
    for c, box in boxes.items():
        if not (views[c].candidates & box).any():
            raise _missed(f"segment.prompts.{cameras[c].name}", parts, cameras)
    whole = [np.logical_or.reduce(seen) for seen in zip(*(part.masks for part in meant), strict=True)]
    masks = whole or _boxed_masks(views, boxes, workspace)
    chooser = Chooser(images, depths, cameras, tips, params)
    beside = [part for part in parts if not any((a & b).any() for a, b in zip(part.masks, masks, strict=True))]
    return ObjectSeed(0, masks, [part for part in beside if chooser.trait(0, part).thing])


def _inside(box: Sequence[float], camera: Camera) -> np.ndarray:
    columns, rows = np.arange(camera.width), np.arange(camera.height)[:, None]
    return (columns >= box[0]) & (columns <= box[2]) & (rows >= box[1]) & (rows <= box[3])


def _share(mask: np.ndarray, box: np.ndarray) -> float:
    return float((mask & box).sum() / max(mask.sum(), 1))


def _boxed_masks(views: Sequence[View], boxes: dict[int, np.ndarray], workspace: np.ndarray) -> list[np.ndarray]:
    """What of the boxes stands out, and what other cameras see at the same place."""
    from scipy.ndimage import distance_transform_edt

    low, high = np.asarray(workspace, float)[:2].T
    shape = tuple(np.ceil((high - low) / CELL).astype(int) + 1)
    footprint = np.logical_or.reduce(
        [cells(views[c].points[views[c].candidates & box], low, shape) for c, box in boxes.items()]
    )
    masks = masks_near(views, distance_transform_edt(~footprint) * CELL, low)
    for c, box in boxes.items():
        masks[c] = views[c].candidates & box
    return masks


def _under(point: Sequence[float], parts: Sequence[Part], view: View, cameras: Sequence[Camera], c: int) -> Part:
    """The part under a point [2] (px): the one whose mask holds it, else the nearest on the table."""
    height, width = view.candidates.shape
    column, row = int(np.clip(round(point[0]), 0, width - 1)), int(np.clip(round(point[1]), 0, height - 1))
    for part in parts:
        if part.masks[c][row, column]:
            return part
    place = view.points[row, column][None, :2]
    near = min(parts, key=lambda part: part.distance(place)[0], default=None)
    if near is None or near.distance(place)[0] > NEAR_POINT:
        raise _missed(f"segment.points.{cameras[c].name}", parts, cameras)
    return near


def _missed(prompt: str, parts: Sequence[Part], cameras: Sequence[Camera]) -> DataError:
    found = "; ".join(box for box in (boxed(part, cameras) for part in parts) if box)
    return DataError(
        f"{prompt} meets nothing that stands out from the table in the first frame",
        f"cameras {', '.join(camera.name for camera in cameras)}",
        f"what stands out has the boxes {found}" if found else "check ingest.workspace, or lower --min-contrast",
    )
