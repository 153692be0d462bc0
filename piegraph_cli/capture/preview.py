"""The live picture in the browser: a small server on 127.0.0.1, a motion JPEG for each camera, and what is going on."""

import json
import threading
import time
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import quote, unquote

from piegraph_cli.capture.cameras import Shot
from piegraph_cli.errors import UsageError

RATE = 10.0
"""Pictures a second."""
WIDTH = 640
"""Widest picture (px)."""
HOSTS = ("127.0.0.1", "localhost")
"""Names under which it answers: a page of elsewhere that points its own name here gets nothing."""

PAGE = """<!doctype html><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>piegraph record</title>
<style>body{{font:16px sans-serif;margin:1em;background:#111;color:#eee}} figure{{display:inline-block;margin:.3em}}
img{{max-width:46vw;min-width:280px}} #state{{font-size:1.6em}}</style>
<p id="state" role="status">…</p>{figures}
<script>setInterval(async () => {{ const s = document.getElementById("state");
try {{ s.textContent = (await (await fetch("/state")).json()).state; }} catch {{ s.textContent = "ended"; }} }}, 300);</script>
"""
FIGURE = '<figure><img src="/{url}.mjpg" alt="picture of camera {name}"><figcaption>{name}</figcaption></figure>'


class Preview:
    """Serves the latest shot of each camera from `start` to `stop`; also as a context."""

    def __init__(self, latest: Mapping[str, Shot], names: list[str], state: Callable[[], str], port: int):
        self.latest, self.names, self.state = latest, names, state
        handler = type("Handler", (_Handler,), {"preview": self})
        try:
            self.server = ThreadingHTTPServer(("127.0.0.1", port), handler)
        except OSError as error:
            raise UsageError(f"port {port} cannot be used: {error.strerror}", "--port", "give another port") from None
        self.server.daemon_threads = True
        self.port: int = self.server.server_address[1]
        self.running = True
        threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True).start()

    @property
    def url(self) -> str:
        """Where it is."""
        return f"http://127.0.0.1:{self.port}/"

    def __enter__(self) -> "Preview":
        return self

    def __exit__(self, *_: object) -> None:
        self.running = False
        self.server.shutdown()
        self.server.server_close()

    def page(self) -> str:
        """The page with all cameras."""
        return PAGE.format(figures="".join(FIGURE.format(url=quote(name), name=name) for name in self.names))


class _Handler(BaseHTTPRequestHandler):
    """Answers GET of the page, of the state, and of a camera's pictures."""

    preview: Preview

    def do_GET(self) -> None:
        """Answer one request."""
        name = unquote(self.path[1:].removesuffix(".mjpg"))
        if (self.headers.get("Host") or "").rpartition(":")[0] not in HOSTS:
            self.send_error(403)
        elif self.path == "/":
            self._send("text/html; charset=utf-8", self.preview.page().encode())
        elif self.path == "/state":
            self._send("application/json", json.dumps({"state": self.preview.state()}).encode())
        elif self.path.endswith(".mjpg") and name in self.preview.names:
            self._stream(name)
        else:
            self.send_error(404)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the terminal is for takes."""

    def _send(self, kind: str, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _stream(self, name: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=shot")
        self.end_headers()
        shown = None
        try:
            while self.preview.running:
                shot = self.preview.latest.get(name)
                if shot is not None and shot is not shown:
                    picture = _jpeg(shot)
                    self.wfile.write(b"--shot\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(picture))
                    self.wfile.write(picture + b"\r\n")
                    shown = shot
                time.sleep(1 / RATE)
        except OSError:  # the browser has left
            return


def _jpeg(shot: Shot) -> bytes:
    """A shot as a small picture."""
    import cv2

    image = cv2.cvtColor(shot.color, cv2.COLOR_RGB2BGR)
    if image.shape[1] > WIDTH:
        image = cv2.resize(image, (WIDTH, image.shape[0] * WIDTH // image.shape[1]), interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
