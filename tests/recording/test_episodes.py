"""Episodes of PGND's `sub_episodes_v`: what is taken of them, what is turned, and every way in which one can be wrong."""

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.recording.motion import list_files, read_motion
from piegraph_cli.stages.import_tracks import READERS
from piegraph_cli.workspace.artifact import read_artifact
from tests.cli import piegraph, piegraph_json

FRAMES, COUNT = 30, 40


def write(folder, name="episode_0000", arms=1, gripper=None, seed=0):
    """A rope that a gripper, which comes down beside its middle, pushes along y; z points down."""
    place = folder / name
    place.mkdir(parents=True)
    along = np.linspace(-0.15, 0.15, COUNT)
    pushed = np.clip(np.arange(FRAMES) - 10, 0, 10) * 0.005
    near = np.exp(-((along / 0.1) ** 2))
    particles = np.zeros((FRAMES, COUNT, 3))
    particles[..., 0] = along
    particles[..., 1] = -pushed[:, None] * near
    particles[..., 2] = -0.01
    tip = np.stack([np.full(FRAMES, 0.01 * seed), -(np.arange(FRAMES) * 0.005 - 0.06), np.full(FRAMES, -0.02)], 1)
    tip[21:, 2] = -0.2
    resting = np.tile([0.3, 0.3, -0.2], (FRAMES, 1))
    np.savez(place / "traj.npz", xyz=particles.astype(np.float32), v=np.zeros_like(particles))
    np.savetxt(place / "eef_traj.txt", np.hstack([resting, tip] if arms == 2 else [tip]))
    np.savetxt(place / "eef_rot.txt", np.tile(np.eye(3).ravel(), (FRAMES, arms)))
    opening = np.ones(FRAMES) if gripper is None else gripper
    np.savetxt(place / "eef_gripper.txt", np.stack([opening * 0.08] * arms, 1))
    (place / "meta.txt").write_text("0 30\n")
    return place


def read(place, **more):
    return read_motion(place, 0.03, "push", READERS, **more)


def test_an_episode_is_turned_and_timed(tmp_path):
    found = read(write(tmp_path))
    np.testing.assert_allclose(found.time, np.arange(FRAMES) / 30)
    np.testing.assert_allclose(found.positions[0, :, 2], 0.01)
    assert found.positions[-1, COUNT // 2, 1] == pytest.approx(0.05, abs=1e-3), "y is turned with z"
    np.testing.assert_allclose(found.end_effector[0], [0, -0.06, 0.02], atol=1e-6)
    assert any("turned about x" in text for text in found.warnings)
    assert any("30 frames a second" in text for text in found.warnings)


def test_of_two_arms_the_one_that_moves_is_taken_and_said(tmp_path):
    found = read(write(tmp_path, arms=2))
    np.testing.assert_allclose(found.end_effector[0], [0, -0.06, 0.02], atol=1e-6)
    assert any("2 end-effectors" in text and "number 1 is taken" in text for text in found.warnings)


def test_a_folder_of_episodes_becomes_tracks_that_train(tmp_path):
    for k in range(12):
        write(tmp_path / "sub_episodes_v", f"episode_{k}", seed=k)
    names = [path.name for path in list_files(tmp_path / "sub_episodes_v", READERS)]
    assert names == [f"episode_{k}" for k in range(12)], "by number"
    run = tmp_path / "run"
    told = piegraph_json("import", tmp_path / "sub_episodes_v", "--run", run, "--particles", 20)
    assert {o["unit"]: o["state"] for o in told["outcomes"]} == dict.fromkeys(names, "done")
    tracks = read_artifact(run / "tracks" / "episode_3.h5", "tracks")
    assert tracks["positions"].shape == (FRAMES, 20, 3)
    assert tracks["mode"].tolist() == [0] * FRAMES, "a gripper that never opens or closes pushes"
    assert 3 <= tracks["contact"].sum() < FRAMES
    piegraph("dataset", "--run", run, "--train", 8)
    assert len(read_artifact(run / "dataset.h5", "dataset")["strokes"]) == 12


def test_a_gripper_that_closes_picks(tmp_path):
    closed = (np.arange(FRAMES) >= 11) & (np.arange(FRAMES) < 19)
    write(tmp_path, gripper=1.0 - closed)
    run = tmp_path / "run"
    piegraph("import", tmp_path / "episode_0000", "--run", run)
    tracks = read_artifact(run / "tracks" / "episode_0000.h5", "tracks")
    np.testing.assert_array_equal(tracks["contact"], closed)
    np.testing.assert_array_equal(tracks["mode"], closed)


def test_many_particles_want_to_be_thinned(tmp_path):
    place = write(tmp_path)
    many = np.random.default_rng(0).uniform(-0.1, -0.01, (FRAMES, 2500, 3))
    np.savez(place / "traj.npz", xyz=np.repeat(many[:1], FRAMES, 0))
    with pytest.raises(DataError, match="has 2500 particles") as refused:
        read(place)
    assert "--particles" in refused.value.hint
    assert (
        piegraph_json("import", place, "--run", tmp_path / "run", "--particles", 50)["outcomes"][0]["state"] == "done"
    )


def text(name, change):
    def breaks(place):
        lines = (place / name).read_text().splitlines()
        (place / name).write_text("\n".join(change(lines)))

    return breaks


@pytest.mark.parametrize(
    ("breaks", "file", "message"),
    [
        (text("eef_traj.txt", lambda rows: rows[:-3]), "eef_traj.txt", "27 lines of 3 numbers beside 30 frames"),
        (text("eef_traj.txt", lambda rows: ["0 0", *rows[1:]]), "eef_traj.txt", "line 2: has 3 numbers, expected 2"),
        (text("eef_traj.txt", lambda rows: [*rows[:-1], "0 0 nan"]), "eef_traj.txt", "line 30: 'nan' is not a finite"),
        (text("eef_traj.txt", lambda rows: [*rows[:-1], "0 0 1e"]), "eef_traj.txt", "line 30: '1e' is no number"),
        (text("eef_traj.txt", lambda rows: []), "eef_traj.txt", "is empty"),
        (text("eef_gripper.txt", lambda rows: rows[:-1]), "eef_gripper.txt", "holds 29 lines of 1 numbers"),
        (lambda p: np.savez(p / "traj.npz", v=np.zeros((FRAMES, 4, 3))), "traj.npz", "has no array xyz"),
        (lambda p: np.savez(p / "traj.npz", xyz=np.zeros((FRAMES, 4, 2))), "traj.npz", "xyz is float64 [30, 4, 2]"),
        (lambda p: (p / "traj.npz").write_bytes((p / "traj.npz").read_bytes()[:-50]), "traj.npz", "not a readable"),
        (
            lambda p: np.savez(p / "traj.npz", xyz=np.full((FRAMES, 4, 3), np.nan)),
            "episode_0000, frame 0",
            "not finite",
        ),
    ],
)
def test_what_is_wrong_with_an_episode_is_named_and_nothing_is_written(tmp_path, breaks, file, message):
    place = write(tmp_path)
    breaks(place)
    with pytest.raises(DataError) as refused:
        read(place)
    assert message in str(refused.value)
    assert file in refused.value.where
