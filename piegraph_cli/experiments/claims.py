"""The paper's claims, each as what is compared with what, and the verdict on every object: by intervals, in one place."""

from dataclasses import dataclass

import numpy as np

from piegraph_cli.evaluation.statistics import verdict
from piegraph_cli.evaluation.tables import Metrics, difference
from piegraph_cli.evaluation.trials import Trial, compare_trials
from piegraph_cli.experiments.params import ExperimentParams
from piegraph_cli.experiments.results import Results
from piegraph_cli.experiments.tables import plain_metrics, plain_trials

FINAL = "final PD"


@dataclass(frozen=True)
class Claim:
    """That one model is better than others, in an experiment."""

    name: str
    text: str
    experiment: str
    rivals: tuple[str, ...]
    ours: str = "piegraph"
    metrics: tuple[str, ...] = ("pd",)
    """Of predictions over the most strokes, or the final distance of trials."""


CLAIMS = (
    Claim("pgnd", "predictions are nearer than PGND's", "dynamics", ("pgnd",)),
    Claim("gbnd", "nearer than graph dynamics with a tool node", "dynamics", ("gbnd",)),
    Claim("springs", "nearer than springs alone, as given and fitted", "dynamics", ("sms-no", "sms-o")),
    Claim("egnn-g", "canonical actions are better than the stroke as two nodes (EGNN+G)", "dynamics", ("egnn-g",)),
    Claim("gnn", "equivariance learns from little data", "dynamics", ("gnn", "gnn-aug")),
    Claim(
        "guidance",
        "guidance makes predictions better over long horizons",
        "dynamics",
        ("piegraph-ng",),
        metrics=("pd", "cd+s"),
    ),
    Claim("guided-planning", "guidance makes planning better", "planning", ("piegraph-ng",), metrics=(FINAL,)),
    Claim("recordings", "it learns from recordings, not true particles alone", "recordings", ("static",)),
    Claim("planning-pgnd", "planning beats PGND's", "planning", ("pgnd",), metrics=(FINAL,)),
    Claim(
        "planning-ablations",
        "planning beats the ablations'",
        "ablations",
        ("piegraph-ng", "egnn-g", "sms-no", "sms-o"),
        metrics=(FINAL,),
    ),
    Claim("few", "few interactions suffice: 20 are as good as 100", "data-fidelity", ("piegraph@100",), "piegraph@20"),
    Claim("table1", "Table 1: guidance keeps long predictions near", "table1", ("piegraph-ng",), metrics=("cd+s",)),
)


@dataclass(frozen=True)
class Finding:
    """What was found of a claim on one object against one rival."""

    environment: str
    rival: str
    metric: str
    gain: tuple[float, float, float] | None
    """How much better ours is (mean, low, high): less error, or Cliff's delta; None where one of the two is not there."""

    @property
    def verdict(self) -> str:
        """`better`, `level` or `worse`; empty where nothing was measured."""
        return verdict(self.gain) if self.gain else ""


def findings(claim: Claim, params: ExperimentParams, results: Results) -> list[Finding]:
    """The verdicts on a claim, by object, rival and metric."""
    metrics, trials = plain_metrics(params, results), plain_trials(params, results.trials)
    found = []
    for environment in params.interactions:
        for rival in claim.rivals:
            for metric in claim.metrics:
                if metric == FINAL:
                    gain = _trial_gain(trials, environment, claim.ours, rival)
                else:
                    gain = _gain(metrics.get(environment, {}), claim.ours, rival, metric)
                found.append(Finding(environment, rival, metric, gain))
    return found


def _gain(metrics: Metrics, ours: str, rival: str, metric: str) -> tuple[float, float, float] | None:
    """How much larger the rival's error is over the most strokes, paired by seed and sequence."""
    if not {ours, rival} <= metrics.keys():
        return None
    return difference(metrics, ours, rival, metric, int(np.max(metrics[ours][0]["horizon"])))


def _trial_gain(trials: list[Trial], environment: str, ours: str, rival: str) -> tuple[float, float, float] | None:
    """Cliff's delta of the final distance over the tasks that both have."""
    of_both = {
        model: [t for t in trials if (t.environment, t.model) == (environment, model)] for model in (ours, rival)
    }
    rows = compare_trials([*of_both[ours], *of_both[rival]], [])
    return rows[0].get("pd") if rows else None
