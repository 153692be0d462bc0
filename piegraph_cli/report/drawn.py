"""Pictures that were drawn before, kept in RUN/report/.drawn: what has not changed is not drawn again."""

import hashlib
import json
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from piegraph_cli.errors import DataError
from piegraph_cli.files import atomic_file
from piegraph_cli.report.pictures import Picture, kept_picture

VERSION = 5
"""Raised when pictures look different, so that they are drawn anew."""


@dataclass
class Drawn:
    """The pictures of one run by group: those of a sequence, of the metrics, of the plan."""

    folder: Path
    used: set[str] = field(default_factory=set)

    def take(self, group: str, of: Iterable[object], draw: Callable[[str], list[Picture]]) -> list[Picture]:
        """A group's pictures: those kept if they show the same (keys and sizes in `of`), or else drawn and kept.

        `draw` gets a mark that ids in the group's plots begin with.
        """
        name = hashlib.sha256(group.encode("utf-8", "surrogateescape")).hexdigest()[:20]
        stamp = " ".join(map(str, (VERSION, *of)))
        path = self.folder / f"{name}.json"
        self.used.add(path.name)
        try:
            kept = json.loads(path.read_text("utf-8"))
            if kept["stamp"] == stamp:
                return [kept_picture(row) for row in kept["pictures"]]
        except (OSError, ValueError, TypeError, KeyError, RecursionError):
            pass
        pictures = draw(f"p{name[:8]}")
        with suppress(DataError), atomic_file(path) as temporary:  # what cannot be kept is there all the same
            temporary.write_text(json.dumps({"stamp": stamp, "pictures": [picture.plain() for picture in pictures]}))
        return pictures

    def forget_others(self) -> None:
        """Remove what no group of this run uses any more."""
        for path in self.folder.glob("*.json"):
            if path.name not in self.used:
                path.unlink(missing_ok=True)
