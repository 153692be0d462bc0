"""The command `view`: opens runs, serves them until it is told to end."""

import signal
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from piegraph_cli.errors import MissingError, UsageError

if TYPE_CHECKING:
    from piegraph_cli.viewer.server import Server
    from piegraph_cli.viewer.viewer import Viewer

LEFT_WIDTH = 360
"""Pixels of the images and curves at the left."""


def view(folders: list[Path], sequence: str | None, port: int) -> None:
    """Serve until Ctrl-C or SIGTERM. Raises `MissingError` without viser, `UsageError` for a sequence that there is not."""
    try:
        import viser  # noqa: F401
    except ImportError:
        raise MissingError("viser is not installed", hint="pip install 'piegraph[view]'") from None
    from piegraph_cli.viewer.layers import LAYERS
    from piegraph_cli.viewer.server import address, start_server
    from piegraph_cli.viewer.source import OpenRun
    from piegraph_cli.viewer.viewer import Viewer

    runs = [OpenRun.of(folder) for folder in folders]
    names = runs[0].names
    if sequence is not None and sequence not in names:
        raise UsageError(f"no sequence {sequence}", str(folders[0]), f"one of {', '.join(names)}")
    server = start_server(port)
    viewer = Viewer(server, runs, LAYERS)
    add_panels(viewer)
    viewer.post(lambda: viewer.open(runs[0], sequence or (names[0] if names else "")))
    viewer.start()
    print(f"{address(server)}  (Ctrl-C ends it)", flush=True)
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    try:
        while not ended.wait(1.0):
            pass
    except KeyboardInterrupt:  # it ends as it was told
        pass
    finally:
        viewer.close()
        server.stop()


def add_panels(viewer: "Viewer") -> None:
    """Make the table, the time line and all panels of a viewer that is not yet started."""
    from piegraph_cli.viewer.panels import PANELS
    from piegraph_cli.viewer.timeline import Timeline

    server = viewer.server
    server.scene.add_grid("/table", width=2.0, height=2.0, cell_size=0.1, section_size=0.5, shadow_opacity=0.0)
    viewer.look_at(np.zeros((0, 3)))
    _keep_shader(server)
    Timeline(viewer)
    tabs, left = server.gui.add_tab_group(), server.gui.add_panel()
    server.gui.main_panel.dock_right()
    left.dock_left()
    left.set_width(LEFT_WIDTH)
    with left.add_tab("Recording"):
        for panel in PANELS:
            if panel.left:
                panel(viewer)
    for panel in PANELS:
        if not panel.left:
            with tabs.add_tab(panel.title):
                panel(viewer)


def _keep_shader(server: "Server") -> None:
    """Two points that nobody sees. A cloud whose colours change gets a new material in the browser, and the last cloud in
    colours that is dropped takes the compiled shader along: it would be compiled at each frame, which takes 0.1 s and more.
    """
    below = np.array([[0, 0, -100], [0, 0, -101]], np.float32)
    server.scene.add_point_cloud("/kept", below, np.zeros((2, 3), np.uint8), point_size=1e-6)
