"""The pictures of one sequence: what the cameras see with masks, hand and particles, the cloud, errors over time."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piegraph_cli.evaluation import figures, overlays
from piegraph_cli.evaluation.top_view import Moment, draw_moment, extent
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.report.pictures import LEVELS, Level, Picture, image_picture, shrink, spread
from piegraph_cli.report.svg import svg_of
from piegraph_cli.stages.images import cameras_of, color_of
from piegraph_cli.workspace.artifact import Artifact

FRAMES = (
    *("color", "color_offsets", "time", "camera_name"),
    *("image_size", "K", "distortion", "depth_scale", "T_world_camera"),
)
"""What pictures need of a frames artifact: all but depth."""
HAND = np.array([overlays.HAND_COLOR], np.uint8)
TOP_SIZE = 300
"""Pixels of a view from above."""
BYTES_A_PIXEL = 0.05
"""Of an image as WebP, at least: what needs more than there is room for is not drawn first."""


@dataclass(frozen=True)
class Seen:
    """What is fresh of one sequence."""

    name: str
    frames: Artifact | None = None
    hands: Artifact | None = None
    masks: Artifact | None = None
    clouds: Artifact | None = None
    tracks: Artifact | None = None
    scores: Artifact | None = None

    @cached_property
    def time(self) -> np.ndarray:
        """Of each frame (s)."""
        return next((a["time"] for a in (self.frames, self.tracks, self.clouds) if a is not None), np.zeros(0))

    @cached_property
    def contact(self) -> np.ndarray | None:
        """Frames in which the hand touches the object, where that is known."""
        return next((a["contact"] for a in (self.tracks, self.clouds) if a is not None), None)

    @cached_property
    def true(self) -> np.ndarray | None:
        """Where the tracked particles truly are [F, N, 3] (m), where that is known."""
        if self.scores is None or self.tracks is None or not len(self.scores["true_positions"]):
            return None
        return self.scores["true_positions"]

    def moments(self, count: int) -> list[int]:
        """Frames to show: the first, and the ends of the first contacts; spread where nothing is known of contacts."""
        if self.contact is None or not self.contact.any():
            return spread(len(self.time), count)
        ends = np.flatnonzero(self.contact & ~np.append(self.contact[1:], False))
        return sorted({0, *ends[: count - 1].tolist()})


def draw_sequence(seen: Seen, share: int, mark: str) -> list[Picture]:
    """The pictures of a sequence in `share` bytes: as much of it as there is room for; ids in plots begin with `mark`."""
    most = 0 if seen.frames is None else len(seen.frames["camera_name"])
    drawn: list[Picture] = []
    for level in LEVELS:
        cells = level.moments * most + level.film
        if level is not LEVELS[-1] and cells * level.width**2 * 0.75 * BYTES_A_PIXEL > share:
            continue
        drawn = [*_images(seen, level), *_views(seen, level), *_plot(seen, level, mark)]
        if sum(picture.bytes for picture in drawn) * 3 / 4 <= share:
            return drawn
    return drawn[:1]


def _images(seen: Seen, level: Level) -> Iterator[Picture]:
    """A film of the camera that sees most of the object, with the particles; a sheet of all cameras with the masks."""
    if seen.frames is None:
        return
    cameras, color = cameras_of(seen.frames), color_of(seen.frames)
    best = int(np.argmax(seen.masks["area"].mean(0))) if seen.masks is not None else 0
    followed, masked = _painter(seen, seen.tracks is None), _painter(seen, True)

    def cell(f: int, c: int, painter: Painter) -> np.ndarray:
        image = painter.paint(shrink(color.color(f, c), level.width), f, c)
        return overlays.label(image, f"{cameras[c].name}  {seen.time[f]:.1f} s")

    shown = spread(len(seen.time), level.film)
    if len(shown) > 1:
        alt, times = f"{seen.name}: camera {cameras[best].name}, {followed.what}", [float(seen.time[f]) for f in shown]
        yield _film([cell(f, best, followed) for f in shown], times, alt, f"{cameras[best].name}: {followed.what}")
    moments = seen.moments(level.moments)
    times_ = ", ".join(f"{seen.time[f]:.1f}" for f in moments)
    sheet = overlays.tile([[cell(f, c, masked) for c in range(len(cameras))] for f in moments])
    alt = f"{seen.name}: {len(cameras)} cameras at {times_} s, {masked.what}"
    yield image_picture(sheet, alt, f"All cameras at {times_} s: {masked.what}")


def _film(images: list[np.ndarray], times: list[float], alt: str, caption: str) -> Picture:
    columns = min(6, -(-len(images) // max(1, math.isqrt(len(images)))))
    rows = [images[k : k + columns] for k in range(0, len(images), columns)]
    sheet = overlays.tile(rows, gap=0)
    film = {"frames": len(images), "columns": columns, "rows": len(rows), "times": [round(t, 2) for t in times]}
    return image_picture(sheet, alt, caption, **film)


@dataclass(frozen=True)
class Painter:
    """What is drawn over the images of a sequence."""

    cameras: list[Camera]
    mask: ImageStack | None
    hands: Artifact | None
    tracks: Artifact | None
    colors: np.ndarray

    def paint(self, image: np.ndarray, f: int, c: int) -> np.ndarray:
        """An image of frame and camera, also a smaller one, with all that there is."""
        import cv2

        scale = image.shape[1] / self.cameras[c].width
        if self.mask is not None:
            mask = self.mask.mask(f, c).astype(np.uint8)
            image = overlays.draw_mask(image, cv2.resize(mask, image.shape[1::-1], interpolation=cv2.INTER_AREA) > 0)
        if self.hands is not None:
            landmarks, tip = self.hands["landmarks"][f, c] * scale, self.hands["end_effector"][f]
            image = overlays.draw_hand(image, landmarks, bool(self.hands["seen"][f, c]))
            if not np.isfinite(self.hands["landmarks"][f]).any() and np.isfinite(tip).all():  # a tool has a tip alone
                image = overlays.draw_particles(image, tip[None], self.cameras[c], HAND)
        if self.tracks is not None and f < len(self.tracks["positions"]):
            image = overlays.draw_particles(image, self.tracks["positions"][f], self.cameras[c], self.colors)
        return image

    @property
    def what(self) -> str:
        """That in words."""
        words = {
            "the object's mask in pink": self.mask,
            "the hand in yellow": self.hands,
            "tracked particles": self.tracks,
        }
        return " and ".join(word for word, part in words.items() if part is not None) or "as recorded"


def _painter(seen: Seen, masks: bool) -> Painter:
    """One that draws masks, or particles."""
    assert seen.frames is not None
    cameras = cameras_of(seen.frames)
    if masks:
        of = seen.masks
        stack = None if of is None else ImageStack(of["mask"], of["mask_offsets"], len(cameras), "mask")
        return Painter(cameras, stack, seen.hands, None, np.zeros(0))
    assert seen.tracks is not None
    return Painter(cameras, None, seen.hands, seen.tracks, _colors(seen.tracks))


def _colors(tracks: Artifact) -> np.ndarray:
    return (figures.particle_colors(tracks["positions"][0]) * 255).astype(np.uint8)


def _views(seen: Seen, level: Level) -> Iterator[Picture]:
    """Cloud and particles from above and from the side; a film of them where there are no images."""
    if seen.clouds is None and seen.tracks is None:
        return
    only = seen.frames is None
    shown = spread(len(seen.time), max(level.film, 1)) if only else seen.moments(level.moments)
    clouds = None if seen.clouds is None else np.split(seen.clouds["points"], seen.clouds["offsets"][1:-1])
    moments = [_moment(seen, clouds, f) for f in shown]
    middle, width = extent(moments)
    colors = None if seen.tracks is None else _colors(seen.tracks)
    size = min(TOP_SIZE, level.width)
    images = [
        draw_moment(moment, colors, middle, width, size, f"{seen.time[f]:.1f} s")
        for moment, f in zip(moments, shown, strict=True)
    ]
    parts = {"cloud in grey": seen.clouds, "particles in colour": seen.tracks, "true places as rings": seen.true}
    parts["the hand's way in orange"] = seen.tracks
    what = "from above, and from the side: " + ", ".join(word for word, part in parts.items() if part is not None)
    if only and len(images) > 1:
        yield _film(images, [float(seen.time[f]) for f in shown], f"{seen.name} {what}", what[0].upper() + what[1:])
    else:
        times = ", ".join(f"{seen.time[f]:.1f}" for f in shown)
        alt = f"{seen.name} at {times} s {what}"
        yield image_picture(overlays.tile([images]), alt, f"At {times} s {what}")


def _moment(seen: Seen, clouds: list[np.ndarray] | None, f: int) -> Moment:
    tracked = seen.tracks is not None and f < len(seen.tracks["positions"])
    hand = None
    if seen.tracks is not None and seen.contact is not None:
        hand = seen.tracks["end_effector"][: f + 1][seen.contact[: f + 1]]
    return Moment(
        clouds[f] if clouds is not None and f < len(clouds) else None,
        seen.tracks["positions"][f] if seen.tracks is not None and tracked else None,
        seen.true[f] if seen.true is not None and f < len(seen.true) else None,
        hand,
    )


def _plot(seen: Seen, level: Level, mark: str) -> Iterator[Picture]:
    """Errors over time, expected and measured; where neither is known, how far the particles have moved."""
    if seen.tracks is None or not level.plot:
        return
    positions, series = seen.tracks["positions"], {}
    if "trust/doubt" in seen.tracks:
        series["expected error"] = seen.tracks["trust/doubt"] * 1000
    if seen.true is not None:
        series["measured error"] = np.linalg.norm(positions - seen.true, axis=-1).mean(-1) * 1000
    if not series:
        series["motion"] = np.linalg.norm(positions - positions[0], axis=-1).mean(-1) * 1000
    what = f"{' and '.join(series)} of the particles over time, with the frames of contact shaded"
    time, contact = seen.tracks["time"], seen.tracks["contact"]
    title = f"{seen.name}: {what}; at most {max(float(v.max()) for v in series.values()):.1f} mm"
    svg = svg_of(lambda: figures.time_figure(time, series, contact), mark, title)
    yield Picture("plot", svg, title, what[0].upper() + what[1:])
