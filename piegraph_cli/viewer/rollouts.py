"""What every model of a run predicts for the strokes of one sequence, computed once, off the viewer's thread."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from piegraph_cli.errors import PiegraphError
from piegraph_cli.evaluation.params import ModelEvaluateParams
from piegraph_cli.stages import STAGES, train
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.run import Run

LONGEST = 10
"""Strokes that are predicted in a row, at most."""


@dataclass
class Rollouts:
    """The strokes of a sequence, and per model what it predicts after one, two, ... strokes."""

    frames: np.ndarray
    """[S, 2] the first and last frame of each stroke."""
    follows: np.ndarray
    """[S] whether a stroke follows on the one before with nothing unknown in between."""
    after: np.ndarray
    """[S, N, 3] m, what was tracked after each stroke."""
    seen: np.ndarray
    """[2, S, N] the particles whose places are known before and after each stroke."""
    predicted: dict[str, list[np.ndarray]] = field(default_factory=dict)
    """Per label and horizon - 1: [W, N, 3] m, at the end of the window that starts before stroke w."""
    failed: dict[str, str] = field(default_factory=dict)
    """Per label why there is no prediction."""

    @property
    def longest(self) -> int:
        """The longest horizon."""
        return min(LONGEST, len(self.frames))

    def stroke(self, frame: int) -> int:
        """The stroke that goes on at a frame, or the last one before it; the first one before all."""
        return max(0, int(self.frames[:, 0].searchsorted(frame, "right")) - 1)

    def known(self, stroke: int, horizon: int) -> bool:
        """Whether there are `horizon` strokes in a row that end with this one."""
        first = stroke - horizon + 1
        return first >= 0 and bool(self.follows[first + 1 : stroke + 1].all())

    def at(self, label: str, stroke: int, horizon: int) -> np.ndarray:
        """[N, 3] m: what a model predicts at the end of a stroke, `horizon` strokes in a row."""
        return self.predicted[label][horizon - 1][stroke - horizon + 1]

    def error(self, label: str, stroke: int, horizon: int) -> float:
        """Mean distance (m) from what was tracked, of the particles known before and after; NaN where none is."""
        known = self.seen[0, stroke - horizon + 1] & self.seen[1, stroke]
        if not self.known(stroke, horizon) or not known.any():
            return float("nan")
        apart = self.at(label, stroke, horizon)[known] - self.after[stroke][known]
        return float(np.linalg.norm(apart, axis=1).mean())


def models_of(run: Run) -> dict[str, str]:
    """The models to show by label: of each the first that was trained, by its name in the run."""
    names: dict[str, str] = {}
    for name in run.units(STAGES["evaluate"]):
        names.setdefault(train.split_model(str(name))[0], str(name))
    return names


def strokes_of(run: Run, sequence: str) -> tuple[Rollouts, dict[str, Any]] | str:
    """The strokes of a sequence of the run's dataset, and what models need of it; or why there are none."""
    from piegraph_cli.stages.learning import read_sequence

    data = read_artifact(run.path("dataset", None), "dataset")
    names = data.texts("sequence_name")
    if sequence not in names:
        return f"{sequence} is not in the dataset"
    found = read_sequence(data, names.index(sequence))
    if not len(found["strokes"]):
        return f"{sequence} has no strokes"
    return Rollouts(found["frames"], found["follows"], found["after"], found["seen"]), found


def add_models(
    rollouts: Rollouts, found: dict[str, Any], run: Run, going_on: Callable[[], bool], done: Callable[[], None]
) -> None:
    """Predict with one model after the other while it is `going_on`; `done` is called after each."""
    from piegraph_cli.evaluation.windows import rollouts as roll
    from piegraph_cli.stages.learning import read_model

    settings = run.params("evaluate").model_dump(exclude={"models"})
    for label, name in models_of(run).items():
        if not going_on():
            return
        try:
            own = train.trained_name(name)
            trained = read_model(read_artifact(run.path("model", own), "model")) if own else None
            params = ModelEvaluateParams(label=label, **settings)
            rollouts.predicted[label] = [x for _, x, _ in roll(found, trained, params, rollouts.longest)]
        except PiegraphError as error:
            rollouts.failed[label] = error.message
        done()
