"""Settings of experiments: which runs, which models, and the table they end in."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from piegraph_cli.dynamics.params import BUILT_IN, Labels, split_label, trained_label
from piegraph_cli.environments.params import EnvironmentName, Environments, Tasks
from piegraph_cli.params import Counts, Params, Thresholds
from piegraph_cli.planning.params import LOOK, Looks, TrialLabels

MEASURED = "measured"
"""In place of an environment: strokes that others measured."""


class ExperimentTrials(Params):
    """The planning of an experiment."""

    models: TrialLabels = Field(description="models that plan, by name")
    goals: int = Field(ge=1, description="goals per environment")
    seeds: int = Field(ge=1, description="starts per goal")
    strokes: int = Field(ge=1, description="most strokes in one trial")
    thresholds: Thresholds = Field((0.02, 0.03, 0.05, 0.1), description="distances that count as success [m]")
    plan: dict[str, Any] = Field({}, description="settings of `plan` in place of the recipes'")
    fixed_goals: bool = Field(False, description="as `trials.fixed_goals`")
    look: Looks = Field("particles", description=LOOK)
    tasks: dict[EnvironmentName, Tasks] = Field(
        {}, description="rows of an environment, as `trials.envs`: by default one"
    )


class ExperimentParams(Params):
    """An experiment: runs of the shipped recipes of some environments, and the table that they end in."""

    title: str = Field(description="what it shows")
    table: Literal["dynamics", "guidance", "interactions", "search"] = Field(description="the table it ends in")
    interactions: dict[
        EnvironmentName | Literal["measured"], Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)]
    ] = Field(description="training sequences, by environment; 0 is for what begins with a prior", min_length=1)
    models: Labels = Field(description="models to compare, by name")
    also: dict[EnvironmentName, Labels] = Field({}, description="further models in some environments")
    data: Path | None = Field(None, description="file or folder of strokes that others measured, for `import`")
    variants: dict[str, dict[str, Any]] = Field({}, description="as `train.variants`")
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] = Field(
        (0, 1, 2), description="seeds of training"
    )
    training: int = Field(100, ge=1, description="simulated sequences that training ones are chosen from")
    validation: int = Field(10, ge=0, description="sequences that the best weights are chosen on")
    test: int = Field(100, ge=1, description="held-out sequences")
    simulation: int = Field(0, ge=0, description="seed of the simulation; runs of another than 0 lie apart")
    strokes: int = Field(4, ge=1, description="strokes per sequence")
    horizons: Counts = Field((1, 2, 4), description="strokes predicted in a row")
    recordings: bool = Field(
        False, description="render recordings and see them through the pipeline, or true particles"
    )
    steps: float = Field(1.0, gt=0, description="share of the recipes' training steps")
    trials: ExperimentTrials | None = Field(None, description="planning with the trained models")
    paper: dict[str, dict[str, tuple[float, ...]]] = Field(
        {}, description="the paper's figures, by environment and row"
    )

    @model_validator(mode="after")
    def _check_counts(self) -> "ExperimentParams":
        most = max(n for counts in self.interactions.values() for n in counts)
        if most > self.training:
            raise ValueError(f"{most} interactions cannot be chosen of {self.training} training sequences")
        if self.simulation and (self.trials or self.recordings):
            raise ValueError("trials and recordings are of simulation 0")
        return self

    def run_name(self, environment: str) -> str:
        """The folder of an environment's run, which experiments of the same sequences share."""
        apart = "-recorded" if self.recordings else f"-seed{self.simulation}" if self.simulation else ""
        return environment + apart

    def labels(self, environment: str) -> list[str]:
        """The models to compare in an environment, each with its number of training sequences."""
        counts = self.interactions[environment]  # type: ignore[index]
        models = (*self.models, *self.also.get(environment, ()))  # type: ignore[call-overload]
        return [
            _on(model, n) for n in counts for model in models if trained_label(model) and (n or self._knows(model))
        ] + [model for model in models if not trained_label(model)]

    def _knows(self, model: str) -> bool:
        """Whether a model predicts before it has seen a stroke: it begins with a prior."""
        name, variant, _ = split_label(trained_label(model) or model)
        return bool((BUILT_IN | self.variants).get(f"{name}:{variant}", {}).get("prior"))

    def tasks(self, environment: str) -> tuple[str, ...]:
        """The rows of an environment's trials: itself, where it has no others."""
        assert self.trials is not None
        return self.trials.tasks.get(environment, (environment,))  # type: ignore[call-overload]

    def trial_labels(self, environment: str) -> list[str]:
        """The models that plan in an environment."""
        assert self.trials is not None
        counts = self.interactions[environment]  # type: ignore[index]
        return list(dict.fromkeys(_on(model, n) for n in counts for model in self.trials.models))


class TroublesParams(Params):
    """The experiment `troubles`: recordings that are wrong on purpose, and good ones."""

    environments: Environments = Field(
        ("tblock", "toy", "rope-bendy", "tshirt"), description="objects of the recordings that are wrong"
    )
    good: Environments = Field(
        ("tblock", "toy", "rope-bendy", "tshirt", "rope-stiff", "cloth"), description="objects of the good ones"
    )
    noises: tuple[float, ...] = Field((0.3, 1.0, 2.5), description="noise of the good ones, times a D455's")
    recordings: tuple[Path, ...] = Field((), description="further good recordings")
    strokes: int = Field(2, ge=1, description="strokes per sequence")
    seed: int = Field(11, ge=0, description="seed of the simulation")


QUICK_TROUBLES: dict[str, Any] = {"environments": ["tblock"], "good": ["tblock"], "noises": [1.0], "strokes": 1}


def _on(model: str, count: int) -> str:
    return f"{model}@{count}" if trained_label(model) else model
