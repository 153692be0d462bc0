"""The stages, one module each, and the table that the command line, the cache and `run` are made from."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from piegraph_cli.dynamics.params import DatasetParams, TrainParams
from piegraph_cli.environments.params import SimulateParams
from piegraph_cli.evaluation.params import EvaluateParams, ScoreParams
from piegraph_cli.params import Params
from piegraph_cli.perception.params import FuseParams, HandsParams, SegmentParams
from piegraph_cli.physics.params import TrackParams
from piegraph_cli.planning.params import PlanParams, TrialsParams
from piegraph_cli.recording.params import IngestParams


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline: which artifacts it reads and writes, its settings, and where its code is."""

    name: str
    reads: tuple[str, ...]
    writes: str
    per: Literal["sequence", "run", "model", "trial"]
    params: type[Params]
    version: int
    run: str
    """`module:function`, called as `function(inputs, params, context) -> Output`, with the settings of one model or trial."""
    help: str
    optional: tuple[str, ...] = ()
    """Artifacts read as well where the run has them."""

    def load(self) -> Callable:
        """Import the stage's function."""
        module, function = self.run.split(":")
        return getattr(importlib.import_module(f"piegraph_cli.stages.{module}"), function)


_TABLE = (
    Stage("simulate", (), "tracks", "sequence", SimulateParams, 1, "simulate:run", "simulate true particles"),
    Stage("ingest", (), "frames", "sequence", IngestParams, 1, "ingest:run", "read and check a recording"),
    Stage("hands", ("frames",), "hands", "sequence", HandsParams, 1, "hands:run", "find the hand in 3-D"),
    Stage("segment", ("frames", "hands"), "masks", "sequence", SegmentParams, 1, "segment:run", "mask the object"),
    Stage(
        "fuse",
        ("frames", "hands", "masks"),
        "clouds",
        "sequence",
        FuseParams,
        1,
        "fuse:run",
        "fuse the object's cloud",
    ),
    Stage("track", ("clouds",), "tracks", "sequence", TrackParams, 2, "track:run", "track particles"),
    Stage(
        "score",
        ("frames", "hands", "masks", "clouds", "tracks"),
        "scores",
        "sequence",
        ScoreParams,
        1,
        "score:run",
        "score a simulated recording against its truth",
    ),
    Stage(
        "dataset",
        ("tracks",),
        "dataset",
        "run",
        DatasetParams,
        1,
        "dataset:run",
        "cut strokes, pair frames, split",
    ),
    Stage("train", ("dataset",), "model", "model", TrainParams, 5, "train:run", "train models"),
    Stage(
        "evaluate",
        ("dataset", "model"),
        "metrics",
        "model",
        EvaluateParams,
        5,
        "evaluate:run",
        "measure predictions on held-out sequences",
        optional=("scores",),
    ),
    Stage("plan", ("model",), "plan", "run", PlanParams, 5, "plan:run", "plan strokes to a goal"),
    Stage(
        "trials",
        (),
        "trials",
        "trial",
        TrialsParams,
        4,
        "trials:run",
        "plan in a grid of environments, models, goals and seeds",
    ),
)

STAGES: dict[str, Stage] = {stage.name: stage for stage in _TABLE}
