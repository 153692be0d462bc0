"""The viewer in a browser: what is seen and what is set there by hand, on the sample."""

import re
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from piegraph_cli.physics.bending import KEPT, stretched_by
from piegraph_cli.recording.points import read_points
from piegraph_cli.stages import open_run
from piegraph_cli.stages.images import cameras_of
from piegraph_cli.viewer.desk import Desk
from piegraph_cli.viewer.goal_shape import GoalShape
from piegraph_cli.viewer.goal_tool import FREE, HELD
from piegraph_cli.workspace.artifact import read_artifact
from tests.browser.conftest import viewing, watched
from tests.browser.screen import changed, like, until
from tests.cli import SAMPLE

pytest.importorskip("viser", reason="viser is not installed: pip install 'piegraph[view]'")

SIZE = {"width": 1080, "height": 460}
FOV = np.radians(75)
"""Of the viewer's camera, from bottom to top."""
TOUCHED = 12
"""A frame in which the hand pushes."""


@pytest.fixture(scope="module")
def run(sample_run, tmp_path_factory):
    """A copy of the sample's run, which is written to."""
    folder = tmp_path_factory.mktemp("viewed") / "sample"
    shutil.copytree(sample_run, folder)
    return folder


@pytest.fixture(scope="module")
def opened(browser, run):
    """The page of a viewer, without the browser's word on its slow graphics."""
    with viewing(run, run / "view.log") as address, watched(browser, viewport=SIZE) as screen:
        screen.page.goto(address)
        screen.page.get_by_role("tab", name="See", exact=True).wait_for()
        closing = screen.page.locator(".mantine-Notification-closeButton")
        closing.first.click()
        until(lambda: closing.count() == 0, "an empty screen")
        yield screen


@pytest.fixture
def screen(opened, tmp_path):
    """The same, its first sequence; nothing may go wrong in it, and nobody else be asked for anything."""
    opened.errors.clear()
    if opened.page.get_by_label("sequence", exact=True).input_value() != "sequence_0000":
        opened.choose("sequence", "sequence_0000")
    yield opened
    opened.save(tmp_path / "screen.png")
    assert opened.errors == []
    assert opened.strangers == []


def to_frame(screen, frame: int) -> None:
    """Move the time line."""
    entry = screen.number("frame")
    entry.fill(str(frame))
    entry.press("Enter")


def switch(screen, on: bool, *layers: str) -> None:
    """Switch layers on or off."""
    screen.tab("See")
    for name in layers:
        screen.page.get_by_label(name, exact=True).set_checked(on)


def still(screen) -> np.ndarray:
    """The scene when it does not change any more."""
    kept = [screen.scene()]

    def same() -> bool:
        kept.append(screen.scene())
        return changed(kept[-2], kept[-1]) == 0

    until(same, "a scene at rest")
    return kept[-1]


def pixel_of(screen, sizes, camera: int, column: float, row: float) -> tuple[float, float]:
    """Where in the scene a pixel of an image on the desk is."""
    desk = Desk(SimpleNamespace(server=SimpleNamespace(scene=None)))
    desk._sizes = sizes
    height, width = screen.scene().shape[:2]
    away = desk._distance(SimpleNamespace(fov=FOV, aspect=width / height))
    left, up = desk._middles()[camera]
    x = left - 0.5 + (column + 0.5) / sizes[camera][0]
    z = up + desk._height(camera) * (0.5 - (row + 0.5) / sizes[camera][1])
    scale = height / 2 / np.tan(FOV / 2) / away
    return width / 2 + x * scale, height / 2 - z * scale


def test_it_opens_on_the_object(screen):
    until(lambda: len(like(still(screen), (255, 255, 255), 3)) < 0.97 * screen.scene()[..., 0].size, "the scene")
    image = still(screen)
    drawn = np.argwhere(np.ptp(image.astype(int), axis=-1) > 60)
    middle = np.array(image.shape[:2]) / 2
    assert len(drawn) > 300
    assert (np.abs(drawn.mean(0) - middle) < 0.25 * np.array(image.shape[:2])).all()


@pytest.mark.parametrize("layer", ["cameras", "hand", "cloud", "particles", "true particles"])
def test_what_is_switched_off_is_not_drawn(screen, layer):
    screen.tab("See")
    to_frame(screen, TOUCHED)
    screen.press("everything")
    box = screen.page.get_by_label(layer, exact=True)
    others = [name for name in ("cloud", "particles") if name != layer]
    switch(screen, False, *others)  # what lies on each other hides each other
    box.uncheck()
    hidden = still(screen)

    def comes_and_goes() -> bool:  # again, where something before it was drawn only now
        nonlocal hidden
        box.check()
        shown = until(lambda: now if changed(hidden, now := still(screen)) > 60 else None, f"{layer} in the scene")
        box.uncheck()
        before, hidden = (
            hidden,
            until(lambda: now if changed(shown, now := still(screen)) > 60 else None, f"{layer} taken away"),
        )
        return changed(before, hidden) < 0.05 * changed(before, shown) + 10

    until(comes_and_goes, f"a scene without {layer}")
    box.set_checked(layer != "true particles")
    switch(screen, True, *others)
    screen.press("object")


def test_it_plays_and_stands_still(screen):
    to_frame(screen, 0)
    entry = screen.number("frame")
    before = still(screen)
    screen.press("play")
    until(lambda: int(entry.input_value()) > 3, "a later frame")
    screen.press("pause")
    screen.page.get_by_role("button", name="play", exact=True).wait_for()
    assert changed(before, still(screen)) > 60
    stands = entry.input_value()
    screen.page.wait_for_timeout(500)
    assert entry.input_value() == stands


def test_another_sequence_is_another_scene(screen):
    to_frame(screen, 0)
    before = still(screen)
    screen.choose("sequence", "sequence_0001")
    other = until(lambda: now if changed(before, now := still(screen)) > 60 else None, "another scene")
    screen.choose("sequence", "sequence_0000")
    until(lambda: changed(before, still(screen)) < 0.2 * changed(before, other), "the first scene")


def test_predictions_follow_the_horizon(screen):
    screen.tab("Models")
    box = screen.page.get_by_label("show predictions", exact=True)
    box.wait_for()
    to_frame(screen, TOUCHED)
    box.check()
    shown = still(screen)
    box.uncheck()
    until(lambda: changed(shown, still(screen)) > 60, "a scene without predictions")


def test_a_plan_is_shown_alone(screen):
    screen.tab("Plan")
    before = still(screen)
    screen.page.get_by_label("show the plan", exact=True).check()
    shown = until(lambda: now if changed(before, now := still(screen)) > 200 else None, "the plan")
    screen.page.get_by_label("candidates", exact=True).uncheck()
    until(lambda: changed(shown, still(screen)) > 60, "the plan without candidates")
    screen.page.get_by_label("show the plan", exact=True).uncheck()
    until(lambda: changed(before, still(screen)) < 0.1 * changed(before, shown) + 20, "the recording again")


class Filmed:
    """A sequence of the sample and its truth."""

    def __init__(self, run, name: str):
        self.frames = read_artifact(run / "frames" / f"{name}.h5", "frames")
        self.particles = read_artifact(SAMPLE / name / "truth.h5", "truth")["particles"]
        self.cameras = cameras_of(self.frames)
        self.sizes = [(camera.width, camera.height) for camera in self.cameras]
        top = np.flatnonzero(self.particles[0][:, 2] > self.particles[0][:, 2].max() - 0.002)
        middle = self.particles[0][top].mean(0)
        self.spot = int(top[np.linalg.norm(self.particles[0][top] - middle, axis=1).argmin()])
        """A material point on top of the block."""

    def pixel(self, frame: int, camera: int) -> np.ndarray:
        """Where a camera truly sees the spot [2]."""
        point = self.particles[self.frames["source_frame"][frame, camera], self.spot]
        return self.cameras[camera].project(point[None])[0][0]


def test_clicks_on_one_spot_say_how_far_tracking_is_off(screen, run):
    screen.tab("Set")
    screen.choose("set", "true spots")
    filmed = Filmed(run, "sequence_0000")
    for frame in (0, 30):
        to_frame(screen, frame)
        still(screen)
        for camera in (1, 2):
            screen.click_scene(*pixel_of(screen, filmed.sizes, camera, *filmed.pixel(frame, camera)))
            until(lambda frame=frame: f"images {'0, ' if frame else ''}{frame}" in text_of(screen), "the click")
    screen.press("score")
    told = screen.read("spots clicked by hand")
    off = float(re.search(r"median ([\d.]+) mm", told).group(1))
    assert off < 10, told
    assert (run / "clicks" / "sequence_0000.csv").read_text().count("\n") == 5
    screen.choose("set", "nothing")


def text_of(screen) -> str:
    return screen.page.inner_text("body")


def test_a_goal_is_dragged_kept_and_planned_for(screen, run):
    switch(screen, False, "cloud", "particles", "hand")
    to_frame(screen, 0)
    screen.tab("Set")
    screen.choose("set", "goal")
    screen.read("From frame 0")
    before = still(screen)
    sheet = like(before, (61, 133, 247), 40)  # the gizmo's plane
    assert len(sheet) > 20
    begin = np.median(sheet, axis=0)
    screen.drag_scene(begin, (begin[0] + 70, begin[1] + 25))
    until(lambda: changed(before, still(screen)) > 300, "the goal elsewhere")
    screen.press("save the goal")
    screen.read("saved as")
    start = read_artifact(run / "tracks" / "sequence_0000.h5", "tracks")["positions"][0]
    goal = read_points(run / "goals" / "sequence_0000.npz", None, {})
    shift = (goal - start).mean(0)
    assert 0.03 < np.linalg.norm(shift) < 0.5
    assert np.abs(goal - start - shift).max() < 1e-4
    before = still(screen)
    screen.press("plan")
    screen.read("stroke 1: push from")
    until(lambda: changed(before, still(screen)) > 100, "the strokes")
    screen.choose("set", "nothing")
    switch(screen, True, "cloud", "particles", "hand")


def balls(image: np.ndarray, color: tuple[int, int, int]) -> list[np.ndarray]:
    """Middles (column, row) of what is drawn in a hue, lit or in the shade."""
    import cv2

    hue, saturation, _ = np.moveaxis(cv2.cvtColor(image, cv2.COLOR_RGB2HSV).astype(int), -1, 0)
    wanted = int(cv2.cvtColor(np.uint8([[color]]), cv2.COLOR_RGB2HSV)[0, 0, 0])
    mask = (np.abs(hue - wanted) < 8) & (saturation > 90)
    _, _, stats, middles = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return [middle for middle, row in zip(middles[1:], stats[1:], strict=True) if row[cv2.CC_STAT_AREA] > 15]


def test_a_goal_is_bent_by_its_points(screen, run):
    switch(screen, False, "cloud", "particles", "hand", "true particles")
    to_frame(screen, 0)
    screen.tab("Set")
    screen.choose("set", "goal")
    screen.choose("drag to", "bend")
    free = until(lambda: found if len(found := balls(still(screen), FREE)) >= 4 else None, "points to hold")
    middle = np.mean(free, axis=0)
    ball = max(free, key=lambda at: np.linalg.norm(at - middle))
    screen.drag_scene(tuple(ball), tuple(ball + 0.4 * (middle - ball) + [0, 25]))
    until(lambda: len(balls(still(screen), HELD)) == 2 or None, "the dragged point and the farthest one")
    screen.press("save the goal")
    screen.read("saved as")
    start = read_artifact(run / "tracks" / "sequence_0000.h5", "tracks")["positions"][0]
    goal = read_points(run / "goals" / "sequence_0000.npz", None, {})
    assert np.linalg.norm(goal - start, axis=1).max() > 0.01
    assert stretched_by(start, GoalShape(start).pairs, goal) <= KEPT
    screen.choose("drag to", "move and turn")
    screen.choose("set", "nothing")
    switch(screen, True, "cloud", "particles", "hand")


def test_a_click_on_the_object_is_a_prompt_that_the_recipe_keeps(screen, run):
    before, filmed = open_run(run).recipe.sections, Filmed(run, "sequence_0001")
    screen.choose("sequence", "sequence_0001")
    screen.tab("Set")
    screen.choose("set", "prompt")
    without = screen.read("no prompt; the mask in frame 0")
    screen.click_scene(*pixel_of(screen, filmed.sizes, 1, *filmed.pixel(0, 1)))
    given = screen.read("1 points, 0 boxes; the mask in frame 0")
    assert given.partition(":")[2] == without.partition(":")[2]  # the whole block in both
    screen.press("save into the recipe")
    told = screen.read("saved in")
    after = open_run(run).recipe.sections
    kept = after["segment"]["points"]
    assert list(kept) == ["sequence_0001/cam1"]
    assert (
        np.abs(np.array(kept["sequence_0001/cam1"]) - filmed.pixel(0, 1)).max() < 3
    )  # of which a pixel of the screen has two
    assert {name: value for name, value in after.items() if name != "segment"} == {
        name: value for name, value in before.items() if name != "segment"
    }
    assert "segment (sequence_0001)" in told
    assert "sequence_0000" not in told
    screen.choose("set", "nothing")
