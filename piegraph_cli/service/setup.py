"""Setting a service up: the model of a run or of a file, the images it may look at, where the robot stands."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from piegraph_cli.capture.live import open_cameras
from piegraph_cli.errors import PiegraphError, UsageError
from piegraph_cli.planning.model import Model
from piegraph_cli.process import choose_device
from piegraph_cli.recording.film import Scene
from piegraph_cli.recording.folders import list_sequences
from piegraph_cli.recording.robot_files import read_robot
from piegraph_cli.service.service import Eye, Origin, Service
from piegraph_cli.stages import open_run
from piegraph_cli.stages.look import look_settings, read_scene
from piegraph_cli.stages.models import find_model
from piegraph_cli.stages.plan import cameras_file


@contextlib.contextmanager
def opened_service(
    run: Path | None, model: str | None, recording: Path | None = None, live: bool = False, device: str = "auto"
) -> Iterator[Service]:
    """A warm service of a run's model, by label, or of the model file of that name; cameras run as long as the context.

    Raises `DataError` and `UsageError` for what cannot be served.
    """
    found, artifact = find_model(Path(str(model)) if run is None else run, None if run is None else model)
    found = replace(found, device=choose_device(device))
    origin = Origin(artifact.path.absolute(), artifact.key) if artifact else Origin()
    with contextlib.ExitStack() as stack:
        eye = None
        if recording is not None:
            settings = look_settings(run)
            if live:
                cameras = stack.enter_context(open_cameras(recording))
                eye = Eye(settings, lambda source: _now(cameras.scene, source), f"the cameras of {recording}")
            else:
                list_sequences(recording)  # refused at once where it is none
                eye = Eye(settings, lambda source: _recorded(recording, source), str(recording))
        warm_up(found)
        yield Service(found, origin, _robot(run, found, recording), eye)


def warm_up(model: Model) -> None:
    """Have kernels compiled and loaded, and memory taken, before the first request: by a plan for a made-up block."""
    block = np.random.default_rng(0).uniform([-0.12, -0.08, 0], [0.12, 0.08, 0.03], (2000, 3))
    with contextlib.suppress(PiegraphError):  # a model may refuse what it was not trained on: it is loaded all the same
        model.plan(block, goal_pose=(0.05, 0.0, 0.0), samples=8, cem_iterations=2, horizon=1)


def _now(scene: Callable[[], Scene], source: str | None) -> Scene:
    if source is not None:
        raise UsageError("this service looks through cameras", "look.source", "leave it out")
    return scene()


def _recorded(recording: Path, source: str | None) -> Scene:
    name = (source or "").partition(":")[0]
    if name not in (path.name for path in list_sequences(recording)):
        known = ", ".join(path.name for path in list_sequences(recording)[:5])
        raise UsageError(f"no sequence {name!r}", "look.source", f"SEQUENCE:FRAME, as in {known}")
    return read_scene(f"{recording}/{source}")


def _robot(run: Path | None, model: Model, recording: Path | None) -> Callable[[], np.ndarray]:
    """Reads `T_world_robot`, which may be calibrated anew while the service runs."""
    if recording is not None:
        return lambda: read_robot(recording / "cameras.json")
    if run is not None:
        opened = open_run(run)
        return lambda: read_robot(cameras_file(opened, model.settings))

    def unknown() -> np.ndarray:
        hint = "start the service with --recording RECORDING"
        raise UsageError("where the robot stands is not known", "plan.settings.frame", hint)

    return unknown
