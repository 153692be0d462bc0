"""Which sequences train, validate and test: by numbers and a seed, by name, or as a file says."""

from collections.abc import Mapping, Sequence

import numpy as np

from piegraph_cli.dynamics.params import DatasetParams
from piegraph_cli.errors import DataError, UsageError

TRAIN, VALIDATION, TEST = 0, 1, 2
PARTS = {"train": TRAIN, "validation": VALIDATION, "test": TEST}


def parse_split(text: str) -> dict[str, list[str]]:
    """The names of each part, from lines `NAME,PART`; empty lines and lines that begin with # are none.

    Raises `DataError` naming the line.
    """
    found: dict[str, list[str]] = {part: [] for part in PARTS}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        name, _, part = (word.strip() for word in line.rpartition(","))
        if not name or part not in PARTS:
            raise DataError(f"cannot read {line.strip()!r}", f"line {number}", f"NAME,PART with {', '.join(PARTS)}")
        if any(name in names for names in found.values()):
            raise DataError(f"names sequence {name} twice", f"line {number}", "a line per sequence")
        found[part].append(name)
    return found


def named_parts(params: DatasetParams) -> dict[str, list[str]]:
    """The names of each part, as the settings name them."""
    return {part: list(getattr(params, f"{part}_names")) for part in PARTS}


def with_split(params: DatasetParams, parts: Mapping[str, Sequence[str]]) -> DatasetParams:
    """The settings with the parts of a file in place of the file."""
    return params.model_copy(update={"split": None} | {f"{part}_names": tuple(parts[part]) for part in PARTS})


def chosen_sequences(names: list[str], params: DatasetParams) -> list[str]:
    """The sequences that a dataset is made of: those that a split by name names, or all where it names no test ones.

    Raises `UsageError` for a name that no sequence has.
    """
    named = [name for part in named_parts(params).values() for name in part]
    unknown = [name for name in named if name not in names]
    if unknown:
        shown = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
        raise UsageError(f"the split names {unknown[0]}, but there is no such sequence", hint=f"sequences are {shown}")
    return [name for name in names if name in named] if params.test_names else names


def split_sequences(names: list[str], params: DatasetParams, empty: set[str]) -> np.ndarray:
    """Split [sequence]: the first `train` of a seeded order train, the next `validation` validate, the rest test.

    Where sequences are named, these train and validate, and all others test. Sequences without strokes go last.
    Raises `DataError` when there is no sequence left to test on, or to train on.
    """
    split = np.full(len(names), TEST, np.uint8)
    parts = named_parts(params)
    if any(parts.values()):
        for word, number in PARTS.items():
            split[[names.index(name) for name in parts[word] if name in names]] = number
        for word in ("train", "test"):
            if not any(part == PARTS[word] and name not in empty for part, name in zip(split, names, strict=True)):
                raise DataError(f"no sequence to {word} on has a stroke", hint=f"name others in {word}_names")
        return split
    order = np.random.default_rng(params.seed).permutation(len(names))
    order = np.array(sorted(order, key=lambda i: names[i] in empty))
    if len(names) - len(empty) <= params.train + params.validation:
        raise DataError(
            f"{len(names) - len(empty)} sequences with strokes, of which {params.train} are to train and "
            f"{params.validation} to validate: none is left to test on",
            hint="record more, or lower dataset.train",
        )
    split[order[: params.train]] = TRAIN
    split[order[params.train : params.train + params.validation]] = VALIDATION
    return split
