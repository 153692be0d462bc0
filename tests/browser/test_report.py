"""The report in a browser, opened as a file: it asks nobody for anything, and reads well dark, light, small and on paper."""

import re

import numpy as np
import pytest

from tests.browser.conftest import watched
from tests.browser.screen import until
from tests.cli import piegraph


@pytest.fixture(scope="module")
def page_file(sample_run, tmp_path_factory):
    """The page of the sample's run."""
    folder = tmp_path_factory.mktemp("reported")
    for path in sample_run.iterdir():
        if path.name != "report":
            (folder / path.name).symlink_to(path)
    piegraph("report", "--run", folder)
    return folder / "report" / "index.html"


@pytest.fixture(params=["light", "dark", "phone"])
def screen(request, browser, page_file, tmp_path):
    """The page as it is seen in the light, in the dark, and on a phone."""
    options = {"viewport": {"width": 1000, "height": 700}, "color_scheme": "light"}
    if request.param == "dark":
        options["color_scheme"] = "dark"
    elif request.param == "phone":
        options |= {"viewport": {"width": 360, "height": 640}, "is_mobile": True, "device_scale_factor": 2}
    with watched(browser, **options) as opened:
        opened.page.goto(page_file.as_uri())
        opened.look = request.param
        yield opened
        opened.save(tmp_path / f"{request.param}.png")
        assert opened.errors == []
        assert opened.strangers == []


def luminance(color: str) -> float:
    """Of a CSS colour, relative, as contrast is worked out."""
    parts = np.array([float(part) for part in re.findall(r"[\d.]+", color)[:3]]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_it_reads_well(screen):
    page = screen.page
    assert page.get_by_role("heading", name="Verdicts").is_visible()
    ground = luminance(page.evaluate("getComputedStyle(document.body).backgroundColor"))
    text = luminance(page.evaluate("getComputedStyle(document.querySelector('.verdicts p')).color"))
    high, low = max(ground, text), min(ground, text)
    assert (high + 0.05) / (low + 0.05) > 4.5
    assert (ground < 0.1) == (screen.look == "dark")
    wide, room = page.evaluate("[document.documentElement.scrollWidth, document.documentElement.clientWidth]")
    assert wide <= room, "the page scrolls sideways"
    small = page.evaluate(
        "Math.min(...[...document.querySelectorAll('p, td, li')].map(e => parseFloat(getComputedStyle(e).fontSize)))"
    )
    assert small >= 11


def test_every_image_is_there_and_says_what_it_shows(screen):
    told = screen.page.evaluate(
        """async () => {
            const found = [...document.querySelectorAll('main img')];
            found.forEach(image => { image.loading = 'eager'; });
            await Promise.all(found.map(image => image.decode()));
            return found.map(image => [image.alt, image.naturalWidth]);
        }"""
    )
    assert len(told) >= 4
    assert all(len(alt) > 10 and width > 0 for alt, width in told)
    assert screen.page.evaluate(
        "[...document.querySelectorAll('svg')].every(s => s.querySelector('title') || s.ariaLabel)"
    )


def test_a_picture_is_enlarged_and_put_away(screen):
    page = screen.page
    page.locator(".zoom").first.click()
    large = page.locator("#large")
    until(lambda: large.is_visible() or None, "the large picture")
    page.keyboard.press("Escape")
    until(lambda: not large.is_visible() or None, "the page again")


def test_it_prints_on_white_paper(browser, page_file, tmp_path):
    with watched(browser, viewport={"width": 1000, "height": 700}, color_scheme="dark") as screen:
        screen.page.goto(page_file.as_uri())
        screen.page.emulate_media(media="print")
        ground = screen.page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert ground == "rgba(0, 0, 0, 0)" or luminance(ground) > 0.9
        assert luminance(screen.page.evaluate("getComputedStyle(document.body).color")) < 0.1
        paper = screen.page.pdf(path=str(tmp_path / "report.pdf"), format="A4")
        assert paper[:5] == b"%PDF-"
        assert len(paper) > 50_000
        assert screen.errors == []
        assert screen.strangers == []
