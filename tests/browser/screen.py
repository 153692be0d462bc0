"""A page of the browser as a person sees it: what is written, what is drawn, and what must not be: errors and strangers."""

import io
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

WAIT = 30.0
"""Seconds that a test waits for what must come."""
OF_THE_LIBRARY = ("Unable to preventDefault inside passive event listener",)
"""What viser's page says of itself where something is dragged: nothing is wrong by it."""
HERE = ("http://127.0.0.1", "ws://127.0.0.1", "file:", "data:", "blob:")


class Screen:
    """One page."""

    def __init__(self, page):
        self.page = page
        self.errors: list[str] = []
        self.strangers: list[str] = []
        page.set_default_timeout(1000 * WAIT)
        page.on("console", lambda said: self._said(said.type, said.text))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda asked: self._asked(asked.url))
        page.on("websocket", lambda socket: self._asked(socket.url))

    def _said(self, kind: str, text: str) -> None:
        if kind == "error" and not text.startswith(OF_THE_LIBRARY):
            self.errors.append(text)

    def _asked(self, url: str) -> None:
        if not url.startswith(HERE):
            self.strangers.append(url)

    def scene(self) -> np.ndarray:
        """What is drawn in the scene [H, W, 3] uint8; of what lies over it nothing is taken away."""
        return self._seen(self.page.locator("canvas").first.bounding_box())

    def _seen(self, clip) -> np.ndarray:
        return np.asarray(Image.open(io.BytesIO(self.page.screenshot(clip=clip))).convert("RGB"))

    def save(self, path: Path) -> None:
        """Keep what is seen."""
        self.page.screenshot(path=str(path))

    def choose(self, label: str, option: str) -> None:
        """Choose in a dropdown."""
        self.page.get_by_label(label, exact=True).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def tab(self, name: str) -> None:
        """Open a tab."""
        self.page.get_by_role("tab", name=name, exact=True).click()

    def press(self, name: str) -> None:
        """Press a button."""
        self.page.get_by_role("button", name=name, exact=True).click()

    def number(self, label: str):
        """The field beside a slider."""
        beside = f'//label[text()="{label}"]/ancestor::div[contains(@class, "Flex-root")][1]'
        return self.page.locator(f'{beside}//input[contains(@class, "NumberInput-input")]')

    def read(self, start: str) -> str:
        """The first text that begins so, when it is there."""
        found = self.page.get_by_text(start).first
        found.wait_for()
        return found.inner_text()

    def click_scene(self, column: float, row: float) -> None:
        """Click on a pixel of `scene`."""
        box = self.page.locator("canvas").first.bounding_box()
        self.page.mouse.click(box["x"] + column, box["y"] + row)

    def drag_scene(self, begin: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag from a pixel of `scene` to another."""
        box = self.page.locator("canvas").first.bounding_box()
        (x0, y0), (x1, y1) = ((box["x"] + x, box["y"] + y) for x, y in (begin, end))
        self.page.mouse.move(x0, y0)
        self.page.wait_for_timeout(200)
        self.page.mouse.down()
        for part in np.linspace(0, 1, 6)[1:]:
            self.page.mouse.move(x0 + part * (x1 - x0), y0 + part * (y1 - y0))
            self.page.wait_for_timeout(60)
        self.page.mouse.up()


def until(true: Callable[[], Any], what: str, seconds: float = WAIT):
    """What comes in place of None or False. Fails, with what was waited for, where nothing does."""
    end = time.monotonic() + seconds
    while (found := true()) is None or found is False:
        assert time.monotonic() < end, f"{what} did not come"
        time.sleep(0.1)
    return found


def changed(before: np.ndarray, now: np.ndarray, by: int = 24) -> int:
    """How many pixels differ."""
    return int((np.abs(before.astype(int) - now).max(-1) > by).sum()) if before.shape == now.shape else before.size


def like(image: np.ndarray, color: tuple[int, int, int], by: int = 30) -> np.ndarray:
    """Pixels [P, 2] (column, row) of about a colour."""
    return np.argwhere(np.abs(image.astype(int) - np.array(color)).max(-1) <= by)[:, ::-1]
