"""A module per layout of recordings; each has `read(folder)`, which gives the films of one sequence and warnings."""

import importlib
from pathlib import Path

from piegraph_cli.recording.film import Film


def read_films(folder: Path, layout: str) -> tuple[list[Film], list[str]]:
    """The films of a sequence folder, one a camera, by the reader of that name, and warnings.

    Raises `DataError` naming file and camera for what is missing or wrong.
    """
    return importlib.import_module(f"{__name__}.{layout}").read(folder)
