"""Figures as SVG that stands in a page: text as text in the page's font, lines in the colour of its text, ids of its own."""

import io
import re
from collections.abc import Callable
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

INK = "#012345"
"""Drawn in the colour of the page's text."""
STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "piegraph",
    "font.size": 9,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "axes.titlesize": 10,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#808080",
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "figure.facecolor": "none",
    "legend.frameon": False,
}
FONT = "system-ui,sans-serif"

TAGS = {"svg", "defs", "g", "path", "use", "text", "tspan", "clipPath", "rect", "title"}
"""What a figure is made of; a kept drawing that has anything else is drawn anew."""


def svg_of(draw: Callable[[], Figure], mark: str, title: str) -> str:
    """The SVG of the figure that `draw` makes; its ids begin with `mark`, `title` is what is read aloud."""
    from markupsafe import escape

    buffer = io.StringIO()
    with rc_context(STYLE):
        draw().savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :].strip()
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->|<style.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    text = re.sub(r'(\bid="|\bhref="#|url\(#)', rf"\g<1>{mark}-", text)
    text = re.sub(r'\b(d|x|y|transform|points)="([^"]*)"', _rounded, text)
    text = re.sub(r'font: ([^;"]*?)([\d.]+px) [^;"]*', rf"font: \g<1>\g<2> {FONT}", text)  # matplotlib before 3.10
    text = re.sub(r'font-family: [^;"]*;?| transform="rotate\(-0 [^"]*"', "", text).replace("xlink:href", "href")
    text = text.replace(INK, "currentColor").replace("#000000", "currentColor")
    box = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text)
    assert box is not None
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {box[0]} '
    head += f'width="{float(box[1]) * 4 / 3:.0f}" fill="currentColor" role="img"><title>{escape(title)}</title>'
    return re.sub(r"\n\s*", "\n", re.sub(r"^<svg[^>]*>", lambda _: head, text))


def is_plain(svg: str) -> bool:
    """Whether a drawing that was kept is one of `svg_of`: nothing in it runs, or is fetched."""
    tags = set(re.findall(r"<\s*([A-Za-z][\w:.-]*)", svg))
    foreign = re.search(r"""\bon\w+\s*=|href\s*=\s*["'](?!#)|@import|url\((?!#)|<[!?]""", svg, re.IGNORECASE)
    return svg.startswith("<svg") and svg.endswith("</svg>") and tags <= TAGS and foreign is None


def _rounded(found: re.Match[str]) -> str:
    """Coordinates to a hundredth of a point."""
    short = re.sub(r"(\.[0-9]{2})[0-9]+", r"\g<1>", found[2])
    return f'{found[1]}="{short}"'
