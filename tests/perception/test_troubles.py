"""What is hard to segment: followed, or said. The whole list is measured by `python -m tests.perception.troubles`."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.perception.apart import apart_elsewhere
from piegraph_cli.perception.choice import Choice
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.parts import Part
from piegraph_cli.perception.prompts import prompted_object
from piegraph_cli.perception.seeds import ObjectSeed, find_object
from piegraph_cli.stages import segment
from tests.perception.scene import WORKSPACE, ring_camera
from tests.perception.troubles import CAMERAS as FINER
from tests.perception.troubles import (
    RED,
    TROUBLES,
    WHITE,
    Moment,
    Solid,
    Trouble,
    beside,
    judge,
    neighbour,
    pushed,
    record,
)

CAMERAS = [ring_camera(azimuth, f"c{n}") for n, azimuth in enumerate((0.5, 2.6))]
PUSHED = 0.032
"""Metres a frame: enough to part the object from its neighbour."""


def some(trouble: Trouble, *frames: int) -> Trouble:
    return replace(trouble, moments=[trouble.moments[f] for f in frames])


def seed_of(recording, workspace=WORKSPACE, cameras=CAMERAS, **settings):
    find = prompted_object if settings else find_object
    given = recording.images, recording.depths, cameras, recording.hand_px, workspace
    return find(*given, SegmentParams(**settings), recording.tips)


def middle(mask):
    row, column = np.argwhere(mask).mean(axis=0)
    return float(column), float(row)


@pytest.mark.parametrize(
    ("name", "frames", "least"),
    [
        ("white object, white table", (0, 5, 8), 0.85),
        ("flat object of the table's colour", (0, 5, 8), 0.7),
        ("lifted by 12 cm", (1, 3, 4, 5), 0.8),
        ("checked cloth, one check the object's", (0, 5, 8), 0.8),
    ],
)
def test_the_object_is_followed(name, frames, least):
    scores, said = judge(some(TROUBLES[name](), *frames), CAMERAS)
    assert np.nanmin(scores) > least
    assert said == []


def test_what_was_away_is_found_where_it_comes_in_again():
    there, back = Solid(at=(-0.1, -0.1, 0.0)), Solid(at=(0.12, 0.12, 0.0))
    moments = [Moment((there,)), Moment(), Moment(), Moment(), Moment(), Moment((back,))]
    scores, _ = judge(Trouble(moments), CAMERAS)
    assert np.nanmin(scores[[0, 5]]) > 0.9
    assert np.isnan(scores[1:5]).all(), "nothing is taken for it while it is away"


@pytest.fixture(scope="module")
def parted():
    """The object slides off a neighbour of its colour, 5 mm beside it."""
    return record(some(Trouble(beside(pushed(PUSHED), neighbour(0.005))), 0, 5, 8, 9), CAMERAS)


def test_a_neighbour_that_stays_while_the_object_leaves_it_is_no_part_of_it(parted):
    seed = seed_of(parted)
    truth = parted.object[:, seed.frame]
    assert seed.frame > 0
    assert ((seed.masks & truth).sum(axis=(1, 2)) > 0.7 * (seed.masks | truth).sum(axis=(1, 2))).all()
    assert seed.warnings == []


def test_a_click_on_two_things_that_touch_means_the_one_under_it(parted):
    on_object = seed_of(parted, points={"c0": middle(parted.object[0, 0])})
    assert all(
        (mask & truth).any() for mask, truth in zip(on_object.masks, parted.object[:, on_object.frame], strict=True)
    )
    place = CAMERAS[0].project(np.array([[0.0, -0.075, 0.03]]))[0][0]
    on_neighbour = seed_of(parted, points={"c0": tuple(place)})
    assert not any(
        (mask & truth).sum() > 0.1 * mask.sum()
        for mask, truth in zip(on_neighbour.masks, parted.object[:, on_neighbour.frame], strict=True)
    )


def test_a_rope_whose_end_stays_is_one_thing_though_the_hand_hides_its_middle():
    still = tuple((0.0, y, 0.008) for y in np.linspace(-0.15, 0.0, 6))
    moments = []
    for m in some(Trouble(pushed(PUSHED, size=(0.016, 0.1, 0.016))), 0, 5, 8).moments:
        x = m.object[0].at[0]
        bent = tuple((x * (y / 0.15) ** 0.5, y, 0.008) for y in np.linspace(0.0, 0.15, 6))
        rope = Solid(rope=still + bent[1:], radius=0.008, colour=WHITE)
        moments.append(replace(m, object=(rope,), tip=(m.tip[0], 0.03, m.tip[2])))
    recording = record(Trouble(moments), FINER)
    seed = seed_of(recording, cameras=FINER)
    truth = recording.object[:, seed.frame]
    assert ((seed.masks & truth).sum(axis=(1, 2)) > 0.9 * truth.sum(axis=(1, 2))).all()
    assert seed.warnings == []


@pytest.mark.parametrize(("clearance", "parted"), [(0.2, True), (0.02, False)])
def test_what_the_hand_may_have_parted_stays_one_thing(clearance, parted):
    def part(columns, clearance):
        away = np.full((40, 40), 0.1)
        away[10:20, columns] = 0
        return Part([], away, 0.01, 0.01, clearance, np.zeros(2))

    whole, still, moved = part(slice(5, 20), 0.2), part(slice(5, 12), 0.2), part(slice(25, 35), clearance)
    chooser = SimpleNamespace(
        tips=np.zeros((5, 3)),
        change=lambda frame, part, other: 0.0,
        trait=lambda frame, part: SimpleNamespace(stays=part is still),
        choose=lambda frame, parts: Choice(moved, 0),
    )
    found = apart_elsewhere(chooser, 0, Choice(whole, 0), lambda frame: [still, moved])
    assert (found is not None and found[1].part is moved) == parted


NARROW = np.array([[-0.3, 0.02], [-0.3, 0.3], [-0.02, 0.2]])


def test_what_the_workspace_cuts_is_said_with_the_box_that_holds_it():
    scene = record(Trouble([Moment((Solid(),))]), CAMERAS)
    for seed in (seed_of(scene, NARROW), seed_of(scene, NARROW, points={"c0": middle(scene.object[0, 0])})):
        assert len(seed.warnings) == 1
        assert "reaches the workspace's edge" in seed.warnings[0]
        assert "ingest.workspace = -0.3,0.2,-0.3,0.3,-0.02,0.2 would hold it" in seed.warnings[0]


@pytest.mark.parametrize("prompt", ["points", "prompts"])
def test_a_click_beyond_the_workspace_is_told_the_box_that_holds_it(prompt):
    scene = record(Trouble([Moment((Solid(at=(0.15, 0.0, 0.0)),))]), CAMERAS)
    rows, columns = np.nonzero(scene.object[0, 0])
    box = (columns.min() - 2, rows.min() - 2, columns.max() + 2, rows.max() + 2)
    given = {prompt: {"c0": middle(scene.object[0, 0]) if prompt == "points" else box}}
    with pytest.raises(DataError, match=r"(?s)outside the workspace.*ingest.workspace = -0.3,0.35,") as caught:
        seed_of(scene, NARROW, **given)
    numbers = caught.value.hint.split(" = ")[1].split(" ")[0]
    seed = seed_of(scene, np.array([float(n) for n in numbers.split(",")]).reshape(3, 2), **given)
    assert all((mask & truth).any() for mask, truth in zip(seed.masks, scene.object[:, 0], strict=True))


def test_where_nothing_is_found_the_setting_that_finds_something_is_named():
    faint = Trouble([Moment((Solid(size=(0.12, 0.06, 0.003), colour=(150, 122, 75)),))])
    scene = record(faint, CAMERAS)
    with pytest.raises(DataError, match=r"(?s)no object found.*with segment.min_contrast = 0.125 there is something"):
        seed_of(scene)
    found = find_object(
        scene.images, scene.depths, CAMERAS, scene.hand_px, WORKSPACE, SegmentParams(min_contrast=0.125)
    )
    assert all((mask & truth).any() for mask, truth in zip(found.masks, scene.object[:, 0], strict=True))


def test_a_doubt_comes_with_a_picture_of_it(tmp_path):
    two = record(Trouble([Moment((Solid(),), None, (Solid(at=(0.0, 0.2, 0.0), colour=RED),))]), CAMERAS)
    seed = seed_of(two)
    context = SimpleNamespace(run=SimpleNamespace(folder=tmp_path), unit="take")
    (line,) = segment._picture(seed, two.images, CAMERAS, context)
    picture = tmp_path / "report" / "take_object.png"
    assert str(picture) in line
    assert picture.stat().st_size > 10_000
    assert segment._picture(ObjectSeed(0, seed.masks), two.images, CAMERAS, context) == []
