"""Splits by name and by a file. Those by numbers: `tests/stages/test_splits.py`."""

import pytest
from pydantic import ValidationError

from piegraph_cli.dynamics.params import DatasetParams
from piegraph_cli.dynamics.splits import TEST, TRAIN, VALIDATION, chosen_sequences, parse_split, split_sequences
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.stages import dataset
from tests.stages.chain import context, tracks

NAMES = ["a", "b", "c", "d", "e"]


def split(empty: set[str] = frozenset(), **settings) -> list[int]:
    return split_sequences(NAMES, DatasetParams(**settings), set(empty)).tolist()


def test_sequences_named_train_and_validate_and_all_others_test():
    assert split(train_names="d,b") == [TEST, TRAIN, TEST, TRAIN, TEST]
    assert split(train_names=("a",), validation_names=("e",)) == [TRAIN, TEST, TEST, TEST, VALIDATION]


def test_where_test_sequences_are_named_the_others_are_left_out():
    params = DatasetParams(train_names="a,d", test_names="c")
    assert chosen_sequences(NAMES, params) == ["a", "c", "d"]
    assert split_sequences(["a", "c", "d"], params, set()).tolist() == [TRAIN, TEST, TRAIN]
    assert chosen_sequences(NAMES, DatasetParams(train_names="a")) == NAMES
    assert chosen_sequences(NAMES, DatasetParams()) == NAMES


def test_names_that_no_sequence_has_are_refused():
    with pytest.raises(UsageError, match="the split names x, but there is no such sequence") as error:
        chosen_sequences(NAMES, DatasetParams(train_names="a,x"))
    assert "a, b, c, d, e" in error.value.hint


def test_something_is_left_to_train_and_to_test_on():
    with pytest.raises(DataError, match="no sequence to test on"):
        split(train_names="a,b,c,d,e")
    with pytest.raises(DataError, match="no sequence to test on"):
        split(empty={"c", "d", "e"}, train_names="a,b", test_names="c,d")
    with pytest.raises(DataError, match="no sequence to train on"):
        split(empty={"a"}, train_names="a")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"train_names": "a,b", "test_names": "b"}, "b is in more than one part"),
        ({"train_names": "a,a"}, "a is in more than one part"),
        ({"train_names": "a", "split": "file.csv"}, "give one of them"),
    ],
)
def test_parts_that_contradict_each_other_are_refused(settings, message):
    with pytest.raises(ValidationError, match=message):
        DatasetParams(**settings)


def test_a_file_has_a_line_per_sequence():
    text = "# by day\na,train\n\n one, two ,validation\nc, test\n"
    assert parse_split(text) == {"train": ["a"], "validation": ["one, two"], "test": ["c"]}
    for wrong, message in (
        ("a,train\nb;test\n", "cannot read 'b;test'"),
        ("a,train\na,test\n", "names sequence a twice"),
        ("a,train\n,test\n", "cannot read ',test'"),
        ("a,train\nb,Test\n", "cannot read 'b,Test'"),
    ):
        with pytest.raises(DataError, match=message) as error:
            parse_split(wrong)
        assert error.value.where == "line 2"


def test_a_file_splits_as_its_names_do(tmp_path):
    path = tmp_path / "split.csv"
    path.write_text("b,train\nd,train\na,validation\ne,test\n")
    found = {name: tracks(k) for k, name in enumerate(NAMES)}
    by_file = dataset.run({"tracks": found}, DatasetParams(split=path), context())
    names = {"train_names": "b,d", "validation_names": "a", "test_names": "e"}
    by_name = dataset.run({"tracks": found}, DatasetParams(**names), context())
    assert by_file.arrays["sequence_name"].tolist() == ["a", "b", "d", "e"]
    assert by_file.arrays["sequence_split"].tolist() == [VALIDATION, TRAIN, TRAIN, TEST]
    assert "1 sequence in no part of the split" in by_file.quality
    assert all((by_file.arrays[name] == by_name.arrays[name]).all() for name in by_file.arrays)
    path.write_text("b,train\nnobody\n")
    with pytest.raises(DataError, match="cannot read 'nobody'") as error:
        dataset.run({"tracks": found}, DatasetParams(split=path), context())
    assert error.value.where == f"{path}, line 2"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="cannot be read: "):
        dataset.run({"tracks": found}, DatasetParams(split=path), context())
