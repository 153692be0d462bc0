"""A page as a browser reads it, without a browser: its tags, attributes and text."""

from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

VOID = {"meta", "link", "img", "br", "input", "path", "use", "rect"}


class Page(HTMLParser):
    """Tags with their attributes in order, and the text of each tag name."""

    def __init__(self, path: Path):
        super().__init__()
        self.source = path.read_text("utf-8")
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[tuple[str, ...], str]] = []
        self.open: list[str] = []
        self.feed(self.source)
        assert self.open == [], "what is opened is closed"

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        assert len(dict(attrs)) == len(attrs), f"{tag} has an attribute twice"
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append((tuple(self.open), data))

    def all(self, tag: str, kind: str | None = None) -> list[dict[str, str | None]]:
        """The attributes of every such tag; of those of a class where one is given."""
        found = [attributes for name, attributes in self.tags if name == tag]
        return found if kind is None else [a for a in found if kind in (a.get("class") or "").split()]

    def text(self, tag: str = "body") -> str:
        """All that is written within a tag."""
        parts = [text for inside, text in self.texts if tag in inside and not {"style", "script"} & set(inside)]
        return " ".join("".join(parts).split())

    def ids(self) -> Counter:
        """How often each id is there."""
        return Counter(a["id"] for _, a in self.tags if "id" in a)
