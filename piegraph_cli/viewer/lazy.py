"""An artifact that stays on the disk, for functions that take one in memory: a long recording's images would not fit."""

import json
from typing import Any

import numpy as np

from piegraph_cli.workspace.artifact import Artifact
from piegraph_cli.workspace.schema import SCHEMAS
from piegraph_cli.workspace.slices import Slices


class Rows:
    """A dataset, read where it is sliced."""

    def __init__(self, held: Slices, dataset: str):
        self.held, self.dataset = held, dataset

    def __len__(self) -> int:
        return self.held.lengths[SCHEMAS[self.held.name][self.dataset].axes.partition(",")[0]]

    def __getitem__(self, where: slice) -> np.ndarray:
        return self.held.rows(self.dataset, int(where.start), int(where.stop))


def lazily(held: Slices) -> Artifact:
    """The open artifact with its encoded images left where they are."""
    arrays: dict[str, Any] = {
        name: Rows(held, name) if field.units == "encoded image" else held[name]
        for name, field in SCHEMAS[held.name].items()
        if name in held
    }
    return Artifact(held.path, held.name, held.key, json.loads(held.settings), {}, held.quality, arrays)
