"""Whole recordings: the hand's way through pushes and picks, and what is written as true, on small pictures."""

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the `sim` extra is not installed: pip install 'piegraph[sim]'")

from piegraph_cli import environments
from piegraph_cli.environments.base import Environment, Motion
from piegraph_cli.environments.hand_motion import arm_at
from piegraph_cli.environments.recording import plan_moments, record, truth_arrays
from piegraph_cli.environments.rig import camera_rig
from piegraph_cli.evaluation.truth import surface_distance
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.workspace.artifact import read_artifact, write_artifact

SIDE = 9
LIFT = np.concatenate([np.linspace(0, 0.06, 4), np.full(4, 0.06), np.linspace(0.06, 0, 4)])


class Sheet(Environment):
    """A sheet of 24 cm, 8 mm thick, that follows the hand the more, the nearer to the grasp; no physics."""

    modes = (PICK, PUSH)

    def __init__(self):
        super().__init__(25)
        line = np.linspace(-0.12, 0.12, SIDE)
        self.flat = np.stack([*np.meshgrid(line, line, indexing="xy"), np.full((SIDE, SIDE), 0.008)], -1).reshape(-1, 3)
        corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
        top = np.concatenate([
            np.column_stack([corner, corner + 1, corner + SIDE + 1]),
            np.column_stack([corner, corner + SIDE + 1, corner + SIDE]),
        ])  # fmt: skip
        grid = np.arange(SIDE**2).reshape(SIDE, SIDE)
        rim = np.concatenate([grid[0], grid[1:, -1], grid[-1, -2::-1], grid[-2:0:-1, 0]])
        low, after = rim + SIDE**2, np.roll(rim, -1)
        wall = [np.column_stack([low, after + SIDE**2, after]), np.column_stack([low, after, rim])]
        self.triangles = np.concatenate([top, top[:, ::-1] + SIDE**2, *wall])
        self.nodes = self.flat

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.nodes = self.flat
        return self.particles(), {}

    def particles(self, shapes=None):
        nodes = self.nodes if shapes is None else shapes
        grid = np.arange(SIDE**2).reshape(SIDE, SIDE)
        return nodes[..., grid[::2, ::2].ravel(), :].astype(np.float32)

    def surface(self, shapes=None):
        nodes = self.nodes if shapes is None else shapes
        return np.concatenate([nodes, nodes - [0, 0, 0.008]], -2).astype(np.float32)

    def get_state(self):
        return {"nodes": self.nodes}

    def set_state(self, state):
        self.nodes = state["nodes"]

    def goal(self, rng):
        return self.particles()

    def _outline(self):
        return self.nodes[:, :2], 0.0

    def _push(self, start, end):
        return self._carry(np.linspace(start, end, 12), np.zeros(12))

    def _pick(self, start, end):
        path = np.concatenate([np.tile(start, (4, 1)), np.linspace(start, end, 4), np.tile(end, (4, 1))])
        return self._carry(path, LIFT)

    def _carry(self, path, lift):
        share = np.exp(-((np.linalg.norm(self.nodes[:, :2] - path[0], axis=1) / 0.06) ** 2))[None, :, None]
        moved = np.column_stack([path - path[0], lift])[:, None] * share
        shapes = self.nodes + moved
        self.nodes = shapes[-1]
        return Motion(shapes, np.column_stack([path, 0.008 + lift]), bool(lift.any()))


@pytest.fixture(scope="module")
def block():
    return environments.make("tblock")


def moves(moments):
    """Whether the object moves from each frame to the next."""
    shapes = np.array([m.shape for m in moments])
    return np.abs(np.diff(shapes, axis=0)).reshape(len(shapes) - 1, -1).max(1) > 0


@pytest.mark.parametrize("make", [lambda: environments.make("tblock"), Sheet])
def test_a_recording_begins_and_ends_without_the_hand(make, hand):
    moments = plan_moments(make(), seed=5, strokes=2, hand=hand)
    out = [k for k, m in enumerate(moments) if m.tip is None]
    assert out == [0, 1, len(moments) - 2, len(moments) - 1]
    assert sorted({m.stroke for m in moments}) == [-1, 0, 1]
    tips = [m.tip for m in moments if m.tip is not None]
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() < 0.2
    assert len([m for before, m in pairwise(moments) if m.stroke < 0 <= before.stroke]) == 2
    moving = moves(moments)
    assert moving.any()
    assert all(moments[k].stroke >= 0 and moments[k + 1].stroke >= 0 for k in np.flatnonzero(moving))


def test_recording_is_bit_equal_and_true(block, hand):
    cameras = camera_rig(80, 60)[:2]
    runs = []
    for _ in range(2):
        stream = record(block, 6, 1, cameras, hand)
        runs.append([next(stream) for _ in range(6)])
    for first, second in zip(*runs, strict=True):
        assert all(
            np.array_equal(a, b) for a, b in zip(first.color + first.depth, second.color + second.depth, strict=True)
        )
        assert np.array_equal(first.stamps, second.stamps)
    frames = runs[0]
    assert frames[0].color[0].shape == (60, 80, 3)
    assert frames[0].depth[0].dtype == np.uint16
    assert not frames[0].hand_mask.any()
    assert np.isnan(frames[0].landmarks).all()
    assert frames[-1].hand_mask.any()
    assert np.isfinite(frames[-1].landmarks).all()
    assert not (frames[-1].hand_mask & frames[-1].object_mask).any()
    stamps = np.array([frame.stamps for frame in frames])
    assert np.abs(stamps - np.array([frame.moment.time for frame in frames])[:, None]).max() <= 0.005
    assert (np.diff(stamps, axis=0) > 0).all()


def test_a_pick_opens_closes_holds_and_opens(hand):
    moments = plan_moments(Sheet(), seed=1, strokes=2, hand=hand)
    for number in (0, 1):
        held = [k for k, m in enumerate(moments) if m.stroke == number]
        assert all(moments[k].grip.pinch == 1.0 for k in held)
        for beside, inner in ((held[0] - 1, held[0]), (held[-1] + 1, held[-1])):
            assert 0 < moments[beside].grip.pinch < 1
            np.testing.assert_allclose(moments[beside].tip - moments[inner].tip, [0, 0, 0.012], atol=1e-12)
            assert np.array_equal(moments[beside].shape, moments[inner].shape)
        heights = np.array([moments[k].tip[2] for k in held])
        assert heights.max() == pytest.approx(heights[0] + 0.06)
        grasped = np.argmin(np.linalg.norm(moments[held[0]].shape[:, :2] - moments[held[0]].tip[:2], axis=1))
        for k in held:
            arm = arm_at(hand, moments[k].grip, moments[k].tip)
            middle = (arm.landmarks[4] + (arm.landmarks[8] + arm.landmarks[12]) / 2) / 2
            np.testing.assert_allclose(middle - [0, 0, 0.008], moments[k].tip, atol=1e-9)
            assert np.linalg.norm(moments[k].tip - moments[k].shape[grasped]) < 0.002


def test_pushes_and_picks_mix_in_one_recording(hand):
    moments = plan_moments(Sheet(), 2, 6, hand, ("push", "pick"))
    pinch = [{m.grip.pinch for m in moments if m.stroke == k} for k in range(6)]
    assert all(len(p) == 1 for p in pinch)
    assert set.union(*pinch) == {0.0, 1.0}


def test_a_deforming_surface_is_rendered_and_written_frame_by_frame(hand, tmp_path):
    sheet, cameras = Sheet(), camera_rig(80, 60)
    frames = list(record(sheet, 3, 1, cameras, hand))
    arrays = truth_arrays(sheet, frames)
    write_artifact(
        tmp_path / "truth.h5", "truth", arrays, stage="simulate", stage_version=1, key="", params={}, inputs={}
    )
    arrays = read_artifact(tmp_path / "truth.h5", "truth")
    lifted = int(arrays["vertices"][..., 2].max(1).argmax())
    assert arrays["vertices"][lifted, :, 2].max() > 0.06
    masks = ImageStack(arrays["object_mask"], arrays["object_mask_offsets"], 4, "mask")
    for k in (0, lifted, len(frames) - 1):
        assert np.array_equal(arrays["vertices"][k], sheet.surface(frames[k].moment.shape))
        for c, camera in enumerate(cameras):
            assert np.array_equal(masks.mask(k, c), frames[k].object_mask[c])
            row, column = np.nonzero(frames[k].object_mask[c] & (frames[k].depth[c] > 0))
            depth = frames[k].depth[c][row, column] * camera.depth_scale
            points = camera.unproject(np.column_stack([column, row]), depth)
            off = surface_distance(points, arrays["vertices"][k], arrays["triangles"])
            assert np.median(off) < 0.003
    on = surface_distance(arrays["particles"].reshape(-1, 3)[:25], arrays["vertices"][0], arrays["triangles"])
    assert on.max() < 1e-6


@pytest.mark.parametrize(
    ("name", "depth"),
    [("tblock", 0), ("rope-stiff", 0.008), ("rope-bendy", 0.008), ("tshirt", 0.003), ("cloth", 0.003), ("toy", 0)],
)
def test_particles_lie_in_the_surface_that_is_rendered(name, depth):
    """At most `depth` (m) below it: on its skin, or in the middle of a rope and, but for its rim, a sheet."""
    env = environments.make(name)
    env.reset(seed=2)
    shapes = env.step(env.sample_stroke(np.random.default_rng(2)))[4]["shapes"]
    for shape in (shapes[0], shapes[-1]):
        vertices = env.surface(shape)
        off = surface_distance(env.particles(shape), vertices, env.triangles)
        assert off.max() < depth + 1.5e-3
        assert np.median(off) == pytest.approx(depth, abs=1e-3)
        assert vertices[:, 2].min() > -3e-3


@pytest.mark.parametrize("name", ["tblock", "rope-bendy", "tshirt", "cloth", "toy"])
def test_surfaces_are_closed_and_face_outwards(name):
    env = environments.make(name)
    env.reset(seed=0)
    corners = env.surface().astype(float)[env.triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    assert np.abs(areas.sum(0)).max() < 1e-6 * np.linalg.norm(areas, axis=1).sum() + 1e-9
    volume = np.einsum("tc,tc->", corners[:, 0], areas) / 3
    assert volume > 5e-5
