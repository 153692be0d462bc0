"""A stick's tip and gloved fingertips by depth alone, in scenes whose truth is known."""

from functools import partial

import numpy as np
import pytest

from piegraph_cli.perception.incoming import find_tips, hand_tip, object_top, stick_tip
from tests.perception.scene import WORKSPACE, pushing_sequence, render, ring_camera

FRAMES = 10
EMPTY = 3
"""Frames before anything comes in."""
RADIUS = 0.01


def stick_sequence(cameras, lean):
    """Depth images [camera][frame] of a stick that comes down, then pushes the T along -x, and its lower end [F, 3]."""
    along, tips, depths = np.array(lean) / np.linalg.norm(lean), [], [[] for _ in cameras]
    for f in range(FRAMES):
        moved = max(0.0, (f - 5) / FRAMES)
        centre = (0.03 - 0.15 * moved, 0.02)
        up = 0.02 * max(0, 5 - f)
        end = np.array([centre[0] + 0.125, 0.06, 0.005 + up])
        stick = (end + RADIUS * along, end + 0.5 * along, RADIUS) if f >= EMPTY else None
        tips.append(end if stick else np.full(3, np.nan))
        for c, camera in enumerate(cameras):
            depths[c].append(render(camera, centre, 0.5 * moved, None, seed=100 * f + c, stick=stick).depth)
    return depths, np.array(tips)


@pytest.mark.parametrize(("azimuths", "lean"), [((0.4, 3.5), (0.0, 0.0, 1.0)), ((1.5,), (0.3, -0.3, 0.9))])
def test_the_tip_of_a_stick_is_found_whether_it_leans_or_not(azimuths, lean):
    cameras = [ring_camera(azimuth) for azimuth in azimuths]
    depths, tips = stick_sequence(cameras, lean)
    found, seen = find_tips(
        depths, cameras, WORKSPACE, np.arange(FRAMES) / 5, partial(stick_tip, radius=RADIUS), max_gap=0.5
    )
    assert seen.tolist() == [False] * EMPTY + [True] * (FRAMES - EMPTY)
    away = np.linalg.norm((found - tips)[seen][:, :2], axis=1)
    assert np.median(away) < 0.006
    assert away.max() < 0.009
    assert np.abs((found - tips)[seen][:, 2]).max() < 0.03  # the object hides its end


def test_the_object_alone_is_no_stick_and_no_hand_however_it_moves():
    cameras = [ring_camera(azimuth) for azimuth in (0.4, 3.5)]
    depths = [[render(c, (0.02 * f, 0.0), 0.2 * f, None, seed=f).depth for f in range(6)] for c in cameras]
    assert object_top(depths, cameras, WORKSPACE) == pytest.approx(0.033, abs=0.004)
    for tip_of in (partial(stick_tip, radius=RADIUS), hand_tip):
        found, seen = find_tips(depths, cameras, WORKSPACE, np.arange(6) / 5, tip_of, max_gap=0.5)
        assert not seen.any()
        assert np.isnan(found).all()


def test_the_fingertips_of_a_hand_without_its_colours():
    cameras = [ring_camera(azimuth, width=160, height=120) for azimuth in (0.4, 2.5)]
    views, hands = pushing_sequence(5, cameras)
    for c, camera in enumerate(cameras):
        views[0][c] = render(camera, (0.03, 0.02), 0.0, None, seed=c)
    depths = [[row[c].depth for row in views] for c in range(len(cameras))]
    found, seen = find_tips(depths, cameras, WORKSPACE, np.arange(5) / 5, hand_tip, max_gap=0.5)
    assert seen.tolist() == [False] + [True] * 4
    away = np.linalg.norm(found[1:, :2] - hands[1:, [8, 12]].mean(axis=1)[:, :2], axis=1)
    assert np.median(away) < 0.03


def test_a_tip_that_leaps_is_dropped_and_its_place_filled():
    path = np.column_stack([np.linspace(0, 0.1, 6), np.zeros(6), np.full(6, 0.02)])
    path[0] = np.nan
    leaps = path.copy()
    leaps[3] = [0.0, 9.0, 0.0]
    camera, times = ring_camera(0.4), np.arange(6) / 5
    depths = [[np.zeros((camera.height, camera.width), np.uint16)] * 6]
    given = iter(leaps)
    found, seen = find_tips(depths, [camera], WORKSPACE, times, lambda *_: next(given), max_gap=0.5)
    np.testing.assert_allclose(found, path)
    assert seen.tolist() == [False, True, True, False, True, True]
    always = iter(np.nan_to_num(leaps))
    assert not find_tips(depths, [camera], WORKSPACE, times, lambda *_: next(always), max_gap=0.5)[1].any()
