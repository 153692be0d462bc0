"""The tables of README.md and docs/ are those of results/."""

from pathlib import Path

import pytest

from tools import measured, settings
from tools.tables import PAGES, PLACE, REPOSITORY, RESULTS, Figure, cell_text, filled, markdown, read

NAMES = sorted(path.stem for path in RESULTS.glob("*.toml"))

SMALL = """
title = "two ropes"
columns = [{ name = "" }, { name = "stiff", form = "{} [{}, {}]" }, { name = "bendy", form = "{} %" }]
rows = [["`static`", [5.60, -0.30, 1.00], 100], ["`pgnd`", ["{}* [{}, {}]", 5.6, 5, 6.0], ""]]
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_pages_are_as_the_results_make_them(path: Path):
    page = path.read_text(encoding="utf-8")
    assert filled(page) == page, "`make tables` writes them again"


def test_the_page_of_settings_is_as_the_models_make_it():
    assert settings.PAGE.read_text(encoding="utf-8") == settings.page(), "`make tables` writes it again"
    assert "| `gain` | number > 0 | `0.03` | proportional gain Kp dt^2/m |" in settings.page()


def test_every_result_is_on_a_page_once():
    shown = [name for path in PAGES for _, name, _, _ in PLACE.findall(path.read_text(encoding="utf-8"))]
    assert len(set(shown)) == len(shown)
    assert set(NAMES) <= set(shown) <= {*NAMES, *measured.NAMES}


def test_readme_has_no_table_that_is_not_made():
    readme = PLACE.sub("", (REPOSITORY / "README.md").read_text(encoding="utf-8"))
    assert not [line for line in readme.splitlines() if line.startswith("|")]


@pytest.mark.parametrize("name", NAMES)
def test_a_result_says_when_and_on_what(name: str):
    assert {"title", "machine", "date"} <= read(RESULTS / f"{name}.toml").keys()


def test_digits_stay_as_they_are_written(small: Path):
    assert markdown(read(small)) == (
        "| | stiff | bendy |\n|---|---|---|\n| `static` | 5.60 [-0.30, 1.00] | 100 % |\n| `pgnd` | 5.6* [5, 6.0] | |\n"
    )
    assert Figure("5.60") == 5.6


def test_columns_with_widths_are_a_block(small: Path):
    small.write_text(
        'title = ""\ncolumns = [{ name = "", width = 4 }, { name = "ms", width = 6 }]\nrows = [["a", 1.50]]'
    )
    assert markdown(read(small)) == "```\n        ms\na     1.50\n```\n"


def test_a_page_is_filled_between_its_marks(small: Path):
    page = "before\n<!-- table: small -->\nold\n<!-- end -->\nafter\n"
    new = filled(page, small.parent)
    assert new == f"before\n<!-- table: small -->\n{markdown(read(small))}<!-- end -->\nafter\n"
    assert filled(new, small.parent) == new


@pytest.mark.parametrize(
    "page", ["<!-- table: small -->\nno end\n", "<!-- end -->\n", "<!-- table: other -->\n<!-- end -->\n"]
)
def test_marks_without_each_other_or_a_file_are_refused(page: str, small: Path):
    with pytest.raises(ValueError, match=r"without its|no other\.toml"):
        filled(page, small.parent)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("title", "titel", "titel, title"),
        ('100], ["`pgnd`"', '1, 2], ["`pgnd`"', "4 cells in place of 3 at '`static`'"),
    ],
)
def test_a_file_that_is_wrong_is_refused(small: Path, old: str, new: str, reason: str):
    small.write_text(SMALL.replace(old, new, 1))
    with pytest.raises(ValueError, match=reason):
        read(small)


def test_a_form_takes_its_figures_and_no_others():
    assert cell_text([1, 2], "{} / {}") == "1 / 2"
    with pytest.raises(ValueError, match="does not take 3"):
        cell_text([1, 2, 3], "{} / {}")
