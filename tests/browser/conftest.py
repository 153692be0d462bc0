"""A browser that tests drive, and what is common to them: it is found, or they are skipped with the reason."""

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.browser.screen import Screen
from tests.cli import PATIENCE, PROGRAM, REPOSITORY

ARGUMENTS = [
    *("--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"),
    *("--disable-sync", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
]
"""Nothing that calls home, and WebGL without a graphics card."""
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


@pytest.fixture(scope="session")
def browser():
    """Chromium: playwright's own, or the system's."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: make setup")
    with playwright.sync_playwright() as driver:
        own = driver.chromium.executable_path
        found = own if Path(own).exists() else next(filter(None, map(shutil.which, NAMES)), None)
        if found is None:
            pytest.skip("no Chromium: make browser")
        arguments = [*ARGUMENTS, *(["--no-sandbox"] if os.geteuid() == 0 else [])]
        started = driver.chromium.launch(executable_path=found, args=arguments)
        yield started
        started.close()


@contextmanager
def watched(browser, **options) -> Iterator[Screen]:
    """A page whose errors and requests are kept."""
    context = browser.new_context(**options)
    try:
        yield Screen(context.new_page())
    finally:
        context.close()


@contextmanager
def viewing(run: Path, log: Path) -> Iterator[str]:
    """The address of a viewer of a run, in a process of its own."""
    with log.open("w") as out:
        command = [*PROGRAM, "view", "--run", str(run)]
        process = subprocess.Popen(
            command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=out, text=True, start_new_session=True
        )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        address = re.match(r"http://127\.0\.0\.1:\d+", line)
        assert address, f"{line}{log.read_text()}"
        yield address.group()
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=PATIENCE)
