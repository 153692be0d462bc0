"""What `train` says of models that suit a recording of few strokes better than piegraph as it was trained."""

import numpy as np

from piegraph_cli.dynamics.choosing import BODY, STATIC, WITH, WITHOUT, Compared, comparable, compared
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.params import PRIOR, SHIPPED_PRIORS, EGNNParams
from piegraph_cli.stages.prior import adopted, read_prior
from piegraph_cli.workspace.stage import Context

COMMANDS = {
    WITH: "piegraph train --from prior",
    WITHOUT: "piegraph train without --from",
    BODY: "piegraph train --model rigid-gp",
}


def advice(data: Sequences, settings: EGNNParams, seed: int, context: Context) -> str:
    """Errors of models on strokes that were left out in turn, and which is better; empty where nothing is compared."""
    family = comparable(data)
    if family is None:
        return ""
    own = settings.prior not in (None, PRIOR)
    prior, _ = read_prior(settings.files()["prior"] if own else SHIPPED_PRIORS[family])
    if prior.family != family:
        return ""
    tuned = adopted(EGNNParams(prior=settings.prior or PRIOR))
    assert isinstance(tuned, EGNNParams)
    plain = settings if settings.prior is None else EGNNParams()
    found = compared(data, prior, tuned, plain, seed, lambda jobs: context.progress(jobs, "comparisons"))
    return "" if found is None else told(found, WITHOUT if settings.prior is None else WITH)


def told(found: Compared, trained: str) -> str:
    """The errors in words, and what to train in place of `trained` where that is surely better."""
    figures = ", ".join(f"{label} {float(np.mean(errors)) * 100:.2f}" for label, errors in found.errors.items())
    text = f"; on strokes left out in turn, cm: {figures}"
    if found.best in (trained, STATIC):
        return text
    if found.surely(found.best, trained):
        return f"{text}; better: `{COMMANDS[found.best]}`"
    return f"{text}; no other is surely better"
