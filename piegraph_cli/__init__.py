"""piegraph: learn how an object moves from RGB-D recordings of a person handling it, and plan with what was learned.

From Python: open a run, read its artifacts, load a model, predict, look, plan, track clouds (docs/python.md). Each name is
imported when it is first used, so that the command line answers at once.

Nothing is imported here, not even of Python's own: until the program takes signals, Ctrl-C is a traceback of Python's.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from piegraph_cli.capture.live import open_cameras as open_cameras
    from piegraph_cli.dynamics.stroke import Strokes as Strokes
    from piegraph_cli.perception.look import Look as Look
    from piegraph_cli.perception.look import look as look
    from piegraph_cli.planning.episode import Episode as Episode
    from piegraph_cli.planning.model import Model as Model
    from piegraph_cli.planning.question import Answer as Answer
    from piegraph_cli.recording.camera import Camera as Camera
    from piegraph_cli.recording.film import Scene as Scene
    from piegraph_cli.recording.layout import read_cameras as read_cameras
    from piegraph_cli.recording.points import write_points as write_points
    from piegraph_cli.stages import open_run as open_run
    from piegraph_cli.stages import sequences as sequences
    from piegraph_cli.stages.look import look_settings as look_settings
    from piegraph_cli.stages.look import read_scene as read_scene
    from piegraph_cli.stages.models import load_model as load_model
    from piegraph_cli.stages.models import save_model as save_model
    from piegraph_cli.stages.points import read_points as read_points
    from piegraph_cli.stages.track import track_clouds as track_clouds
    from piegraph_cli.workspace.artifact import Artifact as Artifact
    from piegraph_cli.workspace.artifact import read_artifact as read_artifact
    from piegraph_cli.workspace.run import Run as Run

__version__ = "0.1.0"

_FACE = {
    "Answer": "planning.question",
    "Artifact": "workspace.artifact",
    "Camera": "recording.camera",
    "Episode": "planning.episode",
    "Look": "perception.look",
    "Model": "planning.model",
    "Run": "workspace.run",
    "Scene": "recording.film",
    "Strokes": "dynamics.stroke",
    "load_model": "stages.models",
    "look": "perception.look",
    "look_settings": "stages.look",
    "open_cameras": "capture.live",
    "open_run": "stages",
    "read_artifact": "workspace.artifact",
    "read_cameras": "recording.layout",
    "read_points": "stages.points",
    "read_scene": "stages.look",
    "save_model": "stages.models",
    "sequences": "stages",
    "track_clouds": "stages.track",
    "write_points": "recording.points",
}
__all__ = sorted([*_FACE, "__version__"])


def __getattr__(name: str) -> object:
    from importlib import import_module

    if name not in _FACE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_FACE[name]}"), name)
