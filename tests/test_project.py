"""What people who join find: the pages agree with the package, and lead somewhere."""

import importlib
import re
import sys

import pytest

import piegraph_cli
from tests.cli import REPOSITORY

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PAGES = [*sorted(REPOSITORY.glob("*.md")), *sorted((REPOSITORY / "docs").glob("*.md"))]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]


def test_the_citation_is_of_this_version():
    version = re.search(r"^version: (.+)$", (REPOSITORY / "CITATION.cff").read_text(), re.MULTILINE)
    assert version is not None
    assert version[1] == piegraph_cli.__version__


def test_the_changelog_tells_of_this_version():
    assert piegraph_cli.__version__ in (REPOSITORY / "CHANGELOG.md").read_text()


def test_continuous_integration_runs_what_the_project_runs_on_every_python_that_it_names():
    workflow = (REPOSITORY / ".github" / "workflows" / "ci.yml").read_text()
    assert "run: .ci/run" in workflow
    tested = set(re.findall(r'"(3\.\d+)"', workflow))
    named = {c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", c)}
    assert tested == named == {"3.10", "3.11", "3.12"}
    assert PROJECT["requires-python"] == ">=3.10,<3.13"


@pytest.mark.parametrize(
    "form", sorted((REPOSITORY / ".github" / "ISSUE_TEMPLATE").glob("*")), ids=lambda path: path.name
)
def test_issues_are_asked_for_what_doctor_says(form):
    assert "piegraph doctor --json" in form.read_text()


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(page):
    links = [link for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text()) if "://" not in link]
    missing = [link for link in links if link[0] != "#" and not (page.parent / link.partition("#")[0]).exists()]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_commands_of_make_are_there(page):
    makefile = (REPOSITORY / "Makefile").read_text()
    targets = set(" ".join(re.findall(r"^(?:\.PHONY:|EXPERIMENTS :=)(.*)$", makefile, re.MULTILINE)).split())
    used = set(re.findall(r"(?:^|`)make ([a-z0-9-]+)", page.read_text(), re.MULTILINE))
    assert used <= targets, sorted(used - targets)


def test_limits_that_the_security_page_names_are_there():
    rows = re.findall(r"`(\w+)/(\w+)\.py`: ((?:`\w+`(?:, )?)+)", (REPOSITORY / "SECURITY.md").read_text())
    named = [(room, module, name) for room, module, names in rows for name in re.findall(r"`(\w+)`", names)]
    assert len(named) > 20
    for room, module, name in named:
        assert isinstance(getattr(importlib.import_module(f"piegraph_cli.{room}.{module}"), name), int | float)
