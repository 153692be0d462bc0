"""Settings of `score` and `evaluate`."""

from pathlib import Path

from pydantic import Field

from piegraph_cli.dynamics.params import MODEL_NAMES, Labels, PredictionParams
from piegraph_cli.params import Counts, Params


class ScoreParams(Params):
    """Settings of `score`."""

    later = ("clicks",)

    clicks: Path | None = Field(
        None, description="folder with a SEQUENCE.csv of spots clicked by hand (default: clicks in the run)"
    )


class EvaluateParams(PredictionParams):
    """Settings of `evaluate`."""

    models: Labels = Field(
        ("static", "piegraph-ng", "piegraph", "kabsch"), description=f"models to compare, of {MODEL_NAMES}"
    )
    horizons: Counts = Field((1, 2, 4), description="strokes predicted in a row")


class ModelEvaluateParams(PredictionParams):
    """Everything that the evaluation of one model depends on, beside what it learned."""

    label: str = Field(description="model; after : a variant, after @ the number of training sequences")
    horizons: Counts = Field(description="strokes predicted in a row")
