"""The command `view`: clouds, particles and the hand's path of one sequence in the browser (extra `view`)."""

import time
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError, MissingError, UsageError, command_line
from piegraph_cli.evaluation.figures import particle_colors
from piegraph_cli.stages import open_run, sequences
from piegraph_cli.workspace.artifact import Artifact, read_artifact


def serve(folder: Path, sequence: str | None, port: int) -> None:
    """Serve until interrupted. Raises `MissingError` without viser, `DataError` when the sequence has nothing to show."""
    try:
        import viser
    except ImportError:
        raise MissingError("viser is not installed", hint="pip install 'piegraph[view]'") from None
    run = open_run(folder)
    names = sequences(run)
    name = sequence or names[0]
    if name not in names:
        raise UsageError(f"no sequence {name}", str(folder), f"one of {', '.join(names)}")
    shown = [read_artifact(p, a) for a in ("clouds", "tracks") if (p := run.path(a, name)).exists()]
    if not shown:
        raise DataError(
            "no clouds or tracks to show", str(folder), command_line("run", "--run", folder, "--until", "track")
        )
    server = viser.ViserServer(host="127.0.0.1", port=port)
    server.scene.set_up_direction("+z")
    server.scene.add_grid("/table", width=1.0, height=1.0, cell_size=0.1)
    slider = server.gui.add_slider("frame", min=0, max=len(shown[0]["time"]) - 1, step=1, initial_value=0)
    server.gui.add_markdown(f"{folder} / {name}")

    def draw(_: object = None) -> None:
        for artifact in shown:
            _draw(server, artifact, int(slider.value))

    slider.on_update(draw)
    draw()
    print(f"http://127.0.0.1:{port}  (Ctrl-C ends it)", flush=True)
    while True:
        time.sleep(1.0)


def _draw(server, artifact: Artifact, frame: int) -> None:
    if artifact.name == "clouds":
        low, high = artifact["offsets"][frame : frame + 2]
        points = artifact["points"][low:high]
        server.scene.add_point_cloud("/cloud", points, np.full((len(points), 3), 0.6), point_size=0.002)
    else:
        colors = particle_colors(artifact["positions"][0])
        server.scene.add_point_cloud("/particles", artifact["positions"][frame], colors, point_size=0.006)
    hand = artifact["end_effector"][: frame + 1]
    hand = hand[np.isfinite(hand).all(-1)]
    server.scene.add_point_cloud("/hand", hand, np.tile([0.9, 0.1, 0.1], (len(hand), 1)), point_size=0.004)
