"""Runs and sequences as they are opened: half done, damaged, of other versions, replaced meanwhile."""

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.viewer.pictures import Pictures
from piegraph_cli.viewer.source import OF_SEQUENCE, OpenRun, Sequence
from tests.hdf5 import edited
from tests.viewer import made


def opened(folder, *artifacts, name="first"):
    return Sequence(OpenRun.of(made.make_run(folder, *artifacts)), name)


def test_a_run_whose_recording_is_gone_has_the_sequences_that_were_read(tmp_path):
    run = OpenRun.of(made.make_run(tmp_path / "run", "frames", sequences=("first", "second")))
    assert (run.names, run.trouble) == (["first", "second"], "")


def test_a_run_without_a_recording_has_none_and_says_why(tmp_path):
    (tmp_path / "recipe.toml").write_text("[ingest]\n")
    run = OpenRun.of(tmp_path)
    assert run.names == []
    assert "no recording" in run.trouble


def test_what_is_not_made_yet_is_told_with_its_command(tmp_path):
    sequence = opened(tmp_path / "run", "frames")
    assert len(sequence) == made.FRAMES
    assert sequence.missing("frames") == ""
    assert sequence.missing("frames", "tracks") == f"no tracks yet: `piegraph run --run {tmp_path}/run --until track`"


def test_a_command_can_be_pasted_whatever_the_run_is_called(tmp_path):
    sequence = opened(tmp_path / "my run; $x", "frames")
    assert f"piegraph run --run '{tmp_path}/my run; $x' --until track" in sequence.missing("tracks")


def test_an_empty_sequence_has_no_frames(tmp_path):
    sequence = opened(tmp_path / "run")
    assert len(sequence) == len(sequence.time) == len(sequence.cameras) == 0
    assert all(sequence.missing(name) for name in OF_SEQUENCE)


def test_what_a_recipe_does_not_make_is_told_without_a_command(tmp_path):
    (tmp_path / "recipe.toml").write_text("[trials]\n")
    sequence = Sequence(OpenRun.of(tmp_path), "")
    assert sequence.missing("frames") == "this run makes no frames"


def test_times_begin_at_the_first_frame(tmp_path):
    np.testing.assert_allclose(opened(tmp_path / "run", "tracks").time, np.arange(made.FRAMES) / 5)


def test_an_artifact_of_another_schema_is_left_out_and_told(tmp_path):
    folder = made.make_run(tmp_path / "run", "frames", "tracks")
    with edited(folder / "tracks" / "first.h5") as file:
        file.attrs["schema_version"] = 0
    sequence = Sequence(OpenRun.of(folder), "first")
    assert sequence.get("tracks") is None
    assert "not an artifact of this version" in sequence.missing("tracks")
    assert "--force" in sequence.missing("tracks")
    assert sequence.get("frames") is not None


def test_an_artifact_with_other_frames_than_the_first_is_stale(tmp_path):
    folder = made.make_run(tmp_path / "run", "frames")
    made.write(folder, "tracks", time=np.arange(4) / 5)
    sequence = Sequence(OpenRun.of(folder), "first")
    assert sequence.get("tracks") is None
    assert "4 frames, and frames has 6" in sequence.missing("tracks")


@pytest.mark.parametrize("artifact", ["tracks", "hands"])
def test_what_comes_goes_or_is_made_anew_is_noticed(tmp_path, artifact):
    folder = made.make_run(tmp_path / "run", "frames", "tracks")
    sequence = Sequence(OpenRun.of(folder), "first")
    assert not sequence.changed()
    path = made.write(folder, artifact)
    assert sequence.changed()
    sequence = Sequence(OpenRun.of(folder), "first")
    path.unlink()
    assert sequence.changed()


def test_models_and_plans_that_come_are_noticed(tmp_path):
    folder = made.make_run(tmp_path / "run", "frames")
    for file in ("plan.h5", "model/piegraph.seed0.h5", "model/piegraph.seed1.h5"):
        sequence = Sequence(OpenRun.of(folder), "first")
        assert not sequence.changed()
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_bytes(b"")
        assert sequence.changed()


def test_what_cannot_be_read_is_no_change_until_it_is_replaced(tmp_path):
    folder = made.make_run(tmp_path / "run", "frames", "tracks")
    path = folder / "tracks" / "first.h5"
    path.write_bytes(b"half")
    sequence = Sequence(OpenRun.of(folder), "first")
    assert "cannot be shown" in sequence.missing("tracks")
    assert not sequence.changed()
    made.write(folder, "tracks")
    assert sequence.changed()


def test_pictures_are_decoded_by_frame_with_their_masks(tmp_path):
    pictures = Pictures(opened(tmp_path / "run", "frames", "masks"))
    found = pictures.at(3)
    assert [picture.camera.name for picture in found] == ["left", "right"]
    np.testing.assert_allclose(found[1].image[20, 20], made.BLUE, atol=4)
    assert found[0].mask is not None
    assert found[0].mask.all()
    assert pictures.at(3) is found


def test_pictures_without_masks_or_frames(tmp_path):
    assert Pictures(opened(tmp_path / "a", "frames")).at(0)[0].mask is None
    assert Pictures(opened(tmp_path / "b", "tracks")).at(0) == []


def test_an_image_that_cannot_be_decoded_is_named(tmp_path):
    folder = made.make_run(tmp_path / "run", "frames")
    color = made.frames_arrays()["color"]
    color = np.where(np.arange(len(color)) < 50, 0, color)
    made.write(folder, "frames", color=color)
    pictures = Pictures(Sequence(OpenRun.of(folder), "first"))
    pictures.at(1)
    with pytest.raises(DataError, match="frame 0, camera left"):
        pictures.at(0)
