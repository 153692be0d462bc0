"""What `train` keeps of every model, and what it makes of those whose numbers are fitted at once: rigid bodies, springs."""

import math
from typing import Any

import numpy as np
from torch import nn

from piegraph_cli.dynamics.doubts import at_bounds, little_told, unexplained
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.outline import OUTLINE
from piegraph_cli.dynamics.rigid_body import RigidBody
from piegraph_cli.dynamics.spring_fit import SMS
from piegraph_cli.errors import DataError
from piegraph_cli.params import PUSH
from piegraph_cli.physics.particles import Sizes
from piegraph_cli.recording.outline import read_outline
from piegraph_cli.workspace.stage import Output

BENT = 0.005
"""Metres from a rigid motion above which the user of `rigid` is warned."""
HINT = "look at the hand and the strokes with `piegraph report`; or train another model"
"""Where a law leaves most of the motion."""
STATES = 400
"""States of the object that tell how large it is, at most."""


def about(data: Sequences) -> dict[str, Any]:
    """What every model keeps of the object and the strokes that it has learned from."""
    return {
        "particles": np.array(data.positions.shape[1]),
        "modes": np.unique(data.mode) if len(data.mode) else np.array([PUSH]),
        "pace": np.array(data.pace if len(data.strokes) else 0.0),
        "rest": data.rest[0],
        "size": Sizes.of(data.at_rest(STATES) if len(data.strokes) else list(data.rest)).array(),
    }


def _arrays(network: nn.Module, data: Sequences, error: float, static: float) -> dict[str, Any]:
    """What is kept of a fit that leaves an error (m) where nothing moving leaves `static` (m)."""
    weights = {f"weights/{name}": value.numpy() for name, value in network.state_dict().items()}
    losses = {"step": np.array([1]), "train_loss": np.array([error]), "validation_loss": np.array([math.nan])}
    return weights | about(data) | losses | {"static_loss": np.array(static)}


def fit_springs(springs: SMS, data: Sequences) -> Output:
    """The numbers of springs; told where strokes say little of them, and where no springs explain the strokes."""
    fit = springs.fit(data)
    _, _, friction, reach, *_ = fit.numbers
    quality = f"{fit.error * 100:.2f} cm a stroke on {len(data.strokes)} strokes; "
    quality += f"springs over {fit.span:.0%} of the object" + (" that only pull" if fit.tension_only else "")
    quality += f", friction {friction:.1e} m"
    if PUSH in data.mode:
        quality += f", pusher {reach * 1000:.1f} mm from the particles' contour"
    wrong = unexplained(fit.error, fit.motion, "springs", "object that was pushed or carried")
    warnings = [f"{wrong}; {HINT}"] if wrong else at_bounds(fit.ended, "object")
    return Output(_arrays(springs, data, fit.error, fit.motion), quality, warnings + little_told(data))


def fit_body(body: RigidBody, data: Sequences) -> Output:
    """The numbers of a rigid body; a body that bends is told, and strokes that tell little of it."""
    file = body.params.outline
    try:
        error, bent = body.fit(data, None if file is None else read_outline(file))
    except DataError as fault:
        if fault.where != OUTLINE:
            raise
        raise DataError(fault.message, str(file), fault.hint) from None
    friction, c, reach, *_ = body.numbers.tolist()
    first, last = data.strokes.T
    static = np.linalg.norm(data.positions[last] - data.positions[first], axis=-1).mean()
    arrays = _arrays(body, data, error, float(static))
    quality = f"{error * 100:.2f} cm a stroke on {len(data.strokes)} strokes; friction {friction:.2f}, "
    of = "outermost particles" if file is None else "outline"
    quality += f"turning length {c * 1000:.0f} mm, pusher {reach * 1000:.1f} mm from the {of}"
    warnings = []
    if bent > BENT:
        warnings.append(
            f"particles end {bent * 1000:.0f} mm from a rigid motion: this bends, `rigid` is for what does not"
        )
    if body.params.fit:
        wrong = unexplained(error, float(static), "pushing", "block that was pushed")
        warnings += [f"{wrong}; {HINT}"] if wrong else at_bounds(body.ended, "block")
        warnings += little_told(data)
    return Output(arrays, quality, warnings)
