"""Stage `evaluate`: one model's predictions on held-out sequences."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from piegraph_cli.environments.params import SIMULATORS
from piegraph_cli.errors import DataError
from piegraph_cli.evaluation.params import EvaluateParams, ModelEvaluateParams
from piegraph_cli.stages import score, simulate, train
from piegraph_cli.text import counted
from piegraph_cli.workspace.call import Call, Told
from piegraph_cli.workspace.stage import Context, Inputs, Output, Stage, Unit

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.workspace.artifact import Artifact
    from piegraph_cli.workspace.run import Run

COLUMNS = ("horizon", "sequence", "first_stroke", "cd", "s", "pd", "pd_truth", "motion", "correction")


def _units(run: "Run") -> Sequence[Unit]:
    return train.model_names(run.params(STAGE.name).models, run.params("train"))


def _settings(run: "Run", unit: str) -> ModelEvaluateParams:
    params = run.params(STAGE.name)
    return ModelEvaluateParams(label=train.split_model(unit)[0], **params.model_dump(exclude={"models"}))


def _inputs(run: "Run", unit: Unit) -> Inputs:
    """The dataset, the trained model where one is used, and the scores that there are: a real recording has none."""
    model = train.trained_name(str(unit))
    scored = [name for name in run.made("scores") if run.fresh(score.STAGE, name) and score.told_by_truth(run, name)]
    return {"dataset": None} | ({"model": model} if model else {}) | ({"scores": scored} if scored else {})


def _belongs(run: "Run", unit: str) -> bool:
    """Models of an earlier comparison: those that the run trains, and those that nobody trains."""
    model = train.trained_name(unit)
    return model is None or model in run.units(train.STAGE)


STAGE = Stage(
    "evaluate",
    "measure predictions on held-out sequences",
    ("dataset", "model"),
    "metrics",
    EvaluateParams,
    version=6,
    run="piegraph_cli.stages.evaluate:run",
    unit="model",
    optional=("scores",),
    units=_units,
    settings=_settings,
    inputs=_inputs,
    belongs=_belongs,
    call=Call(first=("models", "horizons"), describe="piegraph_cli.stages.evaluate:describe"),
)


def run(inputs: dict[str, Any], params: ModelEvaluateParams, context: Context) -> Output:
    """Measure a model on every window of held-out strokes."""
    import numpy as np

    from piegraph_cli.dynamics.splits import TEST
    from piegraph_cli.evaluation.windows import window_metrics
    from piegraph_cli.process import choose_device, set_up_torch
    from piegraph_cli.stages.learning import read_model, read_sequence

    set_up_torch()
    _check_apart(inputs, context.run)
    data, trained = inputs["dataset"], read_model(inputs["model"]) if "model" in inputs else None
    names = data.texts("sequence_name")
    rows: dict[str, list] = {name: [] for name in COLUMNS}
    for index in context.progress(np.flatnonzero(data["sequence_split"] == TEST), "sequences"):
        sequence = read_sequence(data, int(index))
        true = _true_positions(inputs, names[index])
        for horizon, *values in window_metrics(sequence, true, trained, params, choose_device(context.device)):
            for column, value in zip(rows, (horizon, names[index], *values), strict=True):
                rows[column].append(value)
    if not rows["horizon"]:
        raise DataError(
            f"no held-out sequence has {min(params.horizons)} strokes in a row", hint="record longer sequences"
        )
    arrays = {name: np.array(values) for name, values in rows.items()}
    return Output(arrays, _quality(arrays, params), _warnings(arrays, params))


def _check_apart(inputs: dict[str, Any], run: "Run") -> None:
    """Refuse a model whose prior comes from the simulator of the test: it has seen what it is tested on."""
    model = inputs.get("model")
    if model is None or run.producer("tracks") != simulate.STAGE:
        return
    require_apart(model, run.params(simulate.STAGE.name).environment)


def require_apart(model: "Artifact", environment: str) -> None:
    """Refuse a model whose prior comes from the environment's simulator."""
    if "prior_simulator" in model and SIMULATORS[environment] in model.texts("prior_simulator"):
        raise DataError(
            f"its prior has learned from {SIMULATORS[environment]}, which it is tested on",
            str(model.path),
            "a prior of other physics: --from prior",
        )


def measured(run: "Run", name: str) -> bool:
    """Whether a run has fresh metrics of a model, by its `train.model_name`."""
    return name in run.units(STAGE) and run.fresh(STAGE, name)


def _true_positions(inputs: dict[str, Any], sequence: str) -> "np.ndarray | None":
    """The true particles [F, N, 3] (m) of a sequence that was scored."""
    scores = inputs.get("scores", {})
    true = scores[sequence]["true_positions"] if sequence in scores else None
    return None if true is None or len(true) == 0 else true


def read_metrics(run: "Run") -> tuple[dict[str, list["Artifact"]], list["Artifact"]]:
    """The fresh metrics of a run, by model and seed, and the scores of its sequences where it has any."""
    from piegraph_cli.workspace.artifact import read_artifact

    metrics: dict[str, list[Artifact]] = {}
    for name in run.units(STAGE):
        if name is not None and run.fresh(STAGE, name):
            metrics.setdefault(train.split_model(name)[0], []).append(
                read_artifact(run.path("metrics", name), "metrics")
            )
    paths = [run.path("scores", name) for name in run.made("scores") if run.fresh(score.STAGE, name)]
    return metrics, [read_artifact(path, "scores") for path in paths]


def describe(run: "Run") -> Told:
    """A run's metrics and scores as one object and as lines for people."""
    from piegraph_cli.evaluation.reliability import reliability, reliability_lines
    from piegraph_cli.evaluation.tables import summarise, summarise_scores, table_lines

    found, scores = read_metrics(run)
    metrics = {m: [a.arrays for a in seeds] for m, seeds in found.items()}
    rows, values, sure = summarise(metrics), summarise_scores([a.arrays for a in scores]), reliability(metrics)
    value = {"metrics": str(run.folder / "metrics"), "rows": rows, "scores": values, "reliability": sure}
    return value, table_lines(rows, values) + reliability_lines(sure)


def _quality(arrays: dict[str, "np.ndarray"], params: ModelEvaluateParams) -> str:
    import numpy as np

    means = {h: arrays["pd"][arrays["horizon"] == h].mean() for h in params.horizons if h in arrays["horizon"]}
    parts = [f"H={h} {mean:.2f}" for h, mean in means.items()]
    return f"PD [cm] {', '.join(parts)} on {counted(len(np.unique(arrays['sequence'])), 'held-out sequence')}"


def _warnings(arrays: dict[str, "np.ndarray"], params: ModelEvaluateParams) -> list[str]:
    absent = [h for h in params.horizons if h not in arrays["horizon"]]
    return [f"no held-out sequence has {absent[0]} strokes in a row: that horizon is left out"] if absent else []
