"""The benchmark of the viewer: a sequence that is repeated, opened and drawn."""

import numpy as np
import pytest

from piegraph_cli.bench.viewer import make_long_run, viewer_rows
from piegraph_cli.errors import UsageError
from piegraph_cli.workspace.artifact import read_artifact
from tests.viewer import made

SHOWN = ("frames", "hands", "masks", "clouds", "tracks")


def test_a_long_run_is_the_short_one_over_and_over(tmp_path):
    run, out = made.make_run(tmp_path / "run", *SHOWN), tmp_path / "long"
    out.mkdir()
    assert make_long_run(run, out, 15) == 18
    tracks, clouds = (read_artifact(out / name / "first.h5", name) for name in ("tracks", "clouds"))
    np.testing.assert_array_equal(tracks["positions"], np.tile(made.positions(), (3, 1, 1)))
    assert (np.diff(tracks["time"]) > 0).all()
    assert len(clouds["points"]) == clouds["offsets"][-1] == 18 * 16


def test_rows_of_opening_and_of_frames(tmp_path):
    rows = list(viewer_rows(made.make_run(tmp_path / "run", *SHOWN), 12))
    assert [row.case for row in rows] == ["open, 12 frames", "frame, one after another", "frame, anywhere"]
    assert all(row.seconds > 0 for row in rows)


def test_a_run_without_tracks_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no tracks to show"):
        next(viewer_rows(made.make_run(tmp_path / "run", *SHOWN[:-1])))
