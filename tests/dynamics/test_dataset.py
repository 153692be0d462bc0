"""What of a sequence becomes examples: nothing of what was not seen, and strokes that are straight."""

import numpy as np
import pytest

from piegraph_cli.dynamics.dataset import build_dataset, find_strokes
from piegraph_cli.dynamics.params import DatasetParams
from piegraph_cli.errors import DataError
from piegraph_cli.stages import dataset
from tests.stages.chain import context, tracks

PARAMS = DatasetParams(train=1)
EVERY = 4 + 3 + 2 + 1
"""Pairs of a stroke of six frames."""


def hidden(*frames: int, share: float = 1.0, pick: bool = False) -> dict[str, np.ndarray]:
    """Three strokes, at frames 0-5, 7-12 and 14-19; a share of the particles is not seen in some frames."""
    found = dict(tracks(0, strokes=3, pick=pick).arrays)
    count = round(share * found["visibility"].shape[1])
    for frame in frames:
        found["visibility"][frame, :count] = 0
    return found


def test_what_is_seen_is_left_whole():
    found = find_strokes(hidden(), PARAMS)
    assert found.strokes.tolist() == [[0, 5], [7, 12], [14, 19]]
    assert found.follows.tolist() == [False, True, True]
    assert (found.unseen, found.strokes_lost, found.pairs_lost) == (0, 0, 0)


def test_an_object_that_leaves_the_view_teaches_nothing_from_there_on():
    found = find_strokes(hidden(*range(10, 21)), PARAMS)
    assert found.strokes.tolist() == [[0, 5], [7, 9]]
    assert (found.unseen, found.strokes_lost, found.pairs_lost) == (11, 1, 3 * EVERY - EVERY - 1)


def test_an_object_that_comes_back_loses_only_what_was_not_seen():
    found = find_strokes(hidden(9, 10), PARAMS)
    assert found.strokes.tolist() == [[0, 5], [7, 8], [11, 12], [14, 19]]
    assert found.follows.tolist() == [False, True, False, True], "what the hand did meanwhile is unknown"
    assert found.strokes_lost == 0
    assert found.pairs_lost == EVERY - 2
    assert all(frame not in (9, 10) for pairs in found.pairs for frame in pairs.ravel())


def test_unseen_between_two_strokes_breaks_the_row_alone():
    found = find_strokes(hidden(6), PARAMS)
    assert (len(found.strokes), found.follows.tolist()) == (3, [False, False, True])
    assert (found.unseen, found.strokes_lost, found.pairs_lost) == (1, 0, 0)


@pytest.mark.parametrize(("share", "min_seen", "kept"), [(0.4, 0.5, 3), (0.6, 0.5, 2), (0.6, 0.3, 3), (0.4, 0.7, 2)])
def test_a_frame_counts_as_seen_by_the_share_of_the_object_seen_in_it(share, min_seen, kept):
    found = find_strokes(hidden(*range(7, 13), share=share), DatasetParams(min_seen=min_seen))
    assert len(found.strokes) == kept


def test_of_a_pick_the_ends_have_to_be_seen():
    between = find_strokes(hidden(9, 10, pick=True), PARAMS)
    assert between.strokes.tolist() == [[0, 5], [7, 12], [14, 19]]
    assert between.pairs[1].tolist() == [[7, 11], [7, 12], [8, 11], [8, 12]]
    at_end = find_strokes(hidden(12, pick=True), PARAMS)
    assert at_end.strokes.tolist() == [[0, 5], [14, 19]]
    assert (at_end.strokes_lost, at_end.pairs_lost) == (1, EVERY)


def run(found: dict, apart: float = 0.001, **settings):
    """The stage on sequences that lie so far (m) from each other: no object lies twice at one place."""
    moved = {name: one | {"positions": one["positions"] + k * apart} for k, (name, one) in enumerate(found.items())}
    return dataset.run({"tracks": moved}, DatasetParams(**{"train": 1} | settings), context())


def test_the_dataset_says_what_was_not_seen_and_where():
    found = {"one": hidden(), "two": hidden(*range(10, 21)), "three": hidden()}
    output = run(found)
    assert "left out, object not seen: 1 stroke, 19 pairs" in output.quality
    (warning,) = output.warnings
    assert "11 frames see too little" in warning
    assert "two (11 frames)" in warning
    assert run({"one": hidden(), "two": hidden()}).warnings == []
    assert "two is one" in run({"one": hidden(), "two": hidden()}, apart=0).warnings[0]


def test_a_dataset_of_nothing_seen_says_so():
    with pytest.raises(DataError, match="no stroke was found") as error:
        build_dataset({"one": hidden(*range(21))}, PARAMS)
    assert "min_seen" in error.value.hint


def curved() -> dict[str, np.ndarray]:
    """A push around a corner: 15 cm along x, 15 cm along y, and never lifted."""
    count = 31
    hand = np.zeros((count, 3))
    hand[:, 0] = np.minimum(np.arange(count), 15) * 0.01
    hand[:, 1] = np.maximum(np.arange(count) - 15, 0) * 0.01
    object_ = hidden()["positions"][0]
    return {
        "positions": (object_ + hand[:, None]).astype(np.float32),
        "end_effector": hand,
        "contact": np.ones(count, bool),
        "mode": np.zeros(count, np.uint8),
        "visibility": np.ones((count, len(object_))),
        "time": np.arange(count) / 5,
    }


def test_a_push_around_a_corner_becomes_two_strokes_in_a_row():
    output = run({"one": curved(), "two": hidden()})
    assert output.arrays["strokes"][:2].tolist() == [[0, 15], [15, 30]]
    assert output.arrays["stroke_follows"].tolist() == [False, True, False, True, True]
    assert "1 pushes into 2 pieces, 0 of them too short" in output.quality
    assert "bend by more than max_bend" in output.warnings[0]
    whole = run({"one": curved(), "two": hidden()}, max_bend=1.0)
    assert whole.arrays["strokes"][0].tolist() == [0, 30]
    assert whole.warnings == []


def test_a_pick_may_bend():
    assert find_strokes(curved() | {"mode": np.ones(31, np.uint8)}, PARAMS).strokes.tolist() == [[0, 30]]


def test_pieces_too_short_are_dropped_and_counted():
    found = find_strokes(curved(), DatasetParams(min_stroke=0.16))
    assert (len(found.strokes), found.cut.short) == (0, 2)


def test_frames_that_are_not_trusted_are_no_examples():
    doubt = np.full(21, 0.01, np.float32)
    whole = find_strokes(hidden(), PARAMS)
    assert find_strokes(hidden() | {"trust/doubt": doubt}, PARAMS).strokes.tolist() == whole.strokes.tolist()
    doubt[8:10] = 0.04
    found = find_strokes(hidden() | {"trust/doubt": doubt}, PARAMS)
    assert (found.unseen, found.pairs_lost > 0) == (2, True)
    lenient = find_strokes(hidden() | {"trust/doubt": doubt}, DatasetParams(max_doubt=0.05))
    assert lenient.strokes.tolist() == whole.strokes.tolist()


def test_particles_that_are_not_seen_are_marked_and_told():
    one = hidden()
    one["visibility"] = one["visibility"].copy()
    one["visibility"][:, :4] = 0.05
    output = run({"one": one, "two": hidden()})
    seen = output.arrays["seen"]
    assert not seen[:21, :4].any()
    assert seen[:21, 4:].all()
    assert seen[21:].all()
    assert "% of the particles not seen, which teach nothing" in output.quality
    assert "not seen" not in run({"one": hidden(), "two": hidden()}).quality
