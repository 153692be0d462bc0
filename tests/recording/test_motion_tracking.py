"""Particles that others tracked: held, stopped, lost, and a world whose x points up."""

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.recording.motion_doubts import find_parted
from tests.recording.test_motion import grid, motion, read, write


def told(folder, data):
    return " ".join(read(write(folder, ".npz", data)).warnings)


@pytest.mark.parametrize("every", [2, 3])
def test_particles_of_a_lower_rate_are_said(tmp_path, every):
    data = grid()
    assert told(tmp_path, data) == ""
    data["particles"] = data["particles"][np.arange(30) // every * every]
    assert "all particles repeat those of the frame before in" in told(tmp_path, data)


def test_a_thing_that_rests_between_strokes_repeats_rightly(tmp_path):
    data = grid()
    data["contact"] = (np.arange(30) > 7).astype(int)
    repeated = (data["particles"][1:] == data["particles"][:-1]).all((1, 2))
    assert repeated[:7].all()
    assert repeated[-4:].all()
    assert told(tmp_path, data) == ""


def test_tracking_that_stopped_in_contact_is_said(tmp_path):
    data = grid() | {"contact": (np.arange(30) > 7).astype(int)}
    data["particles"][10:] = data["particles"][10]
    data["end_effector"][:, 1] += np.clip(np.arange(30) - 22, 0, 7) * 0.001
    assert "the particles stay to the last digit from frame 10 to 29" in told(tmp_path, data)


def test_two_contacts_beside_a_thing_at_rest_are_not_added(tmp_path):
    data = grid() | {"contact": np.isin(np.arange(30), [1, 2, 5, 6, *range(8, 30)]).astype(int)}
    data["end_effector"][:4, 0] += 0.1  # from one side to the other, in the air
    assert "to the last digit" not in told(tmp_path, data)


def test_markers_that_stay_behind_are_named(tmp_path):
    data = grid()
    data["particles"][:, 20] = data["particles"][0, 20]
    assert "in frame 29 particles are away from all those beside them: 20: were they lost?" in told(tmp_path, data)


def test_what_bends_folds_and_parts_has_lost_no_marker():
    data = grid()["particles"]
    folded = np.repeat(data[:1, :], 2, 0)
    folded[0, 24:] = folded[0, :24] + [0, 0, 0.004]  # two layers that lie on one another, then side by side
    folded[1, 24:] = folded[1, :24] + [0.3, 0, 0]
    assert find_parted(folded) is None
    turned = data.copy()
    turned[-1] = turned[-1] @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    assert find_parted(turned) is None


def test_a_world_whose_x_points_up_is_asked_about(tmp_path):
    data = grid()
    up = data | {name: data[name][..., [2, 0, 1]] for name in ("particles", "end_effector")}
    up["particles"], up["end_effector"] = up["particles"] + [0, 0, 0.1], up["end_effector"] + [0, 0, 0.1]
    assert "is x up? z has to point up" in told(tmp_path, up)
    assert "is x up?" not in told(tmp_path, data)


def test_times_of_single_precision_are_told(tmp_path):
    data = motion(times=(1.7e9 + np.arange(12) / 5).astype(np.float32))
    with pytest.raises(DataError, match="from 1700000000 to 1700000000 s: were times rounded, or written with single"):
        read(write(tmp_path, ".npz", data))
