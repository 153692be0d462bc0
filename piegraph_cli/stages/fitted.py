"""What `train` keeps of every model, and what it makes of a rigid body, whose numbers are fitted at once."""

import math
from typing import Any

import numpy as np

from piegraph_cli.dynamics.doubts import at_bounds, little_told, unexplained
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.outline import OUTLINE
from piegraph_cli.dynamics.rigid_body import RigidBody
from piegraph_cli.errors import DataError
from piegraph_cli.params import PUSH
from piegraph_cli.physics.particles import Sizes
from piegraph_cli.recording.outline import read_outline
from piegraph_cli.workspace.stage import Output

BENT = 0.005
"""Metres from a rigid motion above which the user of `rigid` is warned."""
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
    arrays = {f"weights/{name}": value.numpy() for name, value in body.state_dict().items()} | about(data)
    arrays |= {"step": np.array([1]), "train_loss": np.array([error]), "validation_loss": np.array([math.nan])}
    arrays |= {"static_loss": np.array(static, np.float64)}
    quality = f"{error * 100:.2f} cm a stroke on {len(data.strokes)} strokes; friction {friction:.2f}, "
    of = "outermost particles" if file is None else "outline"
    quality += f"turning length {c * 1000:.0f} mm, pusher {reach * 1000:.1f} mm from the {of}"
    warnings = []
    if bent > BENT:
        warnings.append(
            f"particles end {bent * 1000:.0f} mm from a rigid motion: this bends, `rigid` is for what does not"
        )
    if body.params.fit:
        wrong = unexplained(error, float(static), "pushing", "block")
        hint = "look at the hand and the strokes with `piegraph report`; or train another model"
        warnings += [f"{wrong}; {hint}"] if wrong else at_bounds(body.ended, "block")
        warnings += little_told(data)
    return Output(arrays, quality, warnings)
