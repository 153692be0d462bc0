"""One look: what the cameras see now becomes the object's cloud and particles, with a verdict on whether to trust them.

It is made of what the stages are made of: the checks of geometry, the masks, the fused cloud, the choice of particles.
"""

import time
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.perception.clouds import fuse
from piegraph_cli.perception.judgement import UNSEEN, check_candidates, check_cloud, check_outline
from piegraph_cli.perception.object_masks import follow_object, seed_object
from piegraph_cli.perception.params import FuseParams, SegmentParams
from piegraph_cli.perception.parts import Part
from piegraph_cli.perception.seeds import ObjectSeed
from piegraph_cli.perception.size import check_size
from piegraph_cli.perception.surroundings import unseen_outline
from piegraph_cli.physics.particles import Sizes, choose_particles, size_of
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.checks import Check, Finding, Verdict, grouped
from piegraph_cli.recording.geometry import View, check_geometry
from piegraph_cli.recording.ground import level, moved, on_table, upright
from piegraph_cli.recording.params import ReadParams

WORKERS = 2
"""Threads: one camera each, or the checks of geometry beside them."""
FITS = 1.35
"""Factor up to which a thing may differ from the trained object's sizes and still be it."""


@dataclass(frozen=True)
class LookSettings:
    """With what to look: settings of the stages, how many particles, and what object is expected."""

    ingest: ReadParams = field(default_factory=ReadParams)
    """Of which `workspace`, `table` and `accept` count."""
    segment: SegmentParams = field(default_factory=SegmentParams)
    fuse: FuseParams = field(default_factory=FuseParams)
    particles: int = 50
    sizes: Sizes | None = None
    """Those of the object that a model was trained on, where there is one."""
    accept: Collection[str] = ()
    """Checks of the look that may be bad, by name."""


@dataclass(frozen=True)
class Look:
    """What one look found."""

    cloud: np.ndarray
    """[P, 3] float32, metres in the world; empty where nothing was found."""
    chosen: np.ndarray
    """[N, 3] float32, metres: the particles, whatever the verdict; empty where the cloud has too few points."""
    masks: list[np.ndarray]
    """[H, W] bool of each camera."""
    others: list[list[np.ndarray]]
    """The masks of each other thing that could be the object as well."""
    checks: list[Check]
    """All checks, those that are good too."""
    seconds: dict[str, float]
    """What took how long; `total` is the whole look."""
    accepted: frozenset[str] = frozenset()
    """Checks that may be bad."""

    @property
    def findings(self) -> list[Finding]:
        """What is not good, the worst first."""
        return grouped(self.checks)

    @property
    def verdict(self) -> Verdict:
        """That of the worst check; one that is bad and accepted is doubtful."""
        found: set[Verdict] = {c.verdict for c in self.checks}
        if any(c.verdict == "bad" and c.name not in self.accepted for c in self.checks):
            return "bad"
        return "good" if found <= {"good"} else "doubtful"

    @property
    def particles(self) -> np.ndarray:
        """[N, 3] float32, metres. Raises `DataError` with the reasons where the verdict is bad."""
        self.require()
        return self.chosen

    def require(self) -> None:
        """Raise `DataError` with causes and remedies where the verdict is bad."""
        if self.verdict != "bad":
            return
        bad = [f for f in self.findings if f.checks[0].verdict == "bad" and f.name not in self.accepted]
        remedies = "; ".join(dict.fromkeys(f.remedy for f in bad if f.remedy))
        raise DataError("the look is bad: " + "; ".join(f.text for f in bad), "look", remedies)


class _Clock:
    """Seconds by what they were spent on."""

    def __init__(self) -> None:
        self.begin, self.seconds = time.perf_counter(), dict[str, float]()

    @contextmanager
    def __call__(self, what: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self.seconds[what] = time.perf_counter() - begin

    def all(self) -> dict[str, float]:
        return self.seconds | {"total": time.perf_counter() - self.begin}


def look(
    color: Sequence[np.ndarray],
    depth: Sequence[np.ndarray],
    cameras: Sequence[Camera],
    settings: LookSettings = LookSettings(),
) -> Look:
    """The object's cloud and particles from one image of each camera, with checks of geometry, cloud and object.

    `color` RGB uint8 [H, W, 3] and `depth` uint16 [H, W] (units of the camera's depth scale, 0 = no reading, registered
    to colour), one of each camera. What is wrong with the scene is in the verdict; raises `DataError` only for images that do
    not fit their cameras, and `UsageError` for prompts that are none.
    """
    check_scene(color, depth, cameras)
    clock, workspace = _Clock(), np.array(settings.ingest.workspace, float).reshape(3, 2)
    table = settings.ingest.table
    views = [View(upright(k, table), [d], [c]) for k, c, d in zip(cameras, color, depth, strict=True)]
    with ThreadPoolExecutor(WORKERS) as pool:
        geometry = pool.submit(check_geometry, views, workspace, table[0])
        found = _Finder(color, depth, [on_table(k, table) for k in cameras], settings, clock).find(pool)
        with clock("checks"):
            checks = [*map(_of_one_frame, geometry.result()), *found.checks]
    accepted = frozenset([*settings.ingest.accept, *settings.accept])
    back = np.linalg.inv(level(table))
    cloud, particles = moved(found.cloud, back), moved(found.particles, back)
    return Look(cloud, particles, found.masks, found.others, checks, clock.all(), accepted)


def _of_one_frame(check: Check) -> Check:
    """A check of geometry made on one frame: edges that fit a little better elsewhere are told by several alone."""
    if check.name == "edges" and check.verdict == "doubtful":
        return replace(check, verdict="good", cause="", remedy="")
    return check


def check_scene(color: Sequence[np.ndarray], depth: Sequence[np.ndarray], cameras: Sequence[Camera]) -> None:
    """Raise `DataError` where there is not one colour and one depth image of each camera, of its size."""
    if not len(cameras) or len(color) != len(cameras) or len(depth) != len(cameras):
        raise DataError(
            f"{len(color)} colour and {len(depth)} depth images for {len(cameras)} cameras",
            "look",
            "give one of each camera, in the cameras' order",
        )
    for camera, image, readings in zip(cameras, color, depth, strict=True):
        size, where = (camera.height, camera.width), f"look, camera {camera.name}"
        if image.dtype != np.uint8 or image.shape != (*size, 3):
            raise DataError(
                f"colour is {image.dtype} {list(image.shape)}, not uint8 {[*size, 3]}", where, "give RGB images"
            )
        if readings.dtype != np.uint16 or readings.shape != size:
            raise DataError(
                f"depth is {readings.dtype} {list(readings.shape)}, not uint16 {list(size)}",
                where,
                "give depth registered to colour, in units of depth_scale",
            )


@dataclass
class _Found:
    """The object, as far as it was found, and what is to be said of it."""

    masks: list[np.ndarray]
    checks: list[Check]
    cloud: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    particles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    others: list[list[np.ndarray]] = field(default_factory=list)


class _Finder:
    """Finds the object in one image of each camera."""

    def __init__(
        self,
        color: Sequence[np.ndarray],
        depth: Sequence[np.ndarray],
        cameras: Sequence[Camera],
        settings: LookSettings,
        clock: _Clock,
    ):
        self.color, self.depth, self.cameras = list(color), list(depth), list(cameras)
        self.settings, self.clock = settings, clock
        self.workspace = np.array(settings.ingest.workspace, float).reshape(3, 2)
        self.no_hand, self.no_tip = np.full((1, len(self.cameras), 21, 2), np.nan), np.full((1, 3), np.nan)

    def find(self, pool: ThreadPoolExecutor) -> _Found:
        """Masks, cloud and particles. What cannot be found is a bad check, not an error."""
        found = _Found([np.zeros((k.height, k.width), bool) for k in self.cameras], [])
        try:
            with self.clock("object"):
                seed, rivals = self._seed()
            with self.clock("masks"):
                self._follow(seed, found.masks, pool)
                found.others = [part.masks for part in rivals]
        except DataError as error:
            names = tuple(k.name for k in self.cameras)
            found.checks.append(Check("object", names, 0, "1", 1, "bad", error.message, remedy=error.hint))
            return found
        with self.clock("cloud"):
            found.cloud = self._fused(found.masks)
        if len(found.cloud) >= self.settings.particles:
            with self.clock("particles"):
                found.particles = choose_particles(found.cloud, self.settings.particles).astype(np.float32)
        found.checks += check_cloud(found.cloud, found.masks, self.depth, self.cameras, self.settings.particles)
        if len(found.cloud):
            found.checks += check_outline(found.cloud, found.masks, self.depth, self.cameras, self.workspace)
            found.checks.append(check_candidates(found.cloud, rivals, self.cameras))
        if self.settings.sizes and len(found.particles) > 1:
            found.checks.append(check_size(size_of(found.particles), self.settings.sizes, self.cameras))
        return found

    def _seed(self) -> tuple[ObjectSeed, list[Part]]:
        """Where the object is, and what else it could be: nothing where a prompt or the trained object's size tells."""
        segment = self.settings.segment
        seed = self._seeded(segment)
        if segment.prompts or segment.points or not seed.others:
            return seed, []
        rivals = [part for part in seed.others if not self._reaches_in(part)]
        if not rivals:
            return seed, []
        things = [seed.masks, *(part.masks for part in rivals)]
        fits = [n for n, masks in enumerate(things) if self._fits(masks)]
        if len(fits) != 1:
            return seed, rivals
        if fits[0] > 0:
            seed = self._seeded(segment.model_copy(update={"prompts": self._box(things[fits[0]])}))
        return seed, []

    def _seeded(self, segment: SegmentParams) -> ObjectSeed:
        images = [[image] for image in self.color], [[image] for image in self.depth]
        return seed_object(*images, self.cameras, self.no_hand, self.workspace, segment, self.no_tip)

    def _reaches_in(self, part: Part) -> bool:
        """Whether a thing comes from beyond the images or the workspace, as hands and arms do."""
        cloud = self._fused(part.masks)
        if not len(cloud):
            return False
        return unseen_outline(cloud, part.masks, self.depth, self.cameras, self.workspace).cut > UNSEEN[1]

    def _fits(self, masks: Sequence[np.ndarray]) -> bool:
        """Whether a thing is as large as the object that is expected; no thing is where none is."""
        cloud = self._fused(masks)
        if self.settings.sizes is None or len(cloud) < self.settings.particles:
            return False
        size = size_of(choose_particles(cloud, self.settings.particles))
        return max(self.settings.sizes.apart(size, one_side=len(self.cameras) == 1).values()) <= FITS

    def _box(self, masks: Sequence[np.ndarray]) -> dict[str, tuple[float, float, float, float]]:
        """The prompt for a thing: its box in the camera that sees it best."""
        c = int(np.argmax([mask.sum() for mask in masks]))
        rows, columns = np.nonzero(masks[c])
        return {self.cameras[c].name: (*map(float, (columns.min(), rows.min(), columns.max(), rows.max())),)}  # type: ignore[dict-item]

    def _follow(self, seed: ObjectSeed, masks: list[np.ndarray], pool: ThreadPoolExecutor) -> None:
        """Fill in the masks of the cameras that see the object."""
        prompted = self.settings.segment.prompts if self.settings.segment.segmenter == "sam" else {}
        sees = [c for c, k in enumerate(self.cameras) if seed.masks[c].any() or k.name in prompted]
        of_these = ObjectSeed(seed.frame, [seed.masks[c] for c in sees], [_seen_by(p, sees) for p in seed.others])
        color, depth = ([[images[c]] for c in sees] for images in (self.color, self.depth))
        cameras = [self.cameras[c] for c in sees]
        segment, over = self.settings.segment, map if self.settings.segment.segmenter == "sam" else pool.map
        given = color, depth, cameras, self.no_hand[:, sees], self.workspace, segment, self.no_tip
        found = follow_object(*given, of_these, over)
        for c, frames in zip(sees, found, strict=True):
            masks[c] = frames[0]

    def _fused(self, masks: Sequence[np.ndarray]) -> np.ndarray:
        return fuse(masks, self.depth, self.cameras, self.workspace, self.settings.fuse.voxel_size)


def _seen_by(part: Part, cameras: Sequence[int]) -> Part:
    return replace(part, masks=[part.masks[c] for c in cameras])
