"""Which frames of several cameras belong together."""

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.recording.timing import check_times, frame_times, nearest, pair_frames


def test_no_frame_is_used_twice_where_the_step_is_shorter_than_the_skew():
    a, b = np.delete(np.arange(60) / 30, 10), np.delete(np.arange(60) / 30 + 0.004, 40)
    groups, warnings = pair_frames({"a": a, "b": b}, 0.05, "here")
    assert len(groups) == 58
    np.testing.assert_allclose(b[groups[:, 1]] - a[groups[:, 0]], 0.004, atol=1e-9)
    assert "left out: a 1 of 59, b 1 of 59; first: frame 39 of a" in warnings[0]


def test_a_pair_farther_apart_than_the_skew_is_none():
    a = np.arange(10) / 5
    b = a.copy()
    b[3] += 0.08
    groups, _ = pair_frames({"a": a, "b": b}, 0.05, "here")
    assert groups[:, 0].tolist() == [0, 1, 2, *range(4, 10)]


def test_cameras_without_one_clock_are_refused():
    a = np.arange(10) / 5
    with pytest.raises(DataError, match="a and b are 100 ms apart in frame 0; 0 of 10 frames"):
        pair_frames({"a": a, "b": a + 0.1}, 0.05, "here")
    with pytest.raises(DataError, match=r"share no time: a 0\.00 to 1\.80 s and b 60\.00 to"):
        pair_frames({"a": a, "b": a + 60}, 0.05, "here")


@pytest.mark.parametrize("count", [1, 2, 5])
def test_nearest(count):
    others, stamps = np.arange(count) * 2.0, np.linspace(-3, 12, 31)
    np.testing.assert_array_equal(nearest(stamps, others), np.abs(stamps[:, None] - others).argmin(1))


def test_gaps_are_said_and_small_ones_are_not():
    assert check_times(np.array([0, 0.2, 0.4, 1.3, 1.5]), "t") == []
    (said,) = check_times(np.array([0, 0.2, 0.4, 4.4, 4.6]), "t")
    assert said == "t: 4.0 s without a frame before line 4"
    assert check_times(np.array([3.0]), "t") == []


def test_frames_that_one_of_four_cameras_lost_are_kept_and_those_of_one_camera_are_not():
    whole = np.arange(12) / 5
    lost = {"a": [], "b": [3, 7], "c": [4, 7], "d": [7, 9]}
    times = {name: np.delete(whole + 0.002 * k, gone) for k, (name, gone) in enumerate(lost.items())}
    groups, warnings = pair_frames(times, 0.05, "here")
    assert groups[:, 0].tolist() == [0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11]
    assert (groups < 0).sum(0).tolist() == [0, 1, 1, 1]
    assert ~groups[3, 1] in (2, 3), "the nearest that it has"
    assert "left out: a 1 of 12" in warnings[0]
    assert warnings[1] == "frames that a camera lost, of 11: b 1, c 1, d 1; it shows nothing there"
    stamps = frame_times(list(times.values()), groups)
    assert np.abs(stamps - stamps.mean(1, keepdims=True)).max() < 0.005


def test_a_camera_that_lost_more_than_half_is_refused():
    whole = np.arange(12) / 5
    with pytest.raises(DataError, match="of 12 frames have a partner in every camera"):
        pair_frames({"a": whole, "b": whole, "c": whole[:5]}, 0.05, "here")


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (np.arange(40), "time stamps are whole numbers, 1 apart: are these frame numbers?"),
        (3 + 2 * np.arange(40), "time stamps are whole numbers, 2 apart"),
        (np.arange(2000) / 5 / 60, "300 frames a second: are these minutes?"),
        (np.arange(40) * 1.0 + 0.25, None),
        (np.round(np.arange(40) * 1.04), None),
        (np.arange(400) / 90, None),
        (np.array([0, 1]), None),
    ],
)
def test_numbers_of_frames_and_minutes_are_asked_about(times, said):
    warnings = check_times(np.asarray(times, float), "t")
    assert [said in warning for warning in warnings] == ([True] if said else [])


@pytest.mark.parametrize(("step", "said"), [(6, "are these frame numbers?"), (33, "are these milliseconds?")])
def test_what_is_too_slow_for_seconds_is_refused_with_what_it_may_be(step, said):
    with pytest.raises(DataError, match=said):
        check_times(step * np.arange(40.0), "t")
