"""Prompts of one sequence: they are its own, change nothing else, and show the mask that `segment` makes."""

import shutil

import numpy as np
import pytest

from piegraph_cli.errors import UsageError
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.recording.images import ImageStack, encode_masks
from piegraph_cli.stages import STAGES, open_run, segment
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.recipe import change_recipe
from tests.stages.chain import artifact

SEGMENT = STAGES["segment"]


def test_prompts_of_a_sequence_stand_in_place_of_those_for_all():
    params = SegmentParams(points={"left": (1, 2), "a/right": (3, 4)}, prompts={"b/left": (0, 0, 5, 5)})
    assert params.of("a").points == {"right": (3, 4)}
    assert (params.of("b").points, params.of("b").prompts) == ({}, {"left": (0, 0, 5, 5)})
    assert (params.of("c").points, params.of("c").prompts) == ({"left": (1, 2)}, {})
    assert params.sequences() == {"a", "b"}


def test_new_prompts_replace_those_of_the_same_sequence_alone():
    params = SegmentParams(
        points={"left": (1, 2), "a/right": (3, 4), "b/left": (5, 6)}, prompts={"a/left": (0, 0, 5, 5)}
    )
    given = params.prompted("a", {}, {"left": (7, 8)})
    assert given.points == {"left": (1, 2), "b/left": (5, 6), "a/left": (7, 8)}
    assert given.prompts == {}
    assert params.prompted("", {}, {}).points == {"a/right": (3, 4), "b/left": (5, 6)}


@pytest.fixture
def run(sample_run, tmp_path):
    shutil.copy(sample_run / "recipe.toml", tmp_path)
    for name in ("frames", "hands", "masks"):
        (tmp_path / name).symlink_to(sample_run / name)
    return tmp_path


def test_a_prompt_makes_one_sequence_stale_and_keeps_the_rest_of_the_recipe(run):
    before = open_run(run)
    change_recipe(run / "recipe.toml", STAGES, SEGMENT, {"points": {"sequence_0001/cam0": [200.0, 150.0]}})
    after = open_run(run)
    stale = [name for name in after.units(SEGMENT) if after.key(SEGMENT, name) != before.key(SEGMENT, name)]
    assert stale == ["sequence_0001"]
    assert after.recipe.sections | {"segment": before.recipe.sections["segment"]} == before.recipe.sections
    assert after.settings(SEGMENT, "sequence_0001").points == {"cam0": (200.0, 150.0)}


def test_a_prompt_for_no_sequence_is_refused(run):
    change_recipe(run / "recipe.toml", STAGES, SEGMENT, {"points": {"sequence_7/cam0": [200.0, 150.0]}})
    with pytest.raises(UsageError, match="there is no sequence sequence_7"):
        open_run(run).key(SEGMENT, "sequence_0000")
    change_recipe(run / "recipe.toml", STAGES, STAGES["ingest"], {"exclude": ["sequence_0002"]})
    change_recipe(run / "recipe.toml", STAGES, SEGMENT, {"points": {"sequence_0002/cam0": [200.0, 150.0]}})
    open_run(run).key(SEGMENT, "sequence_0000")  # what is left out may have a prompt


def test_the_mask_that_is_foreseen_is_the_one_that_is_made(run):
    name = "sequence_0000"
    frames, hands, masks = (read_artifact(run / a / f"{name}.h5", a) for a in ("frames", "hands", "masks"))
    made = ImageStack(masks["mask"], masks["mask_offsets"], 4, "mask")
    frame, foreseen, warnings = segment.foresee_masks(frames, hands, open_run(run).settings(SEGMENT, name))
    assert warnings == []
    assert all((mask == made.mask(frame, c)).all() for c, mask in enumerate(foreseen))
    at = np.argwhere(foreseen[2])[len(np.argwhere(foreseen[2])) // 2]
    _, clicked, _ = segment.foresee_masks(frames, hands, SegmentParams(points={"cam2": (at[1], at[0])}))
    assert all((a == b).all() for a, b in zip(clicked, foreseen, strict=True))


def test_masks_that_came_with_the_recording_are_foreseen_as_they_are():
    given = [np.eye(6, 8, dtype=bool), np.zeros((6, 8), bool)]
    data, offsets = encode_masks(given)
    frames = artifact({"mask": data, "mask_offsets": offsets, "image_size": [[8, 6], [8, 6]]})
    frame, foreseen, _ = segment.foresee_masks(frames, artifact({}), SegmentParams())
    assert frame == 0
    assert all((a == b).all() for a, b in zip(foreseen, given, strict=True))
