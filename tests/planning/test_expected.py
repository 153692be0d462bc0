"""What a plan is asked about is held against the trained object: other things, a table or a hand are said, good clouds not."""

import functools
import re
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from piegraph_cli import environments
from piegraph_cli.dynamics.models import Trained
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.physics.particles import Sizes, _rectangle, choose_particles
from piegraph_cli.physics.rigid import moved_in_plane, planar_fit
from piegraph_cli.planning.expected import (
    check_against,
    check_folds,
    check_laid,
    check_object,
    require_level,
    require_order,
)
from piegraph_cli.planning.goals import Goal, move_in_plane
from piegraph_cli.planning.model import Model
from piegraph_cli.planning.params import PlanParams
from tests.planning.test_goals import sampled

RNG = np.random.default_rng(0)
STROKES = {"tblock": 1, "rope-bendy": 3, "tshirt": 2, "toy": 2, "rope-stiff": 2}


@functools.cache
def seen(name: str) -> tuple[Sizes, np.ndarray, tuple[np.ndarray, ...]]:
    """The sizes of an object over a few strokes, it at rest, and what is seen of it in others, with noise."""
    env = environments.make(name)
    states, looks = [], []
    for seed in (0, 1):
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        for k in range(STROKES[name] + 1):
            if k:
                env.step(env.sample_stroke(rng))
            states.append(env.particles()) if seed == 0 else looks.append(
                sampled(env.surface(), env.triangles, 3000, k) + RNG.normal(0, 0.0015, (3000, 3)).astype(np.float32)
            )
    return Sizes.of(states), states[0], tuple(looks)


def check(cloud: np.ndarray, sizes: Sizes) -> list[str]:
    return check_object(cloud, choose_particles(cloud, 50), sizes)


@pytest.mark.parametrize("name", STROKES)
def test_the_trained_object_is_silent_in_every_pose_and_bend(name):
    sizes, _, looks = seen(name)
    for look in looks:
        for yaw in (0.0, 1.0, 2.5):
            assert check(move_in_plane(look, (0.1, -0.1, yaw)), sizes) == []
        assert check(look[RNG.permutation(len(look))[:450]], sizes) == [], "seen sparsely"


def boxed(x: float, y: float, z: tuple[float, float], at: Sequence[float] = (0, 0), count: int = 1500) -> np.ndarray:
    low, high = [at[0] - x / 2, at[1] - y / 2, z[0]], [at[0] + x / 2, at[1] + y / 2, z[1]]
    return RNG.uniform(low, high, (count, 3)).astype(np.float32)


def test_another_object_or_more_than_the_object_is_said_with_its_cause():
    sizes, _, (cloud, *_) = seen("tblock")
    middle = cloud.mean(0)
    table = boxed(0.3, 0.3, (-0.002, 0.002), middle, 4000)
    hand = boxed(0.06, 0.06, (0.04, 0.15), middle)
    other = boxed(0.1, 0.08, (0, 0.03), middle + np.array([0.3, 0, 0]))
    for wrong, message in (
        (boxed(0.34, 0.12, (0, 0.035)), r"not the trained object: it is 3[34]\.. × 1[12]\.. cm.*20\.0 × 20\.0 cm"),
        (cloud * [1.5, 1.5, 1], "not the trained object"),
        (cloud * 0.6, "not the trained object"),
        (np.concatenate([cloud, table]), "the table is in the cloud"),
        (np.concatenate([cloud, hand]), r"something reaches 1[45] cm high, the trained object 3\.5 cm: a hand"),
        (np.concatenate([cloud, other]), "2 things are in the cloud"),
        (cloud * 1000, r"these are millimetres, not metres: it is 20[0-9]{3}\.. × "),
        (cloud * 100, "these are centimetres"),
        (cloud / 0.0254, "these are inches"),
        (
            cloud + np.float32([0, 0, 0.03]),
            "its top lies 3[0-3] mm higher than the trained object's: .* a table that is not at z = 0",
        ),
        (cloud - np.float32([0, 0, 0.018]), "its top lies 1[4-9] mm lower than the trained object's"),
    ):
        with pytest.raises(DataError, match=message) as caught:
            check(wrong.astype(np.float32), sizes)
        assert (caught.value.exit_code, bool(caught.value.hint)) == (3, True)
    rim = np.concatenate([cloud, boxed(0.24, 0.24, (-0.002, 0.002), middle, 4000)])
    assert check(cloud[:, [1, 0, 2]] * [1.25, 1.25, 1], sizes)[0].startswith(
        "this may not be the trained object: it is 2"
    )
    with pytest.raises(DataError, match="the table"):
        check(rim.astype(np.float32), sizes)


def test_a_goal_that_is_another_object_is_said_and_planned_for_all_the_same():
    model = Model("static", trained("tblock"), PlanParams(samples=8, cem_iterations=1))
    cloud = seen("tblock")[2][0]
    assert model.plan(cloud, goal=cloud + np.float32([0.1, 0, 0])).warnings == ()
    (said,) = model.plan(cloud, goal=scaled(cloud, 1.1) + np.float32([0.1, 0, 0])).warnings
    assert "1.10 times as large as the object now" in said
    (said,) = model.plan(cloud, goal=boxed(0.34, 0.12, (0, 0.035), [0.1, 0])).warnings
    assert said.startswith("the goal: this is not the trained object: it is 3")
    assert model.plan(cloud, goal=cloud[:20], cost="chamfer").warnings == ()


def test_a_goal_of_the_same_size_and_another_shape_is_said_of_what_never_bends():
    model = Model("static", trained("tblock"), PlanParams(samples=8, cem_iterations=1))
    cloud = seen("tblock")[2][0]
    angle, radius = RNG.uniform(0, 2 * np.pi, 2000), 0.1 * np.sqrt(RNG.uniform(0, 1, 2000))
    disc = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(2000, 0.03)]).astype(np.float32)
    (said,) = model.plan(cloud, goal=disc).warnings
    assert said.startswith("the goal: it has nowhere the shape that the object has now")
    for yaw in (0.4, 2.0, -1.2):
        assert model.plan(cloud, goal=move_in_plane(cloud[::2], (0.05, 0.02, yaw))).warnings == ()


@pytest.mark.parametrize(("times", "unit"), [(1000, "millimetres"), (100, "centimetres"), (39.37, "inches")])
def test_a_goal_in_other_units_is_refused_with_the_unit(times, unit):
    cloud = seen("tblock")[2][0]
    with pytest.raises(DataError, match=f"these are {unit}, not metres") as caught:
        require_level(cloud * np.float32(times), cloud)
    assert f"divide by {times:g}" in caught.value.hint
    require_level(cloud * np.float32([3, 3, 1]), cloud)


def test_a_bending_thing_may_be_smaller_but_not_longer():
    sizes, _, (cloud, *_) = seen("rope-bendy")
    assert check((cloud * [0.7, 0.7, 1]).astype(np.float32), sizes) == []
    with pytest.raises(DataError, match="another length"):
        check((cloud * [1.5, 1.5, 1]).astype(np.float32), sizes)
    with pytest.raises(DataError, match="2 things"):
        check(np.concatenate([cloud, boxed(0.1, 0.08, (0, 0.02), cloud.mean(0) + np.array([0.35, 0, 0]))]), sizes)


def trained(name: str) -> Trained:
    sizes, rest, _ = seen(name)
    return Trained(torch.nn.Identity(), None, 0.01, (0, 1), len(rest), rest, sizes)  # type: ignore[arg-type]


def test_layers_that_lie_on_one_another_are_said_of_what_bends():
    flat = trained("tshirt")
    half = np.where(flat.rest[:, :1] > np.median(flat.rest[:, 0]), -1, 1)
    middle = np.median(flat.rest[:, 0])
    folded = (flat.rest - [middle, 0, 0]) * np.column_stack([half, half * 0 + 1, half * 0 + 1]) + [0, 0, 0.003]
    (said,) = check_folds(folded.astype(np.float32), flat, 0.05)
    assert said.startswith("the object is folded")
    assert check_folds(flat.rest, flat, 0.05) == []
    stiff = trained("tblock")
    assert check_folds((stiff.rest * 0.5).astype(np.float32), stiff, 0.05) == [], "it does not bend"


def test_the_narrowest_rectangle():
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), -1).reshape(-1, 2)
    for yaw in np.linspace(0, 3, 7):
        turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        assert _rectangle(grid @ turn) == pytest.approx((3, 2))
    assert _rectangle(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])) == pytest.approx((8**0.5, 0), abs=1e-9)
    assert _rectangle(np.zeros((2, 2))) == (0, 0)


@pytest.mark.parametrize("yaw", [0.0, 1.0, 2.2, -1.5, 3.1])
def test_a_pose_in_the_world_is_that_of_the_trained_rest_shape(yaw):
    rest = trained("tblock").rest
    env = environments.make("tblock")
    env.reset(seed=4)
    cloud = sampled(env.surface(), env.triangles, 3000, 0)
    particles = choose_particles(cloud, 50).astype(np.float32)
    found = Goal.at((0.12, -0.07, yaw), rest, cloud, particles)
    assert found.particles is not None
    assert len(found.particles) == 1
    placed = move_in_plane(rest, (0, 0, yaw)) - rest[:, :2].mean(0) @ np.eye(2, 3) + [0.12, -0.07, 0]
    now = env.particles()  # the same particles as at rest
    truth = moved_in_plane(particles[:, :2], planar_fit(now[:, :2], placed[:, :2]))
    assert np.linalg.norm(found.particles[0, :, :2] - truth, axis=1).mean() < 0.004


def test_what_is_bent_is_measured_against_the_rest_shape_there():
    rest = np.column_stack([np.linspace(-0.2, 0.2, 50), np.zeros(50), np.full(50, 0.01)]).astype(np.float32)
    angle = RNG.uniform(0, 4.0, 2000)
    bent = np.column_stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), np.full(2000, 0.01)]).astype(np.float32)
    goal = Goal.at((0.3, 0.1, np.pi / 2), rest, bent, choose_particles(bent, 50))
    assert goal.particles is None
    np.testing.assert_allclose(goal.points[:, 0], 0.3, atol=1e-6)
    np.testing.assert_allclose(np.sort(goal.points[:, 1]), np.linspace(-0.1, 0.3, 50), atol=1e-6)


def test_the_pose_goes_where_the_table_is_and_needs_a_trained_model():
    cloud = seen("tblock")[2][0]
    with pytest.raises(UsageError, match="static knows no rest shape"):
        Model("static", None).plan(cloud, goal_at=(0, 0, 0))
    model = Model("static", trained("tblock"), PlanParams(samples=8, cem_iterations=1))
    plain = model.plan(cloud, goal_at=(0.1, 0.1, 0.3))
    raised = model.plan(cloud + np.float32([0, 0, 0.2]), goal_at=(0.1, 0.1, 0.3), table=(0.2, 0, 0))
    np.testing.assert_allclose(raised.goal, plain.goal, atol=1e-5)
    np.testing.assert_allclose(plain.goal[:, :2].mean(0), [0.1, 0.1], atol=0.01)


def test_particles_that_were_tracked_bring_their_rest_shape():
    model = Model("static", trained("tshirt"), PlanParams(samples=8, cem_iterations=1))
    rest = model.trained.rest
    folded = rest * np.float32([0.9, 1, 1])
    found = model.plan(folded, goal_pose=(0.1, 0, 0), rest=rest)
    np.testing.assert_array_equal(found.start, folded)
    assert found.warnings == ()
    with pytest.raises(DataError, match="50 particles, 49 at rest"):
        model.plan(folded, goal_pose=(0.1, 0, 0), rest=rest[1:])


def scaled(cloud: np.ndarray, factor: float) -> np.ndarray:
    middle = cloud.mean(0) * [1, 1, 0]
    return ((cloud - middle) * factor + middle).astype(np.float32)


def test_a_goal_of_another_scale_or_height_is_said():
    sizes, _, (cloud, *others) = seen("tblock")
    for goal in (*others, move_in_plane(cloud, (0.1, 0.05, 1.0)), cloud[cloud[:, 0] < np.quantile(cloud[:, 0], 0.9)]):
        assert check_against(goal, cloud, 50, sizes) == []
    for factor in (0.9, 1.1):
        (said,) = check_against(scaled(cloud, factor) + np.array([0.1, 0, 0]), cloud, 50, sizes)
        assert f"it is {factor:.2f} times as large as the object now" in said
    for lift in (0.01, -0.01):
        (said,) = check_against(cloud + np.array([0.1, 0, lift]), cloud, 50, sizes)
        assert f"it lies 10 mm {'above' if lift > 0 else 'below'} the table" in said
    bending, _, (rope, bent, *_) = seen("rope-bendy")
    assert check_laid(bent, rope, choose_particles(rope, 50), Goal(bent), bending) == []
    assert check_against(bent, rope, 50, bending) == []


def tilted(cloud: np.ndarray, degrees: float, axis: int) -> np.ndarray:
    middle = cloud.mean(0) * np.array([1, 1, 0])
    return (cloud - middle) @ Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[axis]).as_matrix().T + middle


def test_small_differences_from_the_object_laid_there_are_said_of_what_never_bends():
    sizes, _, (cloud, *others) = seen("tblock")
    particles = choose_particles(cloud, 50)

    def laid(goal: np.ndarray) -> list[str]:
        return check_laid(goal, cloud, particles, Goal.of_cloud(goal, cloud, particles), sizes)

    for goal in (*others, move_in_plane(cloud, (0.1, 0.05, 1.0)), cloud[cloud[:, 0] < np.quantile(cloud[:, 0], 0.9)]):
        assert laid(goal) == []
    there = move_in_plane(cloud, (0.1, 0.05, 1.0))
    for axis in (0, 1):
        assert "it is tilted by" in laid(tilted(there, 3.0, axis))[0]
    for factor in (0.95, 1.05):
        (told,) = re.findall(r"it is ([0-9.]+) times as large", laid(there * factor)[0])
        assert float(told) == pytest.approx(factor, abs=0.011)
    for lift in (0.004, -0.004):
        assert f" mm {'above' if lift > 0 else 'below'} that of the object" in laid(there + np.array([0, 0, lift]))[0]


def test_a_round_thing_laid_a_little_aside_is_not_tilted():
    sizes, _, (cloud, *others) = seen("toy")
    particles = choose_particles(cloud, 50)
    for goal in (*others, move_in_plane(cloud, (0.1, 0.05, 1.0)) + np.float32([0.003, 0, 0])):
        assert check_laid(goal, cloud, particles, Goal.of_cloud(goal, cloud, particles), sizes) == []


@pytest.mark.parametrize(
    "order", [np.arange(50)[::-1], np.random.default_rng(0).permutation(50), np.roll(range(50), 7)]
)
def test_particles_in_another_order_are_refused(order):
    rng = np.random.default_rng(1)
    there = rng.permutation(np.stack(np.meshgrid(np.arange(10), np.arange(5), [1]), -1).reshape(-1, 3) * 0.02)
    turned = there @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]) + [0.1, 0, 0]
    folded = np.abs(there - [0.09, 0, 0])
    for now in (turned, folded, there + rng.normal(0, 0.005, there.shape)):
        require_order(now, there, "rest")
        require_order(there, now, "rest")
    with pytest.raises(DataError, match="rest: its particles are in another order"):
        require_order(turned, there[order], "rest")
    model = Model("static", None, PlanParams(model="static"))
    strokes = Strokes.of([[-0.2, 0.0]], [[-0.1, 0.0]], 0)
    assert model.predict(turned, strokes, rest=there).shape == (1, 50, 3)
    with pytest.raises(DataError, match="in another order"):
        model.predict(turned, strokes, rest=there[order])
    with pytest.raises(DataError, match="goal: its particles are in another order"):
        model.plan(turned, goal=turned[order] + [0.05, 0, 0], corresponds=True)
