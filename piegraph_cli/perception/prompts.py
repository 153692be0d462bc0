"""The object as a user points it out: boxes and points in the first frame, carried to other cameras by their place."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.perception.apart import apart_elsewhere
from piegraph_cli.perception.choice import Choice, Chooser
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.parts import CELL, Part, View, boxed, cells, masks_near, parts_of, view_of
from piegraph_cli.perception.reach import as_setting, box_to_hold, told_cut, widened
from piegraph_cli.perception.seeds import UNCLEAR, ObjectSeed
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
    without a prompt get what lies at the same place of the table. Raises DataError where a prompt meets nothing, with
    the workspace that would hold what it means.
    """

    def views_in(f: int, box: np.ndarray = workspace) -> list[View]:
        return [view_of(images[c][f], depths[c][f], k, hand_px[f, c], box, params) for c, k in enumerate(cameras)]

    def parts_in(f: int, box: np.ndarray = workspace) -> list[Part]:
        return parts_of(views_in(f, box), box, params)

    views = views_in(0)
    parts = parts_of(views, workspace, params)
    try:
        meant = _meant(params, parts, views, cameras)
    except DataError as error:
        raise _beyond(error, params, views_in(0, widened(workspace)), cameras, workspace) from None
    boxes = _boxes(params, cameras)
    chooser = Chooser(images, depths, cameras, tips, params)
    if len(meant) == 1 and not boxes:
        found = apart_elsewhere(chooser, 0, Choice(meant[0], UNCLEAR), parts_in)
        if found is not None:
            return _clicked(*found, params.points, cameras)
    whole = [np.logical_or.reduce(seen) for seen in zip(*(part.masks for part in meant), strict=True)]
    masks = whole or _boxed_masks(views, boxes, workspace)
    beside = [part for part in parts if not any((a & b).any() for a, b in zip(part.masks, masks, strict=True))]
    cut = [warning for part in meant for warning in told_cut(part, workspace, partial(parts_in, 0))]
    return ObjectSeed(0, masks, [part for part in beside if chooser.trait(0, part).thing], warnings=cut)


def _boxes(params: SegmentParams, cameras: Sequence[Camera]) -> dict[int, np.ndarray]:
    """The inside [H, W] of each camera's box."""
    return {c: _inside(params.prompts[k.name], k) for c, k in enumerate(cameras) if k.name in params.prompts}


def _meant(
    params: SegmentParams, parts: Sequence[Part], views: Sequence[View], cameras: Sequence[Camera]
) -> list[Part]:
    """The whole parts that the prompts mean; none where a box cuts something. Raises DataError where one meets nothing."""
    boxes = _boxes(params, cameras)
    meant = [part for part in parts if boxes and all(_share(part.masks[c], box) >= MOST for c, box in boxes.items())]
    for c, camera in enumerate(cameras):
        if camera.name in params.points:
            meant.append(_under(params.points[camera.name], parts, views[c], cameras, c))
    for c, box in boxes.items():
        if not (views[c].candidates & box).any():
            raise _missed(f"segment.prompts.{cameras[c].name}", parts, cameras)
    return meant


def _beyond(
    error: DataError, params: SegmentParams, views: Sequence[View], cameras: Sequence[Camera], workspace: np.ndarray
) -> DataError:
    """The error of prompts that mean something in the views of a wider workspace alone; else the error as it was."""
    parts = parts_of(views, widened(workspace), params)
    try:
        meant = _meant(params, parts, views, cameras)
    except DataError:
        return error
    if not meant:
        return error
    box = workspace
    for part in meant:
        box = box_to_hold(part, box)
    return DataError(
        "what the prompt means lies outside the workspace",
        f"cameras {', '.join(camera.name for camera in cameras)}, frame 0",
        f"ingest.workspace = {as_setting(box)} would hold it",
    )


def _clicked(
    frame: int, choice: Choice, points: Mapping[str, Sequence[float]], cameras: Sequence[Camera]
) -> ObjectSeed:
    """Which of two things that a click took for one it means: the one that stays, if that lies under it."""
    things = [choice.part, *choice.others]
    stays = [
        part
        for part in choice.others
        for c, k in enumerate(cameras)
        if k.name in points
        if _holds(part, points[k.name], c)
    ]
    meant = stays[0] if stays else choice.part
    return ObjectSeed(frame, meant.masks, [part for part in things if part is not meant])


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
    row, column = _pixel(point, view.candidates.shape)
    for part in parts:
        if part.masks[c][row, column]:
            return part
    place = view.points[row, column][None, :2]
    near = min(parts, key=lambda part: part.distance(place)[0], default=None)
    if near is None or near.distance(place)[0] > NEAR_POINT:
        raise _missed(f"segment.points.{cameras[c].name}", parts, cameras)
    return near


def _pixel(point: Sequence[float], shape: tuple[int, ...]) -> tuple[int, int]:
    return int(np.clip(round(point[1]), 0, shape[0] - 1)), int(np.clip(round(point[0]), 0, shape[1] - 1))


def _holds(part: Part, point: Sequence[float], c: int) -> bool:
    return bool(part.masks[c][_pixel(point, part.masks[c].shape)])


def _missed(prompt: str, parts: Sequence[Part], cameras: Sequence[Camera]) -> DataError:
    found = "; ".join(box for box in (boxed(part, cameras) for part in parts) if box)
    return DataError(
        f"{prompt} meets nothing that stands out from the table in the first frame",
        f"cameras {', '.join(camera.name for camera in cameras)}",
        f"what stands out has the boxes {found}" if found else "check ingest.workspace, or lower --min-contrast",
    )
