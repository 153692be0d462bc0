"""The viewer: what is open, where the time line stands, and one thread on which everything is drawn.

Callbacks of the browser only `post` work; so layers and panels need no locks, and a slow one never blocks the connection.
"""

import logging
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np

from piegraph_cli.errors import PiegraphError
from piegraph_cli.viewer.arrays import view_on
from piegraph_cli.viewer.layer import Layer
from piegraph_cli.viewer.pictures import Pictures
from piegraph_cli.viewer.server import Server
from piegraph_cli.viewer.source import OpenRun, Sequence

LOOK_AGAIN = 2.0
"""Seconds after which files are looked at for changes."""

log = logging.getLogger("piegraph")

Act = Callable[[], None]
Kind = TypeVar("Kind", bound=Layer)
Found = TypeVar("Found")


class Viewer:
    """Runs, the open sequence and frame, and the layers; `start` begins to draw.

    `on_sequence` and `on_frame` register what is called, on the viewer's thread, after a sequence was opened and a frame drawn.
    """

    def __init__(self, server: Server, runs: list[OpenRun], layers: list[type[Layer]]):
        self.server, self.runs = server, runs
        self.opened = runs[0]
        self.sequence = Sequence(self.opened, "")
        self.pictures = Pictures(self.sequence)
        self.frame = 0
        self.layers = [layer(self) for layer in layers]
        self.on: set[Layer] = {layer for layer in self.layers if layer.shown}
        self.drawn: set[Layer] = set()
        self._alone: Layer | None = None
        self._framed: Path | None = None
        self._on_sequence: list[Act] = []
        self._on_frame: list[Act] = []
        self._on_tick: list[Act] = []
        self._work: queue.Queue[Act] = queue.Queue()
        self._wanted: int | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="viewer", daemon=True)
        self._behind = ThreadPoolExecutor(1, "viewer-behind")
        self._looked = time.monotonic()

    def on_sequence(self, act: Act) -> None:
        """Call `act` after another sequence was opened, or the same one anew."""
        self._on_sequence.append(act)

    def on_frame(self, act: Act) -> None:
        """Call `act` after another frame was drawn."""
        self._on_frame.append(act)

    def on_tick(self, act: Act) -> None:
        """Call `act` many times a second, between other work."""
        self._on_tick.append(act)

    def layer(self, kind: type[Kind]) -> Kind:
        """The layer of a class."""
        return next(layer for layer in self.layers if isinstance(layer, kind))

    def post(self, act: Act) -> None:
        """Do something on the viewer's thread, after what was posted before. From any thread."""
        self._work.put(act)

    def behind(self, work: Callable[[], Found], then: Callable[[Found], None]) -> None:
        """Do what takes long on another thread; `then` gets the result on the viewer's, if the sequence is still open."""
        of = self.sequence

        def finish(found: Found) -> None:
            if self.sequence is of:
                then(found)

        def do() -> None:
            if self.sequence is of and not self._ended.is_set():
                found = work()
                self.post(lambda: finish(found))

        self._behind.submit(self._guarded, do)

    def show(self, frame: int) -> None:
        """Draw a frame soon; of several that are asked for meanwhile the last. From any thread."""
        self._wanted = frame
        self._work.put(self._show_wanted)

    def open(self, opened: OpenRun, name: str, frame: int = 0) -> None:
        """Open a sequence and draw a frame of it. On the viewer's thread."""
        self.sequence.close()
        for layer in list(self.drawn):
            self._clear(layer)
        self.opened, self.sequence = opened, Sequence(opened, name)
        self.pictures = Pictures(self.sequence)
        self.frame = min(frame, max(0, len(self.sequence) - 1))
        self._frame_object()
        for layer in self.layers:
            self._open_layer(layer)
        for act in self._on_sequence:
            self._guarded(act)
        self._draw()

    def open_again(self) -> None:
        """Read the open sequence anew, at the same frame."""
        fresh = OpenRun.of(self.opened.folder)
        self.runs[self.runs.index(self.opened)] = fresh
        self.open(fresh, self.sequence.name, self.frame)

    def switch(self, layer: Layer, on: bool) -> None:
        """Switch a layer on or off. On the viewer's thread."""
        (self.on.add if on else self.on.discard)(layer)
        self._settle()

    def draw_again(self, layer: Layer) -> None:
        """Draw a layer anew, if it is drawn: it was told something. On the viewer's thread."""
        if layer in self.drawn:
            self._draw_layer(layer)

    def leave_alone(self, layer: Layer | None) -> None:
        """Show one layer alone and hide the others; all that are on for None. On the viewer's thread."""
        self._alone = layer
        self._settle()

    def look_at(self, points: np.ndarray) -> None:
        """Turn every browser, and those to come, to points [P, 3] (m)."""
        position, middle = view_on(points)
        self.server.initial_camera.position, self.server.initial_camera.look_at = position, middle
        for client in self.server.get_clients().values():
            with client.atomic():
                client.camera.position, client.camera.look_at = position, middle

    def look_at_object(self) -> None:
        """Turn every browser to where the object goes in this sequence."""
        self.look_at(self._places())

    def look_at_all(self) -> None:
        """Turn every browser to the object and the cameras around it."""
        cameras = [camera.T_world_camera[:3, 3] for camera in self.sequence.cameras]
        self.look_at(np.concatenate([self._places(), np.reshape(cameras, (-1, 3))]))

    def tell(self, title: str, text: str, color: str = "blue") -> None:
        """Show a notification in every browser. From any thread."""
        for client in self.server.get_clients().values():
            client.add_notification(title, text, color=color, auto_close_seconds=8.0)

    def start(self) -> None:
        """Begin to work."""
        self._thread.start()

    def close(self) -> None:
        """End the threads and close the files."""
        self._ended.set()
        self._work.put(lambda: None)
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)
        self._behind.shutdown(wait=False, cancel_futures=True)
        self.sequence.close()

    def _loop(self) -> None:
        while not self._ended.is_set():
            try:
                self._guarded(self._work.get(timeout=0.01))
            except queue.Empty:
                for act in self._on_tick:
                    self._guarded(act)
                self._look_again()

    def _look_again(self) -> None:
        if time.monotonic() - self._looked > LOOK_AGAIN:
            self._looked = time.monotonic()
            if self.sequence.changed():
                self._guarded(self.open_again)

    def _show_wanted(self) -> None:
        wanted, self._wanted = self._wanted, None
        if wanted is not None:
            self.draw_frame(wanted)

    def draw_frame(self, frame: int) -> None:
        """Draw a frame now. On the viewer's thread."""
        if len(self.sequence):
            self.frame = max(0, min(frame, len(self.sequence) - 1))
            self._draw()

    def _draw(self) -> None:
        if len(self.sequence):
            with self.server.atomic():
                for layer in self.layers:
                    if layer in self.drawn:
                        self._draw_layer(layer)
        for act in self._on_frame:
            self._guarded(act)

    def _draw_layer(self, layer: Layer) -> None:
        self._guarded(lambda: layer.draw(self.frame))

    def _settle(self) -> None:
        """Draw the layers that are on and not hidden, clear the others."""
        for layer in self.layers:
            if layer in self.drawn and not self._wants(layer):
                self._clear(layer)
            elif layer not in self.drawn and self._open_layer(layer):
                self._draw_layer(layer)

    def _wants(self, layer: Layer) -> bool:
        return layer in self.on and self._alone in (None, layer) and len(self.sequence) > 0 and not layer.missing()

    def _open_layer(self, layer: Layer) -> bool:
        if not self._wants(layer):
            return False
        self.drawn.add(layer)
        self.server.scene.add_frame(layer.root, show_axes=False)
        self._guarded(layer.open)
        return True

    def _clear(self, layer: Layer) -> None:
        self.drawn.discard(layer)
        layer.clear()

    def _frame_object(self) -> None:
        """Turn the browsers to the object where another run was opened; in the same run people keep their view."""
        if len(self.sequence) and self._framed != self.opened.folder:
            known = self.sequence.missing("tracks") == "" or self.sequence.missing("clouds") == ""
            self._guarded(self.look_at_object if known else self.look_at_all)
            self._framed = self.opened.folder

    def _places(self) -> np.ndarray:
        """Points [P, 3] (m) of the object in a few frames of the sequence."""
        tracks, clouds = self.sequence.get("tracks"), self.sequence.get("clouds")
        if tracks is not None:
            frames = np.linspace(0, len(tracks) - 1, 6).astype(int)
            return np.concatenate([tracks.row("positions", int(frame)) for frame in frames])
        if clouds is not None:
            first, end = map(int, clouds["offsets"][:2])
            return clouds.rows("points", first, end)
        return np.zeros((0, 3))

    def _guarded(self, act: Act) -> None:
        """Do something; what is wrong with the data is told in the browser, and the viewer goes on."""
        try:
            act()
        except PiegraphError as error:
            self.tell(error.message, f"{error.where}\n{error.hint}", "orange")
        except Exception as error:
            if self._ended.is_set():  # files are closed under work that goes on
                return
            log.exception("the viewer goes on after an error")
            self.tell("An error in piegraph", f"{type(error).__name__}: {error}", "red")
