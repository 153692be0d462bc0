"""What `piegraph suggest` reads of a run: its models, what they learned from, and where the object lies."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from piegraph_cli.dynamics.models import make_foresee
from piegraph_cli.dynamics.params import split_label, trained_label
from piegraph_cli.dynamics.rigid_body import body_frame, carry, pose_now
from piegraph_cli.dynamics.sides import Recorded, open_side
from piegraph_cli.dynamics.splits import TRAIN
from piegraph_cli.dynamics.tuning import unseen
from piegraph_cli.errors import DataError, UsageError, command_line
from piegraph_cli.planning.model import Model
from piegraph_cli.planning.planner import choose_modes, stroke_space
from piegraph_cli.planning.question import chosen_particles, finite
from piegraph_cli.planning.suggest import Suggestions, suggest
from piegraph_cli.recording.ground import level, moved
from piegraph_cli.stages import open_run
from piegraph_cli.stages.learning import read_sequences
from piegraph_cli.stages.models import load_model
from piegraph_cli.stages.points import read_points
from piegraph_cli.stages.train import STAGE, model_name
from piegraph_cli.workspace.run import Run

FEWEST = 3
"""Recorded strokes below which it is said that hardly anything is known."""


@dataclass(frozen=True)
class Suggested:
    """Strokes to record, and what they are drawn with."""

    found: Suggestions
    state: np.ndarray
    """[N, 3] metres: the object's particles."""
    past: np.ndarray
    """[K, 2, 2] metres: starts and ends of the strokes that were learned from, moved with the object to where it is."""
    seeds: int
    """Models that were asked."""
    warnings: list[str]


def suggest_in(folder: Path, label: str, state: Path | None, count: int, seed: int) -> Suggested:
    """Strokes to record next for the run's object, where it was last seen or as the cloud in the file `state` shows it.

    Raises `UsageError` for a model that learns nothing, and `DataError` where none is trained or a cloud is not the object's.
    """
    run = open_run(folder)
    models = _models(run, folder, label)
    model = models[0]
    assert model.trained is not None
    limit = split_label(label)[2]
    data = read_sequences(run.read("dataset"), TRAIN, limit or None, run.params("train").seeds[0])
    data = unseen(data) if limit == 0 else data
    past = Recorded.of(data)
    now, rest, warnings = _where(run, model, state)
    pose = pose_now(rest, now, body_frame(rest, past.shape))
    settings = model.settings
    modes = choose_modes(settings, model.trained.modes, None)
    at_rest = torch.as_tensor(rest, dtype=torch.float32)
    foresee = [make_foresee(one.label, one.trained, at_rest, one.settings) for one in models]
    space = stroke_space(at_rest, settings, modes, settings.pusher_radius)
    found = suggest(foresee, model.trained.calibration, now, pose, past.size, space, past.seen, count, seed)
    poses, ends = torch.as_tensor(past.poses), data.whole().ends.double()
    drawn = carry(ends, poses, torch.as_tensor(pose).expand(len(poses), 3)).numpy()
    return Suggested(found, now, drawn, len(models), warnings + _gaps(past.seen, pose[2]))


def _models(run: Run, folder: Path, label: str) -> list[Model]:
    """The model of every seed that is trained."""
    if trained_label(label) is None:
        raise UsageError(f"{label} learns nothing: no stroke tells it more", "piegraph suggest", "--model piegraph")
    seeds = [
        s for s in run.params("train").seeds_of(label) if run.fresh(STAGE, model_name(str(trained_label(label)), s))
    ]
    if not seeds:
        hint = command_line("train", "--run", folder, "--model", str(trained_label(label)))
        raise DataError(f"{label} is not trained, or not from what there is now", str(folder), hint)
    return [load_model(folder, label, seed=s) for s in seeds]


def _where(run: Run, model: Model, state: Path | None) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """The object's particles now and at rest [N, 3] (m), and what is to be said of them."""
    assert model.trained is not None
    if state is not None:
        table = level(model.settings.table or (0, 0, 0)) if state.suffix != ".h5" else np.eye(4)
        cloud = moved(finite(read_points(state, None), str(state)), table)
        now, warnings = chosen_particles(cloud, model.trained, model.settings, None, False)
        return now, now, warnings
    data = run.read("dataset")
    last = int(data["stroke_sequence"].max(initial=-1))
    if last < 0:
        raise DataError("no stroke was recorded", str(data.path), "give --state, the object's cloud now")
    end = data["strokes"][data["stroke_sequence"] == last][-1, 1]
    return data["positions"][end], data["positions"][data["sequence_start"][last]], []


def _gaps(known: np.ndarray, turned: float) -> list[str]:
    """Words on what the recorded strokes leave open on an object that now lies `turned` (rad)."""
    if len(known) < FEWEST:
        return [
            f"learned from {len(known)} strokes: next to nothing is known, and what is suggested is mostly spread out"
        ]
    return open_side(known, turned, "now faces")
