"""What `reproduce` tells programs with `--json`, as models; docs/json.md is made from them."""

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
