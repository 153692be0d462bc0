"""What `reproduce` tells programs with `--json`, as models; docs/json.md is made from them."""

from typing import Literal

from pydantic import Field, RootModel

from piegraph_cli.stages.results import Delta, Error, Errors, Interval, Number, Result, Trials


class Predictions(Errors):
    """Errors of a model's predictions in one environment."""

    environment: str


class Guidance(Result):
    """How much worse a network is without guidance, paired by seed and sequence."""

    environment: str
    model: str
    horizon: int
    pd: Interval
    """[cm]."""
    cd_s: Interval = Field(alias="cd+s")


class Against(Result):
    """How much further than piegraph a model is from the truth at the longest horizon."""

    environment: str
    model: str
    horizon: int
    pd: Interval
    """[cm]."""
    verdict: Literal["better", "level", "worse", ""]
    """What piegraph is, by the interval; empty where there is none."""


class Loss(Result):
    """How much the particle distance grows with fewer training sequences."""

    environment: str
    model: str
    horizon: int
    sequences: int
    of: int
    """The most sequences."""
    loss: Number
    """0.1: 10 % more."""


class Paper(Result):
    """CD + S without guidance and with it."""

    environment: str
    horizon: int
    ours: tuple[float, float]
    paper: tuple[float, float]


class Searched(Result):
    """The lowest validation loss of a variant of a model."""

    environment: str
    model: str
    loss: Number
    best: bool


class Budget(Result):
    """What a model was given in one environment, means over seeds."""

    environment: str
    model: str
    candidates: int | None
    """Of the search; `null` where it was not done."""
    steps: float
    parameters: int
    minutes: Number
    """Of the processor, for one training."""
    candidates_per_plan: int | None
    """At most."""
    trial_minutes: Number
    """Of the processor, for all its trials."""


class Empty(Result):
    """A row that is left empty."""

    environment: str
    model: str
    reason: str
    tried: bool
    """Whether it was done, and failed or did not learn."""
    trials: bool
    """Whether trials lack, not predictions."""


class Experiment(Result):
    """The tables of an experiment; those that it has not are left out."""

    title: str
    seeds: list[int]
    search: list[Searched] | None = None
    predictions: list[Predictions] | None = None
    guidance: list[Guidance] | None = None
    against: list[Against] | None = None
    loss: list[Loss] | None = None
    paper: list[Paper] | None = None
    trials: list[Trials] | None = None
    cliffs_delta: list[Delta] | None = None
    budget: list[Budget]
    empty: list[Empty]
    left: int
    """Pieces that were not begun since `--hours` were over."""
    pictures: list[str]
    failed: list[Error]


class Trouble(Result):
    """What was said of recordings that are wrong in one way."""

    trouble: str
    strength: str
    bad: int
    doubtful: int
    good: int
    right: int
    """Those whose cause was named; of good ones, those that nothing was said of."""
    recordings: int


class Troubles(Result):
    """What was said of recordings that are wrong on purpose, and of good ones."""

    rows: list[Trouble]
    wrong: int
    missed: int
    """Of the wrong ones."""
    false_alarms: int


class Reproduced(RootModel[dict[str, Experiment | Troubles]]):
    """The tables of each experiment, by its name; of `troubles` what was said of the recordings."""
