"""Planning through cameras: looks follow what is rendered and nothing else, and what cannot be seen is never pushed."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.environments import make
from piegraph_cli.environments.base import TIP_HEIGHT
from piegraph_cli.environments.params import SightParams
from piegraph_cli.environments.render import OTHER, Part
from piegraph_cli.environments.sight import Sight
from piegraph_cli.environments.trouble import Cover
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.evaluation.metrics import nearest_distance
from piegraph_cli.params import PICK
from piegraph_cli.perception.look import LookSettings, look
from piegraph_cli.physics.particles import Sizes, size_of
from piegraph_cli.planning import eyes as eyes_module
from piegraph_cli.planning import seeing
from piegraph_cli.planning.costs import make_cost
from piegraph_cli.planning.expected import require_goal
from piegraph_cli.planning.eyes import Eyes, Near, Unseen
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.search import Plan
from piegraph_cli.planning.seeing import alike, play_seen
from piegraph_cli.planning.tracked import Tracked
from piegraph_cli.recording.checks import Check
from piegraph_cli.recording.film import Scene

HERE, THERE = np.array([-0.12, 0.05, 0.3]), np.array([0.15, -0.08, 2.0])
"""Poses of the block."""
SETTINGS = {"env": "tblock", "model": "sms-no", "look": "cameras", "samples": 20, "cem_iterations": 2, "strokes": 1}


@pytest.fixture
def block():
    block = make("tblock")
    block.reset(options={"pose": HERE})
    return block


@pytest.fixture
def sizes(block):
    return LookSettings(sizes=Sizes.of([block.particles()]))


def play(block, **settings):
    return play_seen(block, None, PlanParams(**SETTINGS | settings), start=0, goal=0)


def off(cloud, particles) -> float:
    return float(np.linalg.norm(cloud[:, :2].mean(0) - particles[:, :2].mean(0)))


def test_a_look_follows_what_is_rendered_and_not_what_the_environment_holds(block):
    seen = look(*Sight(block).shoot(THERE))
    assert off(seen.cloud, block.particles(THERE)) < 0.01
    assert off(seen.cloud, block.particles()) > 0.2


def test_an_episode_knows_of_the_object_what_cameras_show_and_nothing_else(block, monkeypatch):
    """Images of another place than the object's: the plan starts there, and only what is written beside it is true."""
    shoot = Sight.shoot
    monkeypatch.setattr(Sight, "shoot", lambda self, shape=None, tip=None: shoot(self, THERE, tip))
    found = play(block, success=0.001, goal_pose=(-0.1, 0.0, 0.5))
    assert off(found.start, block.particles(THERE)) < 0.015
    assert off(found.steps[0].before, block.particles(THERE)) < 0.015
    assert off(found.steps[0].after, block.particles(THERE)) < 0.015, "the stroke moved nothing that is seen"
    assert off(found.true[0], block.particles(THERE)) > 0.05
    assert found.copies is None


def test_goal_and_states_are_clouds_and_the_truth_is_kept_beside_them(block):
    found = play(block)
    assert found.metric == "distance", "its shape is found in the cloud of the goal"
    assert len(found.goal) == 2000
    assert off(found.goal, found.copies[0]) < 0.01
    assert len(found.true) == len(found.steps) + 1 == 2
    for seen, true in zip(found.states, found.true, strict=True):
        assert off(seen, true) < 0.02, "cameras see tops and sides unevenly"
        assert np.linalg.norm(seen[:, None] - true, axis=-1).min(1).mean() < 0.02
    assert not [text for text in found.said if "looked again" in text]


def test_keeping_particles_by_tracking_carries_the_same_ones_on(block):
    """Of a short push, so that there are few frames."""
    eyes, sight = Eyes(LookSettings()), Sight(block)
    first, scene = eyes.see(sight.shoot)
    tracked, before = Tracked(first, scene, eyes.settings), block.particles()
    beside = tracked.rest[tracked.rest[:, 0].argmin(), :2] - np.array([0.03, 0])
    after, _, _, _, info = block.step({"start": beside, "end": beside + np.array([0.06, 0]), "mode": 0})
    hand, shapes = info["pusher"][::3].astype(float), info["shapes"][::3]
    tracked.follow(hand, 0, lambda k: sight.shoot(shapes[k], hand[k] - [0, 0, TIP_HEIGHT]))
    found = tracked.settle(*eyes.see(sight.shoot))
    true = after - before
    assert np.linalg.norm(true, axis=1).mean() > 0.01
    near = np.linalg.norm(before[None] - tracked.rest[:, None], axis=-1).argmin(1)
    assert np.linalg.norm(found - tracked.rest - true[near], axis=1).mean() < 0.008


def test_particles_of_a_sheet_are_carried_on_and_know_their_places_in_the_goal_when_it_is_folded(monkeypatch):
    """One corner is taken 12 cm inwards: the sheet's own shape is not in the goal any more."""

    def fold(positions, tried):
        corner = positions[(positions[:, 0] + positions[:, 1]).argmax(), :2]
        pick = Strokes.of(corner.numpy(), corner.numpy() - 0.085, PICK)
        return Plan(pick[None], positions[None], 0.0, None, torch.zeros(1))

    monkeypatch.setattr(seeing, "make_planner", lambda trained, rest, goal, *_: (cost_of(goal, rest), fold))
    found = play_seen(make("cloth"), None, PlanParams(**SETTINGS | {"env": "cloth"}), start=0, goal=0)
    (first, last), (before, after) = found.states, found.true
    near = np.linalg.norm(before[None] - first[:, None], axis=-1).argmin(1)
    moved = np.linalg.norm(after - before, axis=1)
    assert moved.max() > 0.1
    assert np.linalg.norm(last - first - (after - before)[near], axis=1).mean() < 0.02
    assert found.metric == "distance"


def cost_of(goal, rest):
    assert goal.particles is not None
    return make_cost("distance", torch.as_tensor(goal.particles), len(rest))


def test_edges_are_judged_in_the_first_look_alone(block, monkeypatch):
    """Folds and shadows look like depth that is not registered, which it was a look ago."""
    seen = iter(["good", "bad"])
    eyes, sight = Eyes(LookSettings()), Sight(block)
    wrong = Check(
        "edges", ("cam0",), 20.0, "px", 4.0, "bad", "edges lie elsewhere", "depth is not registered to colour"
    )

    def judged(*arguments):
        found = look(*arguments)
        return replace(found, checks=[*found.checks, *([wrong] if next(seen) == "bad" else [])])

    monkeypatch.setattr(eyes_module, "look", judged)
    assert eyes.see(sight.shoot)[0].verdict == "good"
    assert eyes.see(sight.shoot)[0].verdict == "good"
    assert not eyes.said
    seen = iter(["bad"] * 3)
    with pytest.raises(Unseen, match="not registered"):
        Eyes(LookSettings()).see(sight.shoot)


def with_part(shoot, part, after: int):
    def shot(self, shape=None, tip=None):
        self.beside = [part(self.environment)] if self.shots >= after else []
        return shoot(self, shape, tip)

    return shot


def test_an_episode_ends_where_something_covers_half_of_the_object(block, monkeypatch):
    cover = lambda env: Cover.of(env.surface()).part(env.surface())  # noqa: E731
    monkeypatch.setattr(Sight, "shoot", with_part(Sight.shoot, cover, after=2))
    found = play(block, strokes=5, success=0.001)
    assert found.ending == "the look is bad"
    assert len(found.steps) == 1
    assert np.isnan(found.steps[0].after).all()
    assert np.isfinite(found.end_distance)
    assert "colours that the object did not have" in found.said[-1]
    assert "3 looks in a row" in found.said[-1]


def test_a_look_that_is_bad_once_is_repeated(block, monkeypatch):
    shoot = Sight.shoot
    monkeypatch.setattr(
        Sight, "shoot", lambda self, shape=None, tip=None: shoot(self, THERE * 9 if self.shots == 2 else shape, tip)
    )
    found = play(block, strokes=1, success=0.001)
    assert found.ending == "strokes spent"
    assert np.isfinite(found.steps[0].after).all()
    assert [text for text in found.said if "no object found" in text and "looked again" in text]


def test_nothing_to_see_is_said_and_nothing_is_done(block, sizes):
    sight = Sight(block)
    with pytest.raises(Unseen, match="no object found"):
        Eyes(sizes).see(lambda: sight.shoot(np.array([2.0, 0, 0])))


def test_another_thing_of_the_same_kind_is_told(block, sizes):
    sight = Sight(block)
    sight.beside = [Part(block.surface(THERE), block.triangles, OTHER, np.array([block.color]))]
    with pytest.raises(Unseen, match="one more thing is in view"):
        Eyes(sizes).see(sight.shoot)


def test_what_lies_where_no_stroke_took_it_is_no_object(block, sizes):
    eyes, sight = Eyes(sizes), Sight(block)
    cloud = eyes.see(sight.shoot)[0].cloud
    assert eyes.see(sight.shoot, Near(cloud, 0.05))[0].verdict == "good"
    with pytest.raises(Unseen, match=r"cannot be the object: it lay 33 cm away, and the tool went 5 cm"):
        eyes.see(lambda: sight.shoot(THERE), Near(cloud, 0.05))


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (lambda scene, last: np.zeros_like(scene), "camera cam1 delivers no depth"),
        (lambda scene, last: last.copy(), "camera cam1 delivers the same image again"),
    ],
)
def test_a_camera_that_stops_is_named(block, sizes, fault, said):
    eyes, sight = Eyes(sizes), Sight(block)
    last = eyes.see(sight.shoot)[1]

    def shoot() -> Scene:
        scene = sight.shoot()
        scene.depth[1] = fault(scene.depth[1], last.depth[1])
        return scene

    with pytest.raises(Unseen, match=said):
        eyes.see(shoot)


def test_an_arm_that_stays_over_the_object_is_left_out(block):
    found = play(block, sight=SightParams(arm=True), success=0.001)
    assert off(found.steps[0].after, found.true[1]) < 0.015


def test_goals_that_cannot_be_this_objects_are_refused(block, sizes):
    cloud = look(*Sight(block).shoot()).cloud
    require_goal(cloud + np.array([0.1, 0, 0], np.float32), cloud, 50, sizes.sizes)
    top = cloud[cloud[:, 2] > 0.03]
    require_goal(np.concatenate([top, top + np.float32([0.001, 0, 0])]), cloud, 50, None)
    with pytest.raises(DataError, match="the goal lies 30 mm below the table"):
        require_goal(cloud - np.float32([0, 0, 0.03]), cloud, 50, None)
    with pytest.raises(DataError, match="the goal lies 30 mm above the table"):
        require_goal(cloud + np.array([0, 0, 0.03], np.float32), cloud, 50, sizes.sizes)
    with pytest.raises(DataError, match=r"the goal is no cloud of this object: it is 10\.\d"):
        require_goal(cloud * np.float32([0.5, 0.5, 1]), cloud, 50, sizes.sizes)
    with pytest.raises(DataError, match=r"the goal's particles lie 1\.\d cm apart, the object's 2\.\d cm"):
        require_goal(cloud * np.float32([0.5, 0.5, 1]), cloud, 50, None)


def test_a_check_that_there_is_not_is_no_check_to_accept(block):
    with pytest.raises(UsageError, match="no check is called sized"):
        play(block, accept=("sized",))


def test_cameras_may_be_few_noisy_and_elsewhere(block):
    sight = Sight(block, SightParams(cameras=2, moved=0.003, turned=0.5))
    scene = sight.shoot()
    assert len(scene.cameras) == len(scene.color) == 2
    for said, true in zip(scene.cameras, sight.renderer.cameras, strict=True):
        assert np.linalg.norm(said.T_world_camera[:3, 3] - true.T_world_camera[:3, 3]) == pytest.approx(0.003)
        turn = said.T_world_camera[:3, :3] @ true.T_world_camera[:3, :3].T
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(0.5, abs=1e-3)
    clear, noisy = (Sight(block, SightParams(cameras=1, noise=noise)).shoot().depth[0] for noise in (0.0, 2.0))
    both = (clear > 0) & (noisy > 0)
    assert np.abs(clear[both].astype(int) - noisy[both]).mean() > 1


def test_one_camera_sees_one_side_of_a_thing_that_is_no_smaller_for_that():
    toy = make("toy")
    toy.reset(options={"pose": [0.0, 0.0, 2.2]})
    sizes = Sizes.of([toy.particles()])
    seen = Eyes(LookSettings(sizes=sizes)).see(Sight(toy, SightParams(cameras=1)).shoot)[0]
    size = size_of(seen.particles)
    assert sizes.apart(size)["width"] > 1.2
    assert sizes.apart(size, one_side=True)["width"] < 1.2


def test_a_cloth_that_is_folded_in_its_place_is_not_there(monkeypatch):
    """Particles chosen in a folded cloth lie where that very fold would lie best: 4.5 cm that are turned over hide there."""
    cloth, shoot = make("cloth"), Sight.shoot
    cloth.reset(seed=3)
    flat, edge = cloth.nodes, cloth.nodes[:, 0].max() - 0.045
    over = flat[:, 0] > edge
    folded = np.where(over[:, None], flat * [-1, 1, 1] + [2 * edge, 0, 0.012], flat)
    goal = look(*shoot(Sight(cloth), flat)).cloud
    monkeypatch.setattr(Sight, "shoot", lambda self, shape=None, tip=None: shoot(self, folded, tip))
    settings = PlanParams(**SETTINGS | {"env": "cloth", "keep": "resample"})
    found = play_seen(cloth, None, settings, goal, start=0, goal=0)
    assert (found.ending, len(found.steps)) == ("strokes spent", 1)
    assert found.start_distance > settings.success


def test_particles_are_put_in_the_order_of_the_nearest_state():
    rng = np.random.default_rng(0)
    state = rng.uniform(-0.1, 0.1, (30, 3))
    mixed = rng.permutation(state) + rng.normal(0, 1e-4, (30, 3))
    np.testing.assert_allclose(alike(mixed, state + 0.2, state), state, atol=1e-3)


@pytest.mark.parametrize(("name", "copies"), [("tblock", 1), ("rope-stiff", 2), ("cloth", 4)])
def test_distance_counts_to_the_nearest_goal_that_clouds_cannot_tell_apart(name, copies):
    environment = make(name)
    state, _ = environment.reset(seed=2)
    goal = environment.goal_state(np.random.default_rng(4))
    np.testing.assert_array_equal(goal.particles, environment.goal(np.random.default_rng(4)))
    np.testing.assert_array_equal(environment.particles(), state)
    np.testing.assert_allclose(environment.particles(goal.shape), goal.particles, atol=1e-6)
    assert len(goal.copies) == copies
    for copy in goal.copies[1:]:
        assert np.linalg.norm(copy - goal.particles, axis=1).mean() > 0.1
        assert nearest_distance(copy, goal.copies) == 0
        assert abs(copy.mean(0) - goal.particles.mean(0)).max() < 0.01
