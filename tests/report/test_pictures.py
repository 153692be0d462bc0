"""Pictures of the report: SVG that stands in a page, sheets that fit their share of it, and words from figures."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from piegraph_cli.evaluation import figures
from piegraph_cli.evaluation.top_view import Moment, draw_moment, extent
from piegraph_cli.report.outcomes import _word_of_gains
from piegraph_cli.report.pictures import PAGE, SEQUENCE, kept_picture, share_of, shrink, spread
from piegraph_cli.report.sequence import Seen, draw_sequence
from piegraph_cli.report.svg import is_plain, svg_of
from tests.report import made_run
from tests.stages.chain import artifact


def a_plot(mark: str) -> str:
    time = np.arange(5) / 5
    return svg_of(lambda: figures.time_figure(time, {"a < b": time}, time > 0.3), mark, "a <b> & c")


def test_a_plot_stands_in_a_page():
    svg, other = a_plot("one"), a_plot("two")
    assert svg == a_plot("one"), "the same each time"
    assert svg.replace("one-", "") == other.replace("two-", "")
    assert "<title>a &lt;b&gt; &amp; c</title>" in svg
    assert ">a &lt; b</text>" in svg, "text is text"
    assert "font-family" not in svg
    assert "DejaVu" not in svg
    assert "#000000" not in svg
    assert "currentColor" in svg
    assert is_plain(svg)


@pytest.mark.parametrize(
    "harm",
    [
        "<script>1</script>",
        "<image href='data:,'/>",
        '<g onload="1"/>',
        '<use href="http://x"/>',
        '<a href="#x"/>',
        '<rect style="fill: url(http://x)"/>',
        "<style>@import 'x'</style>",
        "<!-- -->",
    ],
)
def test_what_runs_or_is_fetched_is_no_plot(harm):
    svg = a_plot("p")
    assert not is_plain(svg.replace("</svg>", harm + "</svg>"))


def seen(**more) -> Seen:
    parts = {"frames": "ingest", "hands": "hands", "masks": "segment", "clouds": "fuse", "tracks": "track"}
    made = {name: artifact(made_run.SEQUENCE[stage](0)) for name, stage in parts.items()}
    made["frames"].arrays["camera_name"] = made["frames"].arrays["camera_name"].astype("S")
    return Seen("take", **made | more)


def test_pictures_keep_to_their_share():
    sizes = []
    for share in (SEQUENCE, 9_000, 4_000, 1_000):
        pictures = draw_sequence(seen(), share, "p")
        sizes.append(sum(picture.bytes for picture in pictures) * 3 / 4)
        assert sizes[-1] <= share or len(pictures) == 1
        assert all(kept_picture(picture.plain()) == picture for picture in pictures)
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > sizes[-1]
    assert share_of(4) == SEQUENCE
    for count in (1, 60, 100, 999):
        assert share_of(count) * count <= PAGE
    assert share_of(70) == share_of(100), "one sequence more does not draw all anew"


def test_a_film_is_a_sheet_of_its_frames():
    film, sheet, above, plot = draw_sequence(seen(), SEQUENCE, "p")
    assert [one.kind for one in (film, sheet, above, plot)] == ["film", "image", "image", "plot"]
    about = film.film
    assert about["frames"] == len(about["times"]) == made_run.FRAMES
    assert about["columns"] * about["rows"] >= about["frames"]
    assert (film.width, film.height) == (64 * about["columns"], 48 * about["rows"])
    image = Image.open(io.BytesIO(base64.b64decode(sheet.data)))
    assert image.size == (sheet.width, sheet.height)
    assert "le<ft>" not in film.alt
    assert "mask" in sheet.alt


def test_tracks_without_images_are_a_film_from_above():
    film, plot = draw_sequence(seen(frames=None, hands=None, masks=None, clouds=None), SEQUENCE, "p")
    assert (film.kind, plot.kind) == ("film", "plot")
    assert film.film["frames"] == made_run.FRAMES


def test_views_from_above_have_no_ground():
    points = np.array([[0.0, 0, 0.02], [0.1, 0.1, 0.02]])
    middle, width = extent([Moment(particles=points)])
    red = np.array([[255, 0, 0], [0, 0, 255]], np.uint8)
    view = draw_moment(
        Moment(cloud=points, particles=points, true=points + 0.01, hand=points), red, middle, width, 200, "1 s"
    )
    assert view.shape == (256, 200, 4)
    assert (view[..., 3] == 0).mean() > 0.8
    first = (points[0, :2] - middle) * [1, -1] * 200 / width + 100
    assert view[round(first[1]), round(first[0])].tolist() == [255, 0, 0, 255]
    assert extent([Moment()])[1] > 0


def test_frames_are_spread_from_first_to_last():
    assert spread(9, 3) == [0, 4, 8]
    assert spread(2, 5) == [0, 1]
    assert spread(5, 0) == []
    assert shrink(np.zeros((30, 40, 3), np.uint8), 20).shape == (15, 20, 3)
    assert shrink(np.zeros((30, 40, 3), np.uint8), 80).shape == (30, 40, 3)


NAN = float("nan")


@pytest.mark.parametrize(
    ("gains", "word", "said"),
    [
        ({1: (2.0, 1.5, 2.5)}, "good", ""),
        ({1: (2.0, 1.5, 2.5), 3: (-0.1, -1.0, 1.0)}, "check", "at 3 strokes"),
        ({1: (0.2, -0.5, 0.9)}, "check", "holds zero"),
        ({1: (2.0, NAN, NAN)}, "check", "no interval"),
        ({1: (-1.0, -1.5, -0.5)}, "bad", "at 1 strokes"),
    ],
)
def test_a_model_is_judged_by_its_interval_against_nothing(gains, word, said):
    found, todo = _word_of_gains(gains)
    assert found == word
    assert said in " ".join(todo)
    assert bool(todo) == (word != "good")


def test_models_at_one_horizon_lie_side_by_side():
    rows = [{"model": m, "horizon": h, "pd": (1.0, 0.9, 1.1)} for m in ("static", "piegraph") for h in (1, 2)]
    (axes,) = figures.error_figure(rows, "pd").axes
    first, second = (
        line.get_xdata() for line in axes.lines if len(line.get_xdata()) == 2 and line.get_linestyle() == "-"
    )
    assert (np.abs(np.subtract(first, second)) > 0.1).all()
    assert [text.get_text() for text in axes.get_xticklabels()] == ["1", "2"]
