"""Suggestions of a run: its newest state, its models, what it has recorded, and wrong requests."""

import numpy as np
import pytest

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.stages.suggest import _gaps, suggest_in
from tests.cli import piegraph, piegraph_json


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A T-block of four simulated sequences and a network that has hardly learned."""
    folder = tmp_path_factory.mktemp("suggest")
    (folder / "tblock.toml").write_text(
        '[simulate]\nenvironment = "tblock"\nsequences = 4\nstrokes = 3\n\n[dataset]\ntrain = 2\n\n'
        "[train.piegraph]\nsteps = 4\nhidden = 8\n\n[evaluate]\nhorizons = [1]\n"
    )
    piegraph("run", folder / "tblock.toml", "--run", folder / "run")
    return folder / "run"


def test_the_command_lists_strokes_from_where_the_last_one_ended(run):
    told = piegraph_json("suggest", "--run", run, "--strokes", 4)
    assert [set(row) for row in told["strokes"]] == [{"mode", "start", "end", "unsure", "new"}] * 4
    assert told["unsure_is"] == "expected error"
    assert told["recorded"] == 6
    assert (run / "suggested.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    made = suggest_in(run, "piegraph", None, 4, 0)
    assert [row["start"] for row in told["strokes"]] == made.found.strokes.start.double().tolist()
    assert made.past.shape == (6, 2, 2)
    near = np.linalg.norm(made.past[:, :, None] - made.state[None, None, :, :2], axis=-1).min(-1)
    assert near.min(1).max() < 0.03, "past strokes are drawn where they met the object"


def test_a_cloud_says_where_the_object_is_now(run, tmp_path):
    state = suggest_in(run, "piegraph", None, 1, 0).state + np.array([0.05, -0.03, 0])
    np.savez(tmp_path / "now.npz", points=np.repeat(state, 4, 0) + np.random.default_rng(0).normal(0, 1e-4, (200, 3)))
    made = suggest_in(run, "piegraph", tmp_path / "now.npz", 2, 0)
    np.testing.assert_allclose(made.state.mean(0), state.mean(0), atol=0.01)
    assert np.abs(made.found.strokes.ends.numpy() - state.mean(0)[:2]).max() < 0.3


def test_what_cannot_be_asked_is_refused(run, tmp_path):
    with pytest.raises(UsageError, match="static learns nothing"):
        suggest_in(run, "static", None, 1, 0)
    with pytest.raises(DataError, match="pgnd is not trained") as fault:
        suggest_in(run, "pgnd", None, 1, 0)
    assert "piegraph train" in str(fault.value.hint)
    np.savez(tmp_path / "few.npz", points=np.zeros((10, 3)))
    with pytest.raises(DataError, match="10 points"):
        suggest_in(run, "piegraph", tmp_path / "few.npz", 1, 0)
    ended = piegraph("suggest", "--run", run, "--picture", "now.jpg", check=2)
    assert "use .png" in ended.stderr


def test_the_side_that_was_never_pushed_is_named_as_the_object_lies_now():
    angle = np.radians([-60, 0, 60])
    known = np.column_stack([np.cos(angle), np.sin(angle), np.zeros((3, 3))])
    (word,) = _gaps(known, 0.0)
    assert "all 3 recorded strokes" in word
    assert "240 degrees" in word
    assert "faces 180 degrees" in word
    (turned,) = _gaps(known, np.pi / 2)
    assert "faces 270 degrees" in turned
    around = np.radians([0, 90, 180, 270])
    assert _gaps(np.column_stack([np.cos(around), np.sin(around), np.zeros((4, 3))]), 0.0) == []
    assert "learned from 2 strokes" in _gaps(known[:2], 0.0)[0]
