"""The report's page: it stands alone, is escaped, has all sequences, and leaves out what is stale, failed or damaged."""

import base64
import hashlib
import json
import re
from itertools import pairwise

import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.report import page as report_page
from piegraph_cli.report import sections
from piegraph_cli.report.drawn import Drawn
from piegraph_cli.report.page import write_report
from piegraph_cli.report.pictures import Picture
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.workspace.said import keep_warnings
from tests.hdf5 import edited
from tests.report.made_run import GOOD, SEQUENCE, empty_run, frames, made_run, put
from tests.report.page import Page

ODD = "a <b>&\"x' {{ 7 * 7 }} $y$"
NAMES = [ODD, "second", "third"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The report of a run of which all is made, with names that are no HTML."""
    run = made_run(tmp_path_factory.mktemp("report") / "run <i>", NAMES)
    return Page(write_report(run.folder).path), run


def words(page: Page) -> dict[str, str]:
    """The word of each part of the run."""
    text = " ".join(text for inside, text in page.texts if inside[-1:] == ("span",) or inside[-1:] == ("h3",))
    parts = ("recording", "hands", "masks", "tracks", "model", "plan", "trials")
    found = re.findall(rf"\b({'|'.join(parts)})\s+[✓!✕…]\s+(good|check|bad|not yet)", " ".join(text.split()))
    return dict(found)


def test_the_page_needs_nothing_beside_it(whole):
    page, _ = whole
    for tag, attributes in page.tags:
        for name, value in attributes.items():
            assert not name.startswith("on"), f"{tag} has {name}"
            if name in ("src", "href", "xlink:href", "srcset", "action", "data", "poster"):
                assert value.startswith(("data:", "#")), f"{tag}: {value[:80]}"
    assert {tag for tag, _ in page.tags} & {"iframe", "object", "embed", "form", "base", "foreignobject"} == set()
    assert [link["rel"] for link in page.all("link")] == ["icon"]
    outside = re.findall(r"@import|url\((?!#)|https?://[^\s\"'<>]*", page.source)
    assert set(outside) <= {"http://www.w3.org/2000/svg"}


def test_the_policy_lets_the_page_s_own_script_run_and_nothing_else(whole):
    page, _ = whole
    (policy,) = (m["content"] for m in page.all("meta") if m.get("http-equiv") == "Content-Security-Policy")
    (script,) = re.findall(r"<script>(.*?)</script>", page.source, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["script-src"] == f"'sha256-{digest}'"
    assert rules["img-src"] == "data:"
    assert rules["base-uri"] == rules["form-action"] == "'none'"
    assert page.source.index("Content-Security-Policy") < page.source.index("<style>")


def test_the_page_can_be_read_aloud_and_walked_through(whole):
    page, _ = whole
    assert page.all("html") == [{"lang": "en"}]
    assert page.text("head") == "run <i> – piegraph report"
    images = [image for image in page.all("img") if "src" in image]
    assert len(images) == 3 * 3
    assert all(image["alt"] and int(image["width"]) > 0 and int(image["height"]) > 0 for image in images)
    plots = page.all("svg")
    assert len(plots) == 3 + 3 + 1 + 1, "errors over time, three metrics, a loss, a plan"
    assert all(plot["role"] == "img" for plot in plots)
    assert page.source.count("<title>") == len(plots) + 1
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    assert set(page.ids().values()) == {1}, "ids clash"
    targets = {a["href"][1:] for a in page.all("a")} | {u["href"][1:] for u in page.all("use")}
    targets |= set(re.findall(r"url\(#([^)]+)\)", page.source))
    assert targets <= set(page.ids())
    assert any(m.get("name") == "viewport" for m in page.all("meta"))
    for rule in ("prefers-color-scheme: dark", "@media print", "overflow-x: auto"):
        assert rule in page.source


def test_all_sequences_are_there_and_names_are_escaped(whole):
    page, _ = whole
    assert len(page.all("article")) == len(NAMES)
    assert page.all("b") == page.all("i") == []
    text = page.text()
    for name in NAMES:
        assert text.count(" ".join(name.split())) >= 2, "in the table and above its pictures"
    assert "run <i>" in page.text("h1")
    assert page.source.count("le&lt;ft&gt;") == 0, "alt texts name the camera that sees most, which is the first"
    assert words(page) == dict.fromkeys(("recording", "hands", "masks", "tracks", "model", "plan"), "good")


def test_the_figures_of_the_run_are_in_the_tables(whole):
    page, run = whole
    text = page.text()
    for said in (
        "3 / 0 / 0",
        "1.05 [1.00, 1.10]",
        "+2.00 [+2.00, +2.00]",
        "1 of 1 goals reached",
        "object mask IoU",
        "expected error 2.0 mm, measured 1.5 mm",
        f"piegraph run recipe.toml --run '{run.folder}'",
        'env = "tblock"',
        run.key(STAGES["track"], "second"),
        "spring stiffness",
    ):
        assert said in text, said
    assert page.text().count("Not in this report") == 0


def test_what_is_stale_is_left_out_and_named_with_its_command(tmp_path):
    run = made_run(tmp_path / "run", NAMES)
    run.recipe = run.recipe.with_values(STAGES["track"], {"stiffness": 0.12}, "test", tmp_path)
    run.save_recipe()
    written = write_report(run.folder)
    page = Page(written.path)
    assert words(page) == dict.fromkeys(("recording", "hands", "masks"), "good") | dict.fromkeys(
        ("tracks", "model", "plan"), "not yet"
    )
    assert page.all("svg") == [], "no error, no loss and no plan of old tracks"
    assert "1.05" not in page.text()
    assert "goals reached" not in page.text()
    assert f"piegraph run --run {run.folder} --until track" in page.text()
    (gap,) = (gap for gap in written.left_out if gap.stage == "track")
    assert (gap.state, gap.units, gap.why) == ("stale", NAMES, "settings changed: stiffness")
    assert all("particles" not in image["alt"] for image in page.all("img") if "src" in image)


def test_a_unit_that_failed_is_named_with_its_reason_once(tmp_path):
    run = made_run(tmp_path / "run", NAMES)
    run.path("hands", "second").unlink()
    run = open_run(run.folder)
    error = DataError("no hand <script>alert(1)</script>", "second", "piegraph hands --source glove")
    run.record_failures(STAGES["hands"], ["second"], {"second": error})
    keep_warnings(run, STAGES["segment"], {"third": ["2 things on the table are alike\n  try: a box"]})
    written = write_report(run.folder)
    page = Page(written.path)
    assert len(page.all("script")) == 1
    assert (words(page)["hands"], words(page)["masks"], words(page)["tracks"]) == ("check", "check", "good")
    assert page.text().count("no hand <script>alert(1)</script>") == 3, "verdict, what is left out, the sequence"
    assert "third: 2 things on the table are alike" in page.text()
    assert [(gap.state, gap.units) for gap in written.left_out if gap.stage == "hands"] == [("failed", ["second"])]


def test_a_run_of_which_nothing_or_little_is_made_says_what_to_do(tmp_path):
    run = empty_run(tmp_path / "run", ["one"])
    page = Page(write_report(run.folder).path)
    assert set(words(page).values()) == {"not yet"}
    assert f"piegraph run --run {run.folder} --until ingest" in page.text()
    assert page.all("svg") == []
    put(run, "ingest", "one", frames(0))
    page = Page(write_report(run.folder).path)
    assert words(page)["recording"] == "good"
    assert words(page)["hands"] == "not yet"
    assert sum("src" in image for image in page.all("img")) == 2, "a film and a sheet as recorded"


def test_doubtful_checks_are_told_with_what_to_do(tmp_path):
    run = made_run(tmp_path / "run", ["one", "two"], "ingest")
    doubtful = ("edges", "front", "px", "doubtful", "edges lie 6 px apart", "depth is not registered", "register it")
    bad = ("table", "front", "mm", "bad", "table 90 mm above z = 0", "poses", "calibrate again")
    put(run, "ingest", "two", frames(0, GOOD, doubtful))
    page = Page(write_report(run.folder).path)
    assert words(page)["recording"] == "check"
    assert "edges, front: edges lie 6 px apart; depth is not registered" in page.text()
    assert "1 / 0 / 0" not in page.text()
    assert "0 / 1 / 0" in page.text()
    for name in ("one", "two"):
        put(run, "ingest", name, frames(0, bad))
    assert words(Page(write_report(run.folder).path))["recording"] == "bad"


def test_a_damaged_artifact_is_left_out_and_named_once(tmp_path, caplog):

    run = made_run(tmp_path / "run", NAMES, "track")
    with edited(run.path("masks", "second")) as file:
        del file["area"]
        file["area"] = [[1.0]]
    written = write_report(run.folder)
    (gap,) = (gap for gap in written.left_out if gap.state == "damaged")
    assert (gap.stage, gap.units) == ("segment", ["second"])
    assert "dataset area" in gap.why
    assert caplog.text.count("left out of the report") == 1
    assert words(Page(written.path))["masks"] == "check"


def test_images_that_cannot_be_decoded_are_named(tmp_path):
    run = made_run(tmp_path / "run", NAMES[:2], "ingest")
    broken = frames(0)
    broken["color"] = broken["color"] * 0
    put(run, "ingest", "second", broken)
    page = Page(write_report(run.folder).path)
    assert "colour image of frame 0, camera 0 cannot be decoded" in page.text()
    assert sum("src" in image for image in page.all("img")) == 2, "those of the other sequence"


def test_what_stages_warned_of_is_in_the_verdicts(tmp_path):
    run = made_run(tmp_path / "run", NAMES)
    keep_warnings(run, STAGES["evaluate"], {"static": ["no held-out sequence has 4 strokes in a row"]})
    page = Page(write_report(run.folder).path)
    assert "no held-out sequence has 4 strokes in a row" in page.text()
    assert words(page)["model"] == "good", "a horizon that is left out is no doubt of the others"
    keep_warnings(run, STAGES["dataset"], {None: ["no stroke in third"]})
    keep_warnings(run, STAGES["fuse"], {"third": ["the hand never touches the object"]})
    page = Page(write_report(run.folder).path)
    assert (words(page)["model"], words(page)["tracks"], words(page)["plan"]) == ("check", "check", "good")
    assert "no stroke in third" in page.text()
    assert "third: the hand never touches the object" in page.text()


def test_what_was_drawn_is_not_drawn_again(tmp_path, monkeypatch):
    run = made_run(tmp_path / "run", NAMES[:2])
    first = write_report(run.folder).path.read_text()

    def never(*_):
        raise AssertionError("drawn again")

    for name in ("draw_sequence", "svg_of"):
        monkeypatch.setattr(sections, name, never)
    again = write_report(run.folder).path.read_text()
    cut = re.compile(r'<p class="about">.*?</p>')
    assert cut.sub("", first) == cut.sub("", again)
    run.recipe = run.recipe.with_values(STAGES["track"], {"stiffness": 0.12}, "test", tmp_path)
    run.save_recipe()
    put(open_run(run.folder), "track", "second", SEQUENCE["track"](1))
    with pytest.raises(AssertionError, match="drawn again"):
        write_report(run.folder)
    assert (run.folder / "report" / "index.html").read_text() == again, "the page before stays whole"


@pytest.mark.parametrize("harm", ["cut", "script", "not base64", "other kind"])
def test_a_drawing_that_was_tampered_with_is_drawn_anew(tmp_path, harm):
    drawn, calls = Drawn(tmp_path), []

    def draw(mark):
        calls.append(mark)
        return [
            Picture("plot", "<svg><text>1</text></svg>", "a plot", "plot"),
            Picture("image", "QUJD", "an image", "i"),
        ]

    assert drawn.take("group", ["key"], draw) == drawn.take("group", ["key"], draw)
    assert len(calls) == 1
    (path,) = tmp_path.glob("*.json")
    kept = json.loads(path.read_text())
    if harm == "script":
        kept["pictures"][0]["data"] = "<svg><script>alert(1)</script></svg>"
    if harm == "not base64":
        kept["pictures"][1]["data"] = '"><script>'
    if harm == "other kind":
        kept["pictures"][1]["kind"] = "page"
    path.write_text(json.dumps(kept)[: -5 if harm == "cut" else None])
    drawn.take("group", ["key"], draw)
    assert len(calls) == 2
    drawn.take("group", ["another key"], draw)
    assert len(calls) == 3
    drawn.used.clear()
    drawn.forget_others()
    assert not list(tmp_path.glob("*.json"))


def test_a_page_that_cannot_be_rendered_leaves_the_one_before(tmp_path, monkeypatch):
    run = empty_run(tmp_path / "run", ["one"])
    path = write_report(run.folder).path
    before = path.read_bytes()
    monkeypatch.setattr(report_page, "_render", lambda content: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_report(run.folder)
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir() if file.suffix == ".tmp"] == []
