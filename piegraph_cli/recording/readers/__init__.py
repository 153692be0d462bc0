"""A module per layout of recordings.

Each has `read(folder, params)`, which gives the films of one sequence and warnings; one that holds the path of an
end-effector has `end_effector(folder, params)` as well, which gives that, or None where a recording lacks it.
"""

import importlib
import os
from pathlib import Path
from types import ModuleType

from piegraph_cli.recording.end_effector import NAME, EndEffectorPath, read_end_effector
from piegraph_cli.recording.film import Film
from piegraph_cli.recording.folders import check_files, fits, unreadable
from piegraph_cli.recording.params import ReadParams


def read_films(folder: Path, layout: str, params: ReadParams = ReadParams()) -> tuple[list[Film], list[str]]:
    """The films of a sequence folder, one a camera, by the reader of that name, and warnings.

    Raises `DataError` naming file and camera for what is missing or wrong.
    """
    if fits(layout, folder):
        check_files(folder)
    try:
        return _reader(layout).read(folder, params)
    except OSError as error:
        raise unreadable(error, folder) from None


def read_path(folder: Path, layout: str, params: ReadParams) -> EndEffectorPath | None:
    """The path of the end-effector of a sequence: from its `end_effector.csv`, else as its layout holds it; None without.

    Raises `DataError` naming file and line for what is wrong.
    """
    if os.path.lexists(folder / NAME):
        return read_end_effector(folder / NAME)
    held = getattr(_reader(layout), "end_effector", None)
    return held(folder, params) if held else None


def _reader(layout: str) -> ModuleType:
    return importlib.import_module(f"{__name__}.{layout}")
