"""Which image belongs to which frame: images and time stamps are put together by the number in the file's name."""

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError

Number = tuple[Decimal, ...]
"""The numbers in a file's name, in order; the last one that is not the same in all counts frames."""


def number_of(path: Path) -> Number:
    """The numbers in a file's name: of `left_07` 7, of `cam2_000010` 2 and 10, of `1700000000.25` the decimal number.

    Raises `DataError` where there is none.
    """
    pattern = r"\d+\.\d+" if re.fullmatch(r"\d+\.\d+", path.stem, re.ASCII) else r"\d+"
    found = tuple(Decimal(part) for part in re.findall(pattern, path.stem, re.ASCII))
    if not found:
        raise DataError(f"image {path.name} has no number in its name", str(path.parent), "number the frames: 000000")
    return found


def by_number(files: Sequence[Path]) -> dict[Number, Path]:
    """Files by the numbers in their names, in their order. Raises `DataError` where two have the same, as 1 and 01."""
    found: dict[Number, Path] = {}
    for path in sorted(files):
        other = found.setdefault(number_of(path), path)
        if other != path:
            message = f"{other.name} and {path.name} are the same frame"
            raise DataError(message, str(path.parent), "remove one of them")
    return dict(sorted(found.items()))


def counted(files: Sequence[Path]) -> list[Decimal]:
    """What counts the frames of files: the last number in their names that is not the same in all, as a size is."""
    numbers = [number_of(path) for path in files]
    if len(numbers) < 2 or len({len(number) for number in numbers}) > 1:
        return [number[-1] for number in numbers]
    columns = [column for column in zip(*numbers, strict=True) if len(set(column)) > 1]
    return list(columns[-1]) if columns else [number[-1] for number in numbers]


def pair_files(one: dict[Number, Path], other: dict[Number, Path]) -> dict[Path, Path]:
    """The partner in `other` of each file of `one`, by number; where the names share none, as `color_1` and `depth16_1`, by
    what counts in each.
    """
    if not one.keys() & other.keys():
        ours, theirs = (dict(zip(counted(list(of.values())), of.values(), strict=True)) for of in (one, other))
        if len(ours) == len(one) and len(theirs) == len(other):
            return {path: theirs[number] for number, path in ours.items() if number in theirs}
    return {path: other[number] for number, path in one.items() if number in other}


def match_stamps(files: Sequence[Path], stamps: int, where: str) -> tuple[np.ndarray, list[str]]:
    """The line of timestamps.txt (from 0) of each image, for images in order of their numbers, and warnings.

    As many lines as images: in order. Otherwise by number, if the lines are as many as the numbers from the first image
    to the last. Raises `DataError` naming both counts where it is neither.
    """
    numbers = counted(files)
    steps = np.diff(np.array(numbers, float))
    lines = np.arange(len(files))
    if len(files) == stamps:
        gaps = frame_gaps(files, where)
        return lines, [f"{text}: images and time stamps, {stamps} each, are paired in order" for text in gaps]
    whole = all(number == int(number) for number in numbers) and (steps > 0).all()
    if numbers and whole and 0 < len(files) < stamps and numbers[-1] - numbers[0] + 1 == stamps:
        warning = f"{where}: {stamps - len(files)} time stamps without an image, left out; images go by their numbers"
        return np.array([int(number - numbers[0]) for number in numbers]), [warning]
    raise DataError(
        f"camera {Path(where).name} has {len(files)} frames and {stamps} time stamps",
        where,
        "each frame needs one line of timestamps.txt",
    )


def frame_gaps(files: Sequence[Path], where: str) -> list[str]:
    """A word on gaps between the numbers of images in their order, if there are any."""
    steps = np.diff(np.array(counted(files), float))
    odd = np.flatnonzero(steps > 1.5 * np.median(steps)) if len(steps) else steps
    if not len(odd):
        return []
    more = f", and {len(odd) - 1} more gaps" if len(odd) > 1 else ""
    return [f"{where}: no image between {files[int(odd[0])].stem} and {files[int(odd[0]) + 1].stem}{more}"]


def frame_numbers(files: Sequence[Path]) -> np.ndarray:
    """What each image is called by, int64 [image]: the number in its name, or its place where that is no whole number."""
    numbers = counted(files)
    whole = all(n == int(n) and n < 2**62 for n in numbers) and len(set(numbers)) == len(numbers)
    return np.array([int(n) for n in numbers] if whole else range(len(files)), np.int64)
