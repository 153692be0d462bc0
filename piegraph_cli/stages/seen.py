"""What plans through cameras leave beside the others: how far the object truly was, and why an episode could not go on."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from piegraph_cli.errors import DataError
from piegraph_cli.text import counted
from piegraph_cli.workspace.said import kept_warnings

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.planning.episode import Episode
    from piegraph_cli.workspace.run import Run

BLIND = "the look is bad"
"""Of `planning.mpc.Ending`, which is not imported here: it imports torch."""


def true_distances(episodes: "Sequence[Episode]") -> "dict[str, np.ndarray]":
    """How far the object truly was from its goal after each step (m), where cameras saw it and the goal is known."""
    import numpy as np

    from piegraph_cli.evaluation.metrics import CENTIMETRE, nearest_distance

    if not all(episode.true and episode.copies is not None for episode in episodes):
        return {}
    found = [nearest_distance(state, e.copies) for e in episodes for state in e.true[1:] if e.copies is not None]
    return {"true_distance": np.array(found) / CENTIMETRE}


def refused(run: "Run") -> DataError | None:
    """What makes a run's plan end early: an episode in which the object could not be seen any more."""
    plan = run.read("plan")
    blind = [k for k, ending in enumerate(plan.texts("ending")) if ending == BLIND]
    if not blind:
        return None
    message = f"episode {blind[0]} ended after {counted(int((plan['episode'] == blind[0]).sum()), 'stroke')}: {BLIND}"
    said = [text for text in kept_warnings(run).get(("plan", None), ()) if text.startswith(f"episode {blind[0]}: ")]
    why, _, hint = said[-1].partition("\n  try: ") if said else ("", "", "")
    return DataError(f"{message}: {why.partition(': ')[2]}" if why else message, str(plan.path), hint)
