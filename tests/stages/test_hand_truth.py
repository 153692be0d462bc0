"""Clicks as truth, on the sample: what `score` says by them beside what the true surface says, and what it refuses."""

import shutil

import numpy as np
import pytest

from piegraph_cli.errors import UsageError
from piegraph_cli.evaluation.scores import SPOTS
from piegraph_cli.recording.clicks import Click, write_clicks
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.stages.images import cameras_of, depth_of
from piegraph_cli.stages.score import score_clicks
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.execute import Options, run_stage
from tests.cli import SAMPLE

NAME = "sequence_0000"
FRAMES = (0, 14, 28, 42)
SURFACE = 0.01
"""Metres within which the depth image shows a material point: it is not hidden."""


@pytest.fixture
def run(sample_run, tmp_path):
    """The sample's run up to tracks, with room for clicks and scores of its own."""
    folder = tmp_path / "run"
    folder.mkdir()
    for name in ("frames", "hands", "masks", "clouds", "tracks"):
        (folder / name).symlink_to(sample_run / name)
    shutil.copy(sample_run / "recipe.toml", folder)
    return folder


def clicks_of(run, spots: int, cameras: int, noise: float = 0.5) -> list[Click]:
    """Material points on top of the block where cameras see them, half a pixel off."""
    frames = read_artifact(run / "frames" / f"{NAME}.h5", "frames")
    particles = read_artifact(SAMPLE / NAME / "truth.h5", "truth")["particles"]
    views, depth, source = cameras_of(frames), depth_of(frames), frames["source_frame"]
    rng = np.random.default_rng(0)
    top = rng.permutation(np.flatnonzero(particles[0, :, 2] > particles[0, :, 2].max() - 0.002))[:spots]
    found = []
    for spot in top:
        for frame in FRAMES:
            seen = []
            for c, camera in enumerate(views):
                pixels, z = camera.project(particles[source[frame, c], spot][None])
                column, row = pixels[0]
                if not (2 < column < camera.width - 3 and 2 < row < camera.height - 3):
                    continue
                reading = depth.depth(frame, c)[round(row), round(column)] * camera.depth_scale
                if abs(reading - z[0]) < SURFACE:
                    at = pixels[0] + rng.normal(0, noise, 2)
                    seen.append(Click(f"spot {spot}", camera.name, int(source[frame, c]), *at))
            found += seen[:cameras]
    return found


def scored(run):
    """What the stage makes of the sequence, and what it says."""
    (outcome,) = run_stage(open_run(run), STAGES["score"], Options((NAME,)))
    return outcome, None if outcome.error else read_artifact(run / "scores" / f"{NAME}.h5", "scores")


@pytest.mark.parametrize(("cameras", "near"), [(3, 3.0), (1, 8.0)])
def test_clicks_say_what_the_true_surface_says(run, cameras, near):
    write_clicks(run / "clicks" / f"{NAME}.csv", clicks_of(run, 5, cameras))
    outcome, scores = scored(run)
    names = np.array(scores.texts("score_name"))
    by_hand = scores["score_value"][names == SPOTS]
    truly = scores["score_value"][names == "tracked particles, all frames [mm]"]
    assert len(by_hand) >= 10
    assert abs(np.median(by_hand) - np.median(truly)) < near
    assert "spots clicked by hand: median" in outcome.quality
    assert outcome.warnings == ()


def test_tracking_that_is_wrong_is_found_out(run):
    write_clicks(run / "clicks" / f"{NAME}.csv", clicks_of(run, 3, 3))
    inputs = {name: read_artifact(run / name / f"{NAME}.h5", name) for name in ("frames", "masks", "tracks")}
    inputs["tracks"].arrays["positions"][20:] += np.float32([0.02, 0, 0])
    found, _, _ = score_clicks(inputs, run / "clicks" / f"{NAME}.csv")
    late = [one.metres for one in found if one.frame >= 20]
    assert np.median(late) == pytest.approx(0.02, abs=0.003)


def test_clicks_enter_the_key_and_leave_it(run, sample_run):
    stage = STAGES["score"]
    without = open_run(sample_run).key(stage, NAME)
    assert open_run(run).key(stage, NAME) == without
    clicks = clicks_of(run, 2, 2)
    write_clicks(run / "clicks" / f"{NAME}.csv", clicks)
    given = open_run(run).key(stage, NAME)
    assert given != without
    assert open_run(run).key(stage, "sequence_0001") == open_run(sample_run).key(stage, "sequence_0001")
    write_clicks(run / "clicks" / f"{NAME}.csv", clicks[:-1])
    assert open_run(run).key(stage, NAME) not in (given, without)
    (run / "clicks" / f"{NAME}.csv").unlink()
    assert open_run(run).key(stage, NAME) == without


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("a,cam9,0,10,10", "line 2: there is no camera cam9"),
        ("a,cam0,999,10,10", "line 2: camera cam0 has no image 999"),
        ("a,cam0,0,10,400", "line 2: column 10, row 400 is outside the image of 424 x 318 px"),
        ("", "has no line of clicks"),
    ],
)
def test_clicks_that_cannot_be_are_refused_with_their_line(run, line, said):
    (run / "clicks").mkdir()
    (run / "clicks" / f"{NAME}.csv").write_text(f"spot,camera,frame,column,row\n{line}\n")
    outcome, _ = scored(run)
    assert said in str(outcome.error)


def test_clicks_of_no_sequence_are_refused(run):
    (run / "clicks").mkdir()
    (run / "clicks" / "sequence_9.csv").write_text("spot,camera,frame,column,row\n")
    with pytest.raises(UsageError, match="there is no sequence sequence_9"):
        open_run(run).key(STAGES["score"], NAME)


def test_a_spot_that_is_clicked_once_is_told(run):
    write_clicks(run / "clicks" / f"{NAME}.csv", clicks_of(run, 1, 1)[:1])
    outcome, _ = scored(run)
    assert "is placed in one frame only" in outcome.warnings[0]
    assert "none in two frames" in outcome.quality
