"""Checks of geometry: silent where all is well, and the right cause for each way in which recordings are wrong."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.environments.rig import camera_rig, look_at
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.checks import grouped
from piegraph_cli.recording.geometry import check_geometry
from tests.recording.table_scene import (
    ARM,
    BLOCK,
    WORKSPACE,
    Box,
    boxes_on_a_table,
    make_views,
    sample,
    with_depth,
    with_poses,
)

SUBSETS = [(0, 1, 2, 3), (0, 2), (1, 2, 3), (3,)]
FLIP = np.diag([1.0, -1, -1, 1])


def told(views, table=0.0):
    return [(f.checks[0].verdict, f.text) for f in grouped(check_geometry(views, WORKSPACE, table))]


@pytest.mark.parametrize("chosen", SUBSETS, ids=str)
@pytest.mark.parametrize("sequence", range(4))
def test_the_sample_is_good(sequence, chosen):
    assert told([sample(sequence)[k] for k in chosen]) == []


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.006, 0.01])
@pytest.mark.parametrize(
    "boxes",
    [
        (BLOCK, BLOCK),
        ((*BLOCK, ARM), (*BLOCK, ARM)),
        ((), ()),
        ((Box((0, 0), (0.4, 0.016, 0.016)),),) * 2,
        ((Box((0.05, 0), (0.3, 0.3, 0.003), (200, 40, 40)),),) * 2,
        ((Box((0.1, -0.05), (0.15, 0.15, 0.2)), *BLOCK),) * 2,
    ],
    ids=["block", "arm", "nothing", "rope", "cloth", "large box"],
)
def test_good_recordings_are_good_whatever_the_noise(noise, boxes):
    views = make_views(camera_rig(320, 240), noise, boxes, seed=1)
    for chosen in SUBSETS:
        assert told([views[k] for k in chosen]) == []


@pytest.mark.parametrize("seed", range(3))
def test_specks_of_noise_beside_a_flat_cloth_are_no_outlines(seed):
    """Noise in lumps, as stereo cameras have it, stands as high here and there as a rope; its edges lie anywhere."""
    rng, views = np.random.default_rng(seed), []
    for view in make_views(camera_rig(), noise=0.0, boxes=[[Box((0.0, 0.0), (0.3, 0.3, 0.006))]]):
        lumps = cv2.GaussianBlur(rng.standard_normal(view.depth[0].shape), (0, 0), 2.5)
        metres = view.depth[0] * view.camera.depth_scale
        noisy = metres + 0.0032 * lumps / lumps.std() * metres**2
        units = np.where(view.depth[0] > 0, noisy / view.camera.depth_scale, 0).round().astype(np.uint16)
        views.append(replace(view, depth=[units]))
    assert told(views) == []


def test_cameras_of_several_sizes_places_and_units_are_good():
    rig = camera_rig(320, 240)
    wide = camera_rig(640, 480)[1]
    above = replace(rig[2], T_world_camera=look_at(1.0, 1.4, 0.9))
    fine = replace(camera_rig(200, 150)[3], depth_scale=0.00025)
    assert told(make_views([rig[0], wide, above, fine])) == []


def rotated(axis, degrees):
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.radians(degrees) * np.eye(3)[axis])[0]
    return T


def turned(T, degrees):
    """About the world's vertical, at the camera's place."""
    changed = rotated(2, degrees) @ T
    changed[:3, 3] = T[:3, 3]
    return changed


def moved(*by):
    T = np.eye(4)
    T[:3, 3] = by
    return T


def stretched(T, factor):
    changed = T.copy()
    changed[:3, 3] *= factor
    return changed


def poses(change, only=None):
    return lambda views: with_poses(views, lambda k, T: change(T) if only in (None, k) else T)


def depths(change, only=None):
    return lambda views: with_depth(views, lambda k, d: change(d) if only in (None, k) else d)


def swapped(*order):
    return lambda views: with_poses(views, lambda k, T: views[order[k]].camera.T_world_camera)


def scales(scale):
    return lambda views: [replace(v, camera=replace(v.camera, depth_scale=scale)) for v in views]


def slightly_off(seed):
    """Poses as calibration leaves them: half a degree about what a camera looks at, and 1.5 mm."""
    rng = np.random.default_rng(seed)

    def change(k, T):
        middle = T[:3, 3] + 0.75 * T[:3, 2]
        turn = np.eye(4)
        axis = rng.standard_normal(3)
        turn[:3, :3] = cv2.Rodrigues(np.radians(0.5) * axis / np.linalg.norm(axis))[0]
        return moved(*middle + 0.0015 * rng.standard_normal(3)) @ turn @ moved(*-middle) @ T

    return lambda views: with_poses(views, change)


@pytest.mark.parametrize("seed", range(6))
def test_usual_errors_of_calibration_are_good_and_hide_no_trouble(seed):
    views = slightly_off(seed)(boxes_on_a_table())
    assert told(views) == []
    for trouble in ("all inverted", "cam0 and cam2 swapped", "cam1 and cam2 swapped", "quarter millimetres", "OpenGL"):
        spoil, cause = TROUBLES[trouble]
        assert any(verdict == "bad" and re.search(cause, text) for verdict, text in told(spoil(views))), trouble


INVERSE = "inverting T_world_camera puts the table at z = 0"
OPENGL = "OpenGL's axes. puts the table at z = 0"
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def colors(change, only=None):
    return lambda views: [
        replace(view, color=[np.ascontiguousarray(change(c)) for c in view.color]) if only in (None, k) else view
        for k, view in enumerate(views)
    ]


TROUBLES = {
    "all inverted": (poses(np.linalg.inv), INVERSE),
    "one inverted": (poses(np.linalg.inv, 2), f"^cam2: .*{INVERSE}"),
    "cam0 and cam2 swapped": (swapped(2, 1, 0, 3), "cam0 and cam2 swapped"),
    "cam1 and cam2 swapped": (swapped(0, 2, 1, 3), "cam1 and cam2 swapped"),
    "three exchanged": (
        swapped(1, 2, 0, 3),
        "poses exchanged: cam0 .* cam2's fits, cam1 .* cam0's fits, cam2 .* cam1's",
    ),
    "depth +5 %": (depths(lambda d: d * 1.05), r"depth or board size off by \+(4.9|5.0)"),
    "depth +2 %": (depths(lambda d: d * 1.02), r"depth or board size off by \+(1.9|2.0)"),
    "board +5 %": (poses(lambda T: stretched(T, 1.05)), r"depth or board size off by -4.[78]"),
    "board -8 %": (poses(lambda T: stretched(T, 0.92)), r"depth or board size off by \+8.[678]"),
    "depth of one +5 %": (depths(lambda d: d * 1.05, 1), r"depth or board size off by \+(4.9|5.0) % in cam1"),
    "table 10 mm high": (poses(lambda T: moved(0, 0, 0.01) @ T), "the table lies 10 mm above z = 0"),
    "table 30 mm low": (poses(lambda T: moved(0, 0, -0.03) @ T), "the table lies 30 mm below z = 0"),
    "OpenGL": (poses(lambda T: T @ FLIP), OPENGL),
    "OpenGL inverted": (poses(lambda T: np.linalg.inv(T @ FLIP)), f"inverting T_world_camera and .*{OPENGL}"),
    "millimetres": (poses(lambda T: stretched(T, 1000)), "taking the poses as millimetres puts the table at z = 0"),
    "millimetres inverted": (
        poses(lambda T: stretched(np.linalg.inv(T), 1000)),
        "poses as millimetres and inverting T_world_camera puts",
    ),
    "z down": (poses(lambda T: FLIP @ T), "its z points down, puts the table at z = 0"),
    "z down inverted": (poses(lambda T: np.linalg.inv(FLIP @ T)), "inverting .* its z points down, puts"),
    "y up": (poses(lambda T: Y_UP @ T), "its y points up, puts the table at z = 0"),
    "quarter millimetres": (depths(lambda d: d * 4.0), "depth is 4 times too far: depth_scale 0.00025 puts the table"),
    "tenths of millimetres": (
        depths(lambda d: d * 10.0),
        "depth is 10 times too far: depth_scale 0.0001 puts the table",
    ),
    "4 mm": (depths(lambda d: d / 4.0), "depth is 4 times too near: depth_scale 0.004 puts the table"),
    "depth scale 1": (scales(1.0), "depth is 1000 times too far: depth_scale 0.001 puts the table"),
    "depth scale 1e-6": (scales(1e-6), "depth is 1000 times too near: depth_scale 0.001 puts the table"),
    "whole metres": (depths(lambda d: np.rint(d / 1000)), "no reading above [1-3] units; metres or the like"),
    "one pitched by 1.5 deg": (poses(lambda T: T @ rotated(0, 1.5), 1), "the pose of cam1 is off"),
    "one pitched by 3 deg": (poses(lambda T: T @ rotated(0, 3), 1), "the pose of cam1 is off"),
    "one yawed by 3 deg": (poses(lambda T: T @ rotated(1, 3), 1), "cam1 alone disagrees|the pose of cam1 is off"),
    "one rolled by 6 deg": (poses(lambda T: T @ rotated(2, 6), 1), "the pose of cam1 is off"),
    "all pitched by 3 deg": (poses(lambda T: T @ rotated(0, 3)), "the pose of cam0, cam1, cam2 and cam3 is off"),
    "one 80 mm aside": (poses(lambda T: moved(0.06, 0.05, 0) @ T, 1), "cam1 alone disagrees"),
    "one turned by 3 deg": (poses(lambda T: turned(T, 3), 1), "the pose of cam1 is off along the table"),
    "one turned by 1.5 deg": (poses(lambda T: turned(T, 1.5), 1), "the pose of cam1 is off along the table"),
    "one 20 mm aside": (poses(lambda T: moved(0.012, -0.016, 0) @ T, 1), "the pose of cam1 is off along the table"),
    "depth 15 px right": (depths(lambda d: np.roll(d, 15, 1)), r"moving depth by -1[456], -?[012] px"),
    "depth 8 px left": (depths(lambda d: np.roll(d, -8, 1)), r"moving depth by [789], -?[012] px"),
    "depth 9 px down": (depths(lambda d: np.roll(d, 9, 0)), r"moving depth by -?[012], -([789]|10) px"),
    "colour mirrored": (colors(lambda c: c[:, ::-1]), "one of them is mirrored, left for right, against the other"),
    "colour of one mirrored": (colors(lambda c: c[:, ::-1], 2), "^cam2: .*mirrored, left for right, against the other"),
    "colour upside down": (colors(lambda c: c[::-1]), "one of them is upside down against the other"),
    "colour turned": (colors(lambda c: c[::-1, ::-1]), "one of them is turned by 180 degrees against the other"),
    "depth of one 20 px": (depths(lambda d: np.roll(d, 20, 1), 3), r"^cam3: .*moving depth by -(19|20|21), -?[012] px"),
}


@pytest.mark.parametrize("source", [boxes_on_a_table, sample])
@pytest.mark.parametrize("trouble", TROUBLES)
def test_each_trouble_is_bad_and_its_cause_is_named(trouble, source):
    spoil, cause = TROUBLES[trouble]
    found = told(spoil(source()))
    assert any(verdict == "bad" and re.search(cause, text) for verdict, text in found), found


ALONE = ["all inverted", "OpenGL", "millimetres", "z down", "quarter millimetres", "depth +5 %", "depth 15 px right"]


@pytest.mark.parametrize("trouble", ALONE)
def test_one_camera_is_enough(trouble):
    spoil, cause = TROUBLES[trouble]
    found = told(spoil(boxes_on_a_table()[:1]))
    assert any(verdict == "bad" and re.search(cause, text) for verdict, text in found), found


Y_BACK = np.diag([1.0, -1, 1, 1])
LINK = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
UNCOMMON = {
    "centimetres": (lambda T: stretched(T, 100), "taking the poses as centimetres puts the table"),
    "inches": (lambda T: stretched(T, 1 / 0.0254), "taking the poses as inches puts the table"),
    "rotation transposed": (lambda T: rigid(T[:3, :3].T, T[:3, 3]), "transposing the rotation of T_world_camera puts"),
    "camera_link": (lambda T: T @ np.linalg.inv(LINK), "ROS's camera_link., puts the table"),
    "turned over": (lambda T: T @ np.diag([-1.0, -1, 1, 1]), "turning the camera by 180 degrees .* puts the table"),
    "left-handed": (lambda T: Y_BACK @ T @ Y_BACK, "turning the camera by 180 degrees .*are poses left-handed"),
    "tvec": (lambda T: rigid(T[:3, :3], -T[:3, :3].T @ T[:3, 3]), r"the world in the camera \(OpenCV's tvec\) puts"),
    "w first": (lambda T: requaternion(T, 1), "with w first, where w was taken to be last, puts"),
    "w last": (lambda T: requaternion(T, -1), "with w last, where w was taken to be first, puts"),
    "degrees": (
        lambda T: rigid(Rotation.from_rotvec(np.radians(vector(T))).as_matrix(), T[:3, 3]),
        "taking the rotation vector as radians, .* puts",
    ),
    "x down": (lambda T: rotated(1, -90) @ T, "its x points down, puts the table"),
    "x up": (lambda T: rotated(1, 90) @ T, "its x points up, puts the table"),
    "y down": (lambda T: rotated(0, 90) @ T, "its y points down, puts the table"),
    "Unity": (lambda T: np.eye(4)[[0, 2, 1, 3]] @ T @ Y_BACK, "left-handed with y up .* puts"),
}


def vector(T):
    return Rotation.from_matrix(T[:3, :3]).as_rotvec()


def requaternion(T, by):
    return rigid(Rotation.from_quat(np.roll(Rotation.from_matrix(T[:3, :3]).as_quat(), by)).as_matrix(), T[:3, 3])


def rigid(rotation, translation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, translation
    return T


@pytest.mark.parametrize("chosen", [(0, 1, 2, 3), (0, 2)], ids=str)
@pytest.mark.parametrize("slip", UNCOMMON)
def test_uncommon_slips_are_bad_and_named_too(slip, chosen):
    change, cause = UNCOMMON[slip]
    found = told(with_poses([boxes_on_a_table()[k] for k in chosen], lambda k, T: change(T)))
    assert any(verdict == "bad" and re.search(cause, text) for verdict, text in found), found


def with_K(views, factor):
    return [replace(v, camera=replace(v.camera, K=v.camera.K * factor)) for v in views]


@pytest.mark.parametrize("factor", [1.1, 0.9])
def test_focal_lengths_of_another_lens_are_named(factor):
    found = told(with_K(boxes_on_a_table(), np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])))
    assert any(verdict == "bad" and f"focal lengths {1 / factor:.2f}"[:-1] in text for verdict, text in found), found


@pytest.mark.parametrize("factor", [2.0, 1.25])
def test_intrinsics_of_images_before_they_were_resized_are_named(factor):
    found = told(with_K(boxes_on_a_table(), np.array([[factor], [factor], [1]])))
    near = [
        float(of[1])
        for verdict, text in found
        if verdict == "bad" and (of := re.search("K of images about ([0-9.]+)", text))
    ]
    assert near == [pytest.approx(1 / factor, abs=0.03)], found


def cropped(left, top):
    """Images of which so many pixels were cut off, beside the K of before."""

    def spoilt(view):
        size = {"width": view.camera.width - left, "height": view.camera.height - top}
        images = {name: [image[top:, left:] for image in getattr(view, name)] for name in ("depth", "color")}
        return replace(view, camera=replace(view.camera, **size), **images)

    return lambda views: [spoilt(view) for view in views]


def padded(rows):
    """Images below rows without colour and depth, beside the K of before."""

    def spoilt(view):
        images = {
            name: [np.concatenate([0 * image[:rows], image]) for image in getattr(view, name)]
            for name in ("depth", "color")
        }
        return replace(view, camera=replace(view.camera, height=view.camera.height + rows), **images)

    return lambda views: [spoilt(view) for view in views]


def turned_images(turns):
    def spoilt(view):
        size = {"width": view.camera.height, "height": view.camera.width}
        images = {
            name: [np.ascontiguousarray(np.rot90(image, turns)) for image in getattr(view, name)]
            for name in ("depth", "color")
        }
        return replace(view, camera=replace(view.camera, **size), **images)

    return lambda views: [spoilt(view) for view in views]


def along_rays(views):
    """Depth as the distance along each pixel's ray."""

    def spoilt(view):
        rows, columns = np.indices(view.depth[0].shape)
        rays = view.camera.rays(np.column_stack([columns.ravel(), rows.ravel()]))
        longer = np.linalg.norm(rays, axis=1).reshape(rows.shape)
        return replace(view, depth=[np.rint(image * longer).astype(np.uint16) for image in view.depth])

    return [spoilt(view) for view in views]


def exchanged_middle(views):
    def K_of(camera):
        K = camera.K.copy()
        K[:2, 2] = K[1::-1, 2]
        return K

    return [replace(view, camera=replace(view.camera, K=K_of(view.camera))) for view in views]


IMAGES = {
    "cropped at the top": (
        cropped(0, 30),
        r"with about (29|30|31) rows cut off at the top since, .*: were the images cropped",
    ),
    "cropped at both": (cropped(40, 24), r"with about (23|24|25) rows cut off at the top"),
    "cropped at the left": (cropped(60, 0), r"K of cam0 has its middle at .*were they cropped or turned"),
    "padded at the top": (padded(30), r"with about (29|30|31) rows added at the top since, .*: were the images padded"),
    "turned clockwise": (turned_images(-1), "turning the images back, by a quarter counterclockwise, puts the table"),
    "turned counterclockwise": (turned_images(1), "turning the images back, by a quarter clockwise, puts the table"),
    "cx and cy exchanged": (exchanged_middle, "exchanging cx and cy of K puts the table"),
    "along the rays": (along_rays, "the distance along each pixel's ray puts the table"),
}


@pytest.mark.parametrize("source", [boxes_on_a_table, sample])
@pytest.mark.parametrize("trouble", IMAGES)
def test_what_was_done_to_images_after_calibration_is_named(trouble, source):
    spoil, cause = IMAGES[trouble]
    found = told(spoil(source()))
    assert any(verdict == "bad" and re.search(cause, text) for verdict, text in found), found


@pytest.mark.parametrize("trouble", ["turned clockwise", "cx and cy exchanged", "along the rays"])
def test_one_camera_is_enough_for_what_has_no_degree(trouble):
    spoil, cause = IMAGES[trouble]
    found = told(spoil(boxes_on_a_table()[1:2]))
    assert any(verdict == "bad" and re.search(cause, text) for verdict, text in found), found


@pytest.mark.parametrize("chosen", [(0, 2), (0, 1, 2, 3)])
def test_cameras_that_share_a_pose_are_named(chosen):
    views = [sample()[k] for k in chosen]
    found = told(with_poses(views, lambda k, T: views[0].camera.T_world_camera if k == 1 else T))
    named = f"cam0 and cam{chosen[1]} have the same T_world_camera"
    assert any(verdict == "bad" and named in text for verdict, text in found), found
    found = told(with_poses(views, lambda k, T: np.eye(4)))
    assert any(verdict == "bad" and "have the same T_world_camera" in text for verdict, text in found), found


def test_depth_of_any_unit_is_told_by_several_cameras():
    found = told(scales(1 / 256)(boxes_on_a_table()))
    assert [verdict for verdict, _ in found] == ["bad"]
    assert re.search(r"depth is 3.9\d? times too far: depth_scale 0.00(1|0999) puts the table at z = 0", found[0][1])


def test_cameras_that_all_look_elsewhere_are_no_recording_of_a_table():
    found = told(with_poses(boxes_on_a_table(), lambda k, T: moved(40, 0, 0) @ T @ rotated(2, 40)))
    assert found[0][0] == "bad"


def test_one_camera_cannot_tell_a_high_table_from_a_wrong_scale_and_says_so():
    [(verdict, text)] = told(TROUBLES["table 10 mm high"][0](boxes_on_a_table()[:1]))
    assert verdict == "bad"
    assert "the table lies 10 mm above z = 0" in text
    assert "depth or board size off by -1." in text


def test_a_table_at_another_height_is_good_where_that_is_said():
    high = with_poses(boxes_on_a_table(), lambda k, T: moved(0, 0, 0.1) @ T)
    assert told(high)[0][0] == "bad"
    assert told(high, table=0.1) == []


def test_a_table_without_texture_tells_nothing_of_shifts_along_it():
    plain = [replace(v, color=[np.full_like(c, 120) for c in v.color]) for v in boxes_on_a_table()]
    assert not [c for c in check_geometry(plain, WORKSPACE) if c.name == "texture"]
    assert len([c for c in check_geometry(boxes_on_a_table(), WORKSPACE) if c.name == "texture"]) == 6


def test_small_slips_are_doubtful():
    found = told(with_poses(boxes_on_a_table(), lambda k, T: moved(0, 0, 0.0055) @ T))
    assert {verdict for verdict, _ in found} == {"doubtful"}


def test_no_table_in_view_is_doubtful():
    rng = np.random.default_rng(0)
    noise = with_depth(boxes_on_a_table(), lambda k, d: rng.integers(500, 900, d.shape))
    found = told(noise)
    assert ("doubtful", "cam0, cam1, cam2 and cam3: no table is found in depth") in found
    assert all(verdict == "doubtful" for verdict, _ in found)


def test_a_wall_seen_by_a_camera_that_looks_past_the_table_is_doubtful():
    T = np.array([[0.0, 0, 1, 0.5], [-1, 0, 0, 0], [0, -1, 0, 0.3], [0, 0, 0, 1]])  # along +x, level
    camera = Camera("side", 64, 48, np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.zeros(5), T)
    view = replace(
        boxes_on_a_table()[0],
        camera=camera,
        depth=[np.full((48, 64), 1500, np.uint16)] * 2,
        color=[np.full((48, 64, 3), 120, np.uint8)] * 2,
    )
    assert {verdict for verdict, _ in told([view])} == {"doubtful"}


def test_a_mirrored_or_bent_rotation_is_bad():
    for change in (np.diag([1.0, 1, -1, 1]), np.diag([1.0, 1, 1.01, 1])):
        found = told(with_poses(boxes_on_a_table()[:2], lambda k, T, change=change: T @ change))
        assert found[0][0] == "bad"
        assert "the rotation of T_world_camera is" in found[0][1]


def test_blur_and_exposure_are_doubtful_only():
    dark = [replace(v, color=[np.zeros_like(c) for c in v.color]) for v in boxes_on_a_table()]
    assert [(verdict, "black or white" in text) for verdict, text in told(dark)] == [("doubtful", True)]
    dull = [replace(v, color=[cv2.GaussianBlur(c, (0, 0), 5) for c in v.color]) for v in boxes_on_a_table()]
    assert {verdict for verdict, _ in told(dull)} == {"doubtful"}
    assert "after a blur" in told(dull)[0][1]
