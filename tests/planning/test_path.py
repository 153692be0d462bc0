"""The way of the tool around a stroke, and boxes that it keeps out of: no candidate that enters one is ever chosen."""

import numpy as np
import pytest
import torch

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.planning.model import Model
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.path import LET_GO, LIFT, hits, tool_boxes, tool_path
from piegraph_cli.planning.told import answer_value
from piegraph_cli.recording.ground import moved
from tests.planning.table import SQUARE

ENDS = np.array([[-0.1, 0.0], [0.0, 0.0]], np.float32)
SETTINGS = PlanParams(speed=0.05, approach_height=0.2, retreat=0.03)
CLOUD = np.concatenate([SQUARE + np.float32([0.01 * k, 0, 0]) for k in range(3)])
FEW = {"samples": 60, "cem_iterations": 2, "success": 1e-3}


def test_a_push_comes_down_pushes_goes_back_and_rises():
    path = tool_path(ENDS, PUSH, SQUARE, SETTINGS)
    low = 0.005  # half of the object's height
    x = [-0.1, -0.1, 0.0, -0.03, -0.03]
    np.testing.assert_allclose(path.points, np.column_stack([x, np.zeros(5), [0.2, low, low, low, 0.2]]), atol=1e-9)
    np.testing.assert_allclose(np.diff(path.times), np.array([0.195, 0.1, 0.03, 0.195]) / 0.05)
    assert path.times[0] == 0
    assert not path.closed.any()


def test_a_pick_grasps_at_the_particles_height_carries_high_and_lets_go():
    state = SQUARE + np.float32([0, 0, 0.02])
    path = tool_path(np.array([state[7, :2], [0.2, 0.1]], np.float32), PICK, state, SETTINGS)
    grip = 0.03
    np.testing.assert_allclose(path.points[:, 2], [0.2, grip, grip + LIFT, grip + LIFT, grip + LET_GO, 0.2], atol=1e-6)
    assert path.closed.tolist() == [False, True, True, True, False, False]


def test_noise_below_the_table_does_not_send_the_tool_there():
    sunk = SQUARE - np.float32([0, 0, 0.03])
    push, pick = (tool_path(ENDS, mode, sunk, SETTINGS) for mode in (PUSH, PICK))
    assert (push.points[:, 2].min(), pick.points[:, 2].min()) == (0, 0)


def test_a_tool_that_would_come_through_the_object_is_refused():
    model, tall = Model("static", None), np.concatenate([CLOUD, CLOUD + np.float32([0, 0, 0.05])])
    asked = {"goal_pose": (0.1, 0, 0), "modes": ("push",)} | FEW
    with pytest.raises(UsageError, match=r"come and go at 0\.05 m, through an object that is 0\.060 m high"):
        model.plan(tall, approach_height=0.05, **asked)
    assert len(model.plan(tall, approach_height=0.07, **asked).steps) == 1


@pytest.mark.parametrize("change", [{"speed": 1e-320}, {"speed": 100}, {"temperature": 1e-300}])
def test_speeds_and_temperatures_that_no_arithmetic_bears_are_refused(change):
    with pytest.raises(UsageError, match=next(iter(change))):
        Model("static", None).plan(CLOUD, goal_pose=(0.1, 0, 0), planner="mppi", **change, **FEW)


AHEAD, ASIDE, ACROSS = ((0.0, 0.0), (1.0, 0.0)), ((0.0, 0.0), (0.0, 1.0)), ((0.0, 0.0), (1.0, 1.0))


@pytest.mark.parametrize(
    ("ends", "mode", "box", "hit"),
    [
        (AHEAD, PUSH, (0.4, 0.6, -0.1, 0.1, 0, 0.3), True),
        (AHEAD, PUSH, (0.4, 0.6, 0.01, 0.2, 0, 0.3), True),  # the tool has a radius of 2 cm
        (AHEAD, PUSH, (0.4, 0.6, 0.03, 0.2, 0, 0.3), False),
        (AHEAD, PUSH, (1.1, 1.2, -0.1, 0.1, 0, 0.3), False),
        (AHEAD, PUSH, (-0.3, -0.1, -0.1, 0.1, 0, 0.3), False),
        (AHEAD, PUSH, (0.4, 0.6, -0.1, 0.1, -0.2, -0.1), False),
        (ASIDE, PUSH, (-0.1, 0.1, 0.4, 0.6, 0, 0.3), True),
        (ACROSS, PUSH, (0.4, 0.6, -0.1, 0.1, 0, 0.3), False),
        (AHEAD, PICK, (0.4, 0.6, -0.1, 0.1, 0, 0.04), False),  # carried over what is low
        (AHEAD, PICK, (0.4, 0.6, -0.1, 0.1, 0, 0.06), True),
        (AHEAD, PICK, (0.9, 1.1, -0.1, 0.1, 0, 0.04), True),  # but not let down on it
        (AHEAD, PICK, (-0.1, 0.1, -0.1, 0.1, 0, 0.04), True),
    ],
)
def test_a_box_is_hit_by_what_passes_it_lower_than_its_top(ends, mode, box, hit):
    start, end = (torch.tensor([place, place]) for place in ends)
    picks = torch.tensor([mode == PICK] * 2)
    assert hits(start, end, picks, tool_boxes([box], 0.02)).tolist() == [hit, hit]


def test_no_candidate_that_enters_a_box_is_chosen_and_none_left_is_said():
    model = Model("static", None)
    free = model.plan(CLOUD, goal_pose=(0.1, 0.0, 0.0), modes=("push",), **FEW)
    start, end = free.strokes.ends[0].numpy()
    middle = (start + end) / 2
    box = (*np.repeat(middle, 2) + np.tile([-0.004, 0.004], 2), 0.0, 0.1)
    settings = {"keep_out": (box,), "modes": ("push",), "pusher_radius": 0.01}
    there = model.plan(CLOUD, goal_pose=(0.1, 0.0, 0.0), **settings, **FEW)
    looked = there.steps[0].plan.candidates
    ends, costs = looked.strokes.ends.flatten(0, 2), looked.costs.flatten()
    along = torch.linspace(0, 1, 200)[:, None, None]
    points = ends[:, 0] * (1 - along) + ends[:, 1] * along
    low, high = torch.tensor(box[:4:2]) - 0.01, torch.tensor(box[1:4:2]) + 0.01
    entered = ((points > low) & (points < high)).all(-1).any(0)
    assert entered.any()
    assert (costs[entered] > 1).all(), "none of them can win"
    everywhere = {"keep_out": "-1,1,-1,1,0,0.1"}
    with pytest.raises(DataError, match=r"outside the boxes of plan\.keep_out"):
        model.plan(CLOUD, goal_pose=(0.1, 0, 0), **everywhere, **FEW)


def test_a_retreat_may_not_leave_the_workspace():
    model, limits = Model("static", None), (-0.075, 0.4, -0.4, 0.4, 0.0, 0.3)
    for retreat, beyond in ((0.0, False), (0.9, True)):
        asked = {"retreat": retreat, "workspace": limits, "modes": ("push",)} | FEW
        if beyond:
            with pytest.raises(DataError, match="no stroke touches the object"):
                model.plan(CLOUD, goal_pose=(0.1, 0, 0), **asked)
        else:
            assert len(model.plan(CLOUD, goal_pose=(0.1, 0, 0), **asked).steps) == 1
    with pytest.raises(UsageError, match=r"0\.1 m is outside the workspace's heights, 0 to 0\.05 m"):
        model.plan(CLOUD, goal_pose=(0.1, 0, 0), workspace=(-1, 1, -1, 1, 0, 0.05))


def test_the_path_is_told_in_the_frame_that_was_asked_for():
    found = Model("static", None).plan(CLOUD, goal_pose=(0.1, 0, 0), horizon=2, **FEW)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 2, 3]
    plain, there = (answer_value(found, PlanParams(), frame, 4) for frame in (None, T))
    for one, two in zip(plain["strokes"], there["strokes"], strict=True):
        for before, after in zip(one["path"], two["path"], strict=True):
            np.testing.assert_allclose(moved(np.array(before["point"]), T), after["point"], atol=1e-6)
            assert (before["time"], before["part"]) == (after["time"], after["part"])
        np.testing.assert_allclose(moved(np.array(one["predicted"]), T), two["predicted"], atol=1e-5)
        assert [point["part"] for point in one["path"]][:2] == ["approach", "approach"]
    costs = [candidate["cost"] for candidate in plain["candidates"]]
    assert (len(costs), costs) == (4, sorted(costs))
    assert len(plain["candidates"][0]["strokes"]) == len(plain["strokes"]) == 2
    assert plain["candidates"][0]["strokes"][0]["start"] == plain["strokes"][0]["start"]
