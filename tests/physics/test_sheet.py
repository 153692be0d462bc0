"""Sheets: told from other things, followed by their pattern, and never a state that is not finite."""

from functools import partial

import cv2
import numpy as np
import pytest

from piegraph_cli.physics.params import TrackParams
from piegraph_cli.physics.sheet import Hand, SheetFollower
from piegraph_cli.physics.sheet_flow import Flow, compared
from piegraph_cli.physics.sheet_images import Lens, Shot, sampled
from piegraph_cli.physics.sheet_kernel import Cloth
from piegraph_cli.physics.sheet_mesh import is_sheet, sheet_mesh
from piegraph_cli.physics.sheet_surface import Sums, visible
from piegraph_cli.physics.tracking import track
from piegraph_cli.physics.visibility import View
from piegraph_cli.recording.camera import Camera
from tests.physics.objects import rope, surface, turned

SIDE, THICK, STEP = 0.2, 0.006, 0.004
HIGHER = np.array([0.0, 0.0, 0.02])
"""Metres: a square sheet, and how densely it is measured."""
WIDTH, HEIGHT, FOCAL = 200, 160, 200.0
PLACES = ((0.0, -0.35, 0.5), (0.3, 0.2, 0.55))


def camera(place: tuple[float, float, float]) -> Camera:
    """One that looks at the middle of the table."""
    forward = -np.array(place) / np.linalg.norm(place)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([right, np.cross(forward, right), forward]), place
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    return Camera("cam", WIDTH, HEIGHT, K, np.zeros(5), T)


CAMERAS = [camera(place) for place in PLACES]


def pattern(kind: str) -> np.ndarray:
    """Grey values [S, S] over the sheet: `print` changes every centimetre, `plain` is noise of a grey level alone."""
    rng = np.random.default_rng(3)
    if kind == "plain":
        return np.full((200, 200), 120.0)
    return cv2.resize(rng.uniform(40, 200, (20, 20)).astype(np.float32), (200, 200), interpolation=cv2.INTER_CUBIC)


def shaded(at: np.ndarray) -> np.ndarray:
    """Which places [P, 3] (m) are in one of three round shadows."""
    return np.any([np.linalg.norm(at[:, :2] - [0, y], axis=1) < 0.014 for y in (-0.04, 0, 0.04)], axis=0)


def views(pose: tuple[float, float, float], kind: str = "print", noise: int = 0, shadow: float = 1.0) -> list[View]:
    """What both cameras see of the sheet that lies turned and moved; round shadows lie beside x = `shadow` (m)."""
    rng, found, grey = np.random.default_rng(noise), [], pattern(kind)
    for one in CAMERAS:
        column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        rays = one.rays(np.column_stack([column.ravel(), row.ravel()])) @ one.T_world_camera[:3, :3].T
        origin = one.T_world_camera[:3, 3]
        hit = origin + rays * ((THICK - origin[2]) / rays[:, 2])[:, None]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        flat = (hit[:, :2] - pose[:2]) @ np.array([[c, -s], [s, c]])
        mask = (np.abs(flat) < SIDE / 2).all(1)
        place = ((flat / SIDE + 0.5) * 199).astype(np.float32)
        drawn = cv2.remap(grey, place[:, :1], place[:, 1:], cv2.INTER_LINEAR)[:, 0]
        image = np.where(mask, drawn, 70.0) * np.where(shaded(hit - [shadow, 0, 0]), 0.5, 1.0) + rng.normal(
            0, 1, len(mask)
        )
        depth = np.where(mask, (THICK - origin[2]) / rays[:, 2], -origin[2] / rays[:, 2])
        rgb = np.repeat(image.clip(0, 255).astype(np.uint8).reshape(HEIGHT, WIDTH, 1), 3, axis=2)
        units = np.rint(depth * 1000).astype(np.uint16).reshape(HEIGHT, WIDTH)
        found.append(View(one, units, mask.reshape(HEIGHT, WIDTH), partial(np.copy, rgb)))
    return found


def cloud(pose: tuple[float, float, float]) -> np.ndarray:
    """Points [P, 3] of the sheet's upper face."""
    line = np.arange(-SIDE / 2 + STEP / 2, SIDE / 2, STEP)
    flat = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    return turned(np.column_stack([flat, np.full(len(flat), THICK)]), pose)


def of_mask(mask: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    return mask[row, column]


def shots(pose: tuple[float, float, float], kind: str = "print") -> list[Shot]:
    return [
        Shot(
            Lens(v.camera),
            v.image()[..., 0],
            v.depth.astype(np.float32) / 1000,
            v.mask.astype(np.uint8),
            partial(of_mask, v.mask),
        )
        for v in views(pose, kind)
        if v.image is not None
    ]


def test_sheets_are_told_from_blocks_ropes_and_what_is_high():
    sheet = cloud((0.1, 0.05, 0.4))
    assert is_sheet(sheet)
    folded = np.where(sheet[:, :1] > 0.17, sheet + HIGHER, sheet)
    assert is_sheet(folded)
    assert not is_sheet(surface(3000, np.random.default_rng(0)))
    for bend in (0.3, 3.0):
        assert not is_sheet(np.repeat(rope(bend), 2, axis=0))
    assert not is_sheet(sheet + HIGHER)
    assert not is_sheet(sheet * [1, 0.08, 1])


@pytest.mark.parametrize("pose", [(0.02, 0.012, 0.0), (0.01, 0.0, 0.12)])
def test_a_printed_sheet_that_slides_or_turns_is_followed(pose):
    steps = [tuple(k * part for part in pose) for k in range(5)]
    result = track([cloud(p) for p in steps], TrackParams(), views=[views(p, noise=k) for k, p in enumerate(steps)])
    assert result.sheet
    moved = turned(result.positions[0], steps[-1])
    still = np.linalg.norm(result.positions[0] - moved, axis=1).mean()
    assert np.linalg.norm(result.positions[-1] - moved, axis=1).mean() < min(0.003, 0.1 * still)


def test_a_setting_says_what_is_followed_and_no_colours_mean_a_solid():
    clouds, seen = [cloud((0.0, 0.0, 0.0))] * 2, [views((0.0, 0.0, 0.0))] * 2
    assert not track(clouds, TrackParams(object="solid"), views=seen).sheet
    assert not track(clouds, TrackParams()).sheet
    bare = [[View(v.camera, v.depth, v.mask) for v in of] for of in seen]
    assert not track(clouds, TrackParams(), views=bare).sheet
    flying = [points + HIGHER for points in clouds]
    assert not track(flying, TrackParams(), views=seen).sheet
    assert track(flying, TrackParams(object="sheet"), views=seen).sheet


def test_plain_pixels_tell_of_no_flow():
    assert not any(shot.textured.any() for shot in shots((0.0, 0.0, 0.0), "plain"))
    for shot in shots((0.0, 0.0, 0.0)):
        assert shot.textured[shot.mask > 0].mean() > 0.8
        assert not shot.textured[shot.mask == 0].any()


def test_a_shadow_that_passes_over_a_plain_sheet_does_not_move_it():
    pose, passing = (0.0, 0.0, 0.0), [1.0, 0.05, 0.03, 0.01, -0.01]
    seen = [views(pose, "plain", k, shadow) for k, shadow in enumerate(passing)]
    result = track([cloud(pose)] * 5, TrackParams(), views=seen)
    assert np.linalg.norm(result.positions[-1] - result.positions[0], axis=1).mean() < 0.003


def test_a_plain_sheet_that_slides_is_drawn_along_by_its_outline():
    steps = [(0.008 * k, 0.0, 0.0) for k in range(5)]
    result = track([cloud(p) for p in steps], TrackParams(), views=[views(p, "plain", k) for k, p in enumerate(steps)])
    moved = turned(result.positions[0], steps[-1])
    assert np.linalg.norm(result.positions[-1] - moved, axis=1).mean() < 0.3 * 0.032


def test_what_an_arm_cuts_off_the_mask_stays_where_it_is():
    pose = (0.0, 0.0, 0.0)
    seen = [views(pose, noise=k) for k in range(4)]
    for view in (view for of in seen[1:] for view in of):
        view.mask[:, WIDTH // 2 + 15 :] = False
    result = track([cloud(pose)] * 4, TrackParams(), views=seen)
    assert np.linalg.norm(result.positions[-1] - result.positions[0], axis=1).max() < 0.005


def following(path: np.ndarray, holds: list[bool]) -> SheetFollower:
    """A sheet at rest beside a hand on a path [F, 3] (m) that `holds` [F] it."""
    mesh = sheet_mesh(cloud((0.0, 0.0, 0.0)), 50)
    hand = Hand(path, np.array(holds), np.full(len(path), True), 0)
    return SheetFollower(mesh, shots((0.0, 0.0, 0.0)), np.arange(len(path)) / 5, hand)


def flow_of(follower: SheetFollower, way: list[float]) -> Sums:
    """One that is sure that every node goes the same way (m)."""
    flow = Sums(len(follower.state.x))
    flow.weight[:], flow.way[:] = 10.0, 10 * np.array(way)
    return flow


def test_flow_that_would_tear_the_sheet_out_of_the_hand_is_left_out():
    follower = following(np.array([[0.08, 0.08, 0.006], [0.02, 0.08, 0.006]]), [True, True])
    follower.skip(0)
    flow = flow_of(follower, [0.0, 0.0, 0.0])
    follower._prior(1, follower.state.x, flow)
    apart = np.linalg.norm(follower.mesh.points[:, :2] - [0.08, 0.08], axis=1)
    assert follower.grip.held.any()
    assert (flow.weight[apart < 0.03] == 0).all()
    assert (flow.weight[apart > 0.13] > 0).all()


@pytest.mark.parametrize(("going", "goes"), [([0.02, 0.0, 0.0], True), ([0.0, 0.0, 0.0], False)])
def test_a_hand_that_may_have_let_go_is_followed_while_the_cloth_goes_along(going, goes):
    follower = following(np.array([[0.0, 0, 0.006], [0.02, 0, 0.006], [0.04, 0, 0.006]]), [True, True, False])
    for frame in range(2):
        follower.skip(frame)
    way = follower.grip.carry(2, follower.state.x, flow_of(follower, going))
    assert (way is not None) == goes
    assert follower.grip.held.any() == goes


def test_what_a_hand_holds_goes_with_it_and_the_rest_hangs_on():
    mesh = sheet_mesh(cloud((0.0, 0.0, 0.0)), 50)
    path = np.array([[0.08, 0.08, 0.006], [0.08, 0.08, 0.03], [0.07, 0.07, 0.05]])
    follower = SheetFollower(
        mesh, shots((0.0, 0.0, 0.0)), np.arange(3) / 5, Hand(path, np.full(3, True), np.full(3, True), 0)
    )
    for frame in range(3):
        follower.skip(frame)
    held = follower.grip.held
    assert 0 < held.sum() < 20
    np.testing.assert_allclose(
        (follower.state.x - mesh.points)[held], np.tile([-0.01, -0.01, 0.044], (held.sum(), 1)), atol=2e-3
    )
    lengths = np.linalg.norm(follower.state.x[mesh.pairs[:, 0]] - follower.state.x[mesh.pairs[:, 1]], axis=1)
    assert np.quantile(lengths / mesh.rest, 0.95) < 1.05
    assert follower.state.x[:, 2].min() >= mesh.half - 1e-6


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e30])
def test_nothing_that_is_not_finite_leaves_a_frame(wrong):
    mesh = sheet_mesh(cloud((0.0, 0.0, 0.0)), 50)
    path = np.tile([0.08, 0.08, 0.006], (5, 1))
    follower = SheetFollower(
        mesh,
        shots((0.0, 0.0, 0.0)),
        np.array([0, 0.2, wrong, 0.6, 0.8]),
        Hand(path, np.full(5, True), np.full(5, True), 0),
    )
    path[2:4] = wrong
    seen = shots((0.0, 0.0, 0.0))
    broken = [Shot(s.lens, s.grey, np.full_like(s.depth, wrong), s.mask, s.alike) for s in seen]
    for frame, given in enumerate((seen, seen, broken, seen, seen)):
        follower.velocity[:] = wrong if frame == 3 else follower.velocity
        state = follower.follow(frame, given)
        assert np.isfinite(state.x).all()
        assert np.abs(state.x - mesh.points).max() < 0.1


def test_a_pixel_shows_the_nearest_layer():
    mesh = sheet_mesh(cloud((0.0, 0.0, 0.0)), 50)
    folded = mesh.points.copy()
    over = folded[:, 0] > 0
    folded[over] = folded[over] * [-1, 1, 1] + [0, 0, 0.02]
    seen = visible(Cloth(mesh), folded, mesh.normals(folded), [Lens(CAMERAS[0])])[0]
    left = seen.points[:, 0] < -0.01
    assert over[seen.corners[left]].mean() > 0.9
    assert seen.front[left].mean() < 0.1


def layers(moved: int) -> np.ndarray:
    """A picture [100, 160] of a patterned layer that lies still, and of another that has covered so many more columns."""
    rng = np.random.default_rng(5)
    still, upper = (cv2.resize(rng.uniform(60, 180, (10, 16)).astype(np.float32), (160, 100)) for _ in range(2))
    still[:, : 60 + moved] = np.roll(upper, moved, axis=1)[:, : 60 + moved]
    return (still + rng.normal(0, 1, still.shape)).clip(0, 255).astype(np.uint8)


class Dragging:
    """Flow that takes all of the picture along."""

    def __init__(self, columns: float):
        self.columns = columns

    def calc(self, one: np.ndarray, two: np.ndarray, start: np.ndarray) -> np.ndarray:
        return start + np.float32([self.columns, 0])


def test_the_layer_under_one_that_moves_is_not_taken_along():
    flow, (row, column) = Flow(), (a.ravel() for a in np.mgrid[20:80, 10:130])
    flow.there, flow.back = Dragging(12), Dragging(-12)
    at = np.column_stack([row, column])
    to, sure = flow.between(layers(0), layers(12), at)
    way = (to - at)[:, 1]
    under, over, covered = column >= 77, column < 55, (column >= 65) & (column < 67)
    assert sure[under].mean() > 0.95
    assert np.abs(way[under & sure]).max() == 0
    assert sure[over].mean() > 0.95
    assert np.abs(way[over & sure] - 12).max() < 1e-3
    assert sure[covered].mean() < 0.2


def test_images_are_alike_where_flow_leads_to_the_same_pattern():
    first, second = layers(0)[:, 60:], np.roll(layers(0)[:, 60:], 7, axis=1)
    there = np.zeros((*first.shape, 2), np.float32)
    there[..., 0] = 7
    moved, still = compared(first, second, there)
    assert np.median(moved[10:-10, 10:-20]) > 0.95
    assert np.median(np.abs(still[10:-10, 10:-20])) < 0.6
    bare = np.full_like(first, 90)
    assert np.abs(compared(bare, bare, there)[0]).max() < 1e-3


@pytest.mark.parametrize("count", [0, 1, 40000])
def test_images_are_sampled_at_any_number_of_places(count):
    image = np.add.outer(np.arange(30.0), 100 * np.arange(40.0)).astype(np.float32)
    at = np.random.default_rng(0).uniform(1, 28, (2, count)).astype(np.float32)
    np.testing.assert_allclose(sampled(image, *at), 100 * at[0] + at[1], atol=2.0)  # by 32nds of a pixel


def test_ways_that_others_around_do_not_ask_for_are_left_out():
    sums, corners = Sums(3), np.tile([0, 1, 2], (50, 1))
    ways = np.tile([0.01, 0.0, 0.0], (50, 1))
    ways[:4] = [0.0, 0.05, 0.0]
    sums.add(corners, np.full((50, 3), 1 / 3), ways)
    np.testing.assert_allclose(sums.agreed().mean(), np.tile([0.01, 0.0, 0.0], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(sums.agreed().weight, 46 / 3)
