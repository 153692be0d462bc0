"""piegraph: learn how an object moves from RGB-D recordings of a person handling it, and plan with what was learned.

From Python: open a run, read its artifacts, load a model, predict, plan, track clouds (docs/python.md). Each name is
imported when it is first used, so that the command line answers at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from piegraph_cli.dynamics.stroke import Strokes as Strokes
    from piegraph_cli.planning.episode import Episode as Episode
    from piegraph_cli.planning.model import Model as Model
    from piegraph_cli.stages import open_run as open_run
    from piegraph_cli.stages import sequences as sequences
    from piegraph_cli.stages.models import load_model as load_model
    from piegraph_cli.stages.models import save_model as save_model
    from piegraph_cli.stages.points import read_points as read_points
    from piegraph_cli.stages.track import track_clouds as track_clouds
    from piegraph_cli.workspace.artifact import Artifact as Artifact
    from piegraph_cli.workspace.artifact import read_artifact as read_artifact
    from piegraph_cli.workspace.run import Run as Run

__version__ = "0.1.0"

_FACE = {
    "Artifact": "workspace.artifact",
    "Episode": "planning.episode",
    "Model": "planning.model",
    "Run": "workspace.run",
    "Strokes": "dynamics.stroke",
    "load_model": "stages.models",
    "open_run": "stages",
    "read_artifact": "workspace.artifact",
    "read_points": "stages.points",
    "save_model": "stages.models",
    "sequences": "stages",
    "track_clouds": "stages.track",
}
__all__ = sorted([*_FACE, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _FACE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_FACE[name]}"), name)
