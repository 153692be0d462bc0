"""`python -m tests.attack.full_disk`: every command that writes, on a disk that is full from some call on, place after place.

A *place* is a call (open, write, sync, rename, ...) on one file by one command. A command is run once, its calls noted; then,
for each place, on a copy of what it began with: the disk is full from the first such call on, or for that call alone. It has to
end with exit code 3 and name what was being written, or with 0 where it could do without; nothing that was there is touched,
nothing half made is left, and the same command then makes the same bytes as one that nothing stopped.
"""

import argparse
import errno
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.workspace.artifact import read_artifact
from tests.attack.chains import DIFFERS, Chain
from tests.attack.shim import build, environment
from tests.attack.writers import Writer, writers
from tests.cli import piegraph

FREE = re.compile(
    r"(^|/)(\.locks|\.known\.json|run\.log|failures\.json|warnings\.json|checkpoints|\.drawn|\..*\.checkpoint\.h5)"
)
"""What may be another after a failure: notes, locks, pictures, which are drawn again, and states to go on from."""
DATE = re.compile(rb"\d\d [A-Z][a-z]+ 20\d\d, \d\d:\d\d")
"""When a report was written: another minute is no fault."""
BARE = re.compile(r"\.(?P<name>.+)\.\d+\.tmp$")
"""A file that is renamed once it is whole."""


@dataclass(frozen=True)
class Place:
    """The first call of its kind on a file, by its number among all calls of the command."""

    number: int
    call: str
    path: str


def places_in(log: Path) -> list[Place]:
    """The places that a command's calls went to, in order; names that are drawn anew count as one."""
    found: dict[tuple[str, str], Place] = {}
    for number, call, path in calls_in(log):
        found.setdefault((call, _plain(path)), Place(number, call, _plain(path)))
    return sorted(found.values(), key=lambda place: place.number)


def calls_in(log: Path) -> Iterator[tuple[int, str, str]]:
    """All calls that were noted."""
    for line in log.read_text().splitlines() if log.exists() else ():
        number, call, path = line.split(" ", 2)
        yield int(number), call, path.removeprefix("/")


def _plain(path: str) -> str:
    """A path without what is drawn anew each time."""
    path = BARE.sub(lambda match: match["name"], path)
    return re.sub(r"(piegraph-|\.probe\.|loky-\d+-|joblib_memmapping_folder_|/tmp)[A-Za-z0-9_]{3,}", r"\1*", path)


class Attempts:
    """One command, tried at its places, in folders below `work`."""

    def __init__(self, writer: Writer, work: Path, library: Path):
        self.writer, self.work, self.library = writer, work, library
        self.base = work / "base"
        self.base.mkdir(parents=True)
        writer.prepare(self.base)
        self.before = contents(self.base)
        self.log = work / "calls"
        for name, later in (("again", 86_400), ("reference", 0)):
            done = self.run(self.fresh(name), log=self.log, clock=later)
            assert done.returncode == 0, (done.stdout, done.stderr)
        self.expected, again = (contents(work / name) for name in ("reference", "again"))
        self.told = {path for path in self.expected if self.expected[path] != again.get(path)}
        """Files that differ from one day to the next: they have dates in them."""

    def fresh(self, name: str) -> Path:
        """A copy of what the command begins with."""
        folder = self.work / name
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self.base, folder, symlinks=True)
        (folder / "tmp").mkdir()
        return folder

    def run(self, folder: Path, **settings: object) -> subprocess.CompletedProcess:
        """The command in a folder, its calls noted or failing."""
        if log := settings.get("log"):
            Path(str(log)).unlink(missing_ok=True)
        given = environment(self.library, folder, "write" if settings else "none", **settings)
        given |= {"TMPDIR": str(folder / "tmp"), "OMP_NUM_THREADS": "1"}
        return piegraph(*self.writer.arguments, check=None, cwd=folder, env=given)

    def attack(self, place: Place, number: int, once: bool) -> tuple[str, list[str]]:
        """What became of one place: `refused`, `done` or `not reached`, and what is wrong about it."""
        folder, log = self.fresh("tried"), self.work / "failing"
        settings: dict[str, object] = {"at": place.number, "errno": number, "log": log}
        if once:
            settings["many"] = 1
        done = self.run(folder, **settings)
        failed = [(call, _plain(path)) for k, call, path in calls_in(log) if k >= place.number][: 1 if once else None]
        if (
            not failed and done.returncode == 0
        ):  # what is kept of files that have only just changed differs with the time
            return "not reached", []
        wrong = self.wrong_words(done, [path for _, path in failed])
        wrong += self.wrong_files(folder, whole=done.returncode == 0)
        again = self.run(folder)
        if again.returncode:
            wrong.append(f"the same command again: exit code {again.returncode}: {again.stderr[-600:]}")
        wrong += [f"afterwards: {text}" for text in self.wrong_files(folder, whole=True)]
        return {0: "done", 3: "refused"}.get(done.returncode, "other"), wrong

    def wrong_words(self, done: subprocess.CompletedProcess, paths: list[str]) -> list[str]:
        """What is wrong about how it ended."""
        text = done.stderr
        found = [] if done.returncode in (0, 3) else [f"exit code {done.returncode}: {text[-600:]}"]
        found += [f"says {word!r}: {text[-900:]}" for word in ("Traceback", "bug in") if word in text][:1]
        names = {part for path in map(Path, paths) for part in (path.name, str(path.parent), *_partial(path))} - {
            "",
            ".",
        }
        if done.returncode == 3 and not any(name in text for name in names):
            found.append(f"names none of {sorted(names)}: {text[-600:]}")
        return found

    def wrong_files(self, folder: Path, whole: bool) -> list[str]:
        """What was touched, left lying about, or is missing where the command has ended well."""
        now = contents(folder)
        found = [f"{path} is gone" for path in sorted(self.before.keys() & self.expected.keys() - now.keys())]
        found += [
            f"{path} is left"
            for path in sorted(now.keys() - self.expected.keys() - self.before.keys())
            if not FREE.search(path)
        ]
        for path in sorted(now.keys() - self.told):
            kept = now[path] == self.before.get(path) and not (whole and path in self.expected)
            if not whole and made_of_others(now[path], self.expected.get(path, "")):
                continue  # of what was left when one unit had failed: stale, and made again
            if not kept and now[path] != self.expected.get(path) and not FREE.search(path):
                found.append(f"{path} is another")
        if whole:
            found += [
                f"{path} is there still" for path in sorted(now.keys() & self.before.keys() - self.expected.keys())
            ]
            found += [
                f"{path} is missing" for path in sorted(self.expected.keys() - now.keys()) if not FREE.search(path)
            ]
        return found


def _partial(path: Path) -> list[str]:
    """The folder that is made whole before it gets its name, of which a file is a part."""
    return [found[1] for part in path.parts if (found := re.fullmatch(r"\.(.+)\.partial", part))]


def contents(folder: Path) -> dict[str, str]:
    """Of each file below a folder: of artifacts their key and values, of others their bytes."""
    found = {}
    for path in folder.rglob("*"):
        if path.is_file() or path.is_symlink():
            found[path.relative_to(folder).as_posix()] = (
                _artifact(path) or hashlib.sha256(DATE.sub(b"", path.read_bytes())).hexdigest()
            )
        elif path != folder / "tmp":
            found[path.relative_to(folder).as_posix()] = "folder"
    return found


def _artifact(path: Path) -> str | None:
    if path.suffix != ".h5":
        return None
    try:
        read = read_artifact(path)
    except DataError:
        return None
    digest = hashlib.sha256()
    for name in sorted(read.arrays.keys() - DIFFERS):
        value = read[name]
        digest.update(f"{name}{value.dtype}{value.shape}".encode() + value.tobytes())
    return f"{read.key} {digest.hexdigest()}"


def made_of_others(one: str, other: str) -> bool:
    """Whether these are `contents` of artifacts with different keys: of other inputs or settings."""
    (key, _, values), (wanted, _, expected) = one.partition(" "), other.partition(" ")
    return bool(values and expected) and key != wanted


def chosen(places: list[Place], most: int | None, rng: np.random.Generator) -> list[Place]:
    """All places, or so many of them, drawn."""
    if most is None or len(places) <= most:
        return places
    return [places[k] for k in sorted(rng.choice(len(places), most, replace=False))]


def finished(work: Path, chain: Chain) -> Path:
    """The folder in which a chain is finished, made when it is asked for first."""
    folder = work / chain.name
    if not folder.exists():
        folder.mkdir(parents=True)
        chain.prepare(folder)
        piegraph(*chain.arguments, cwd=folder)
    return folder


def main() -> int:
    """Attack, print, and end with 1 where there was a fault."""
    parser = argparse.ArgumentParser(prog="python -m tests.attack.full_disk", description=__doc__)
    parser.add_argument("--only", nargs="*", default=[""], help="commands whose name holds one of these")
    parser.add_argument("--most", type=int, help="places of each command, drawn; all where it is left out")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng, faults = np.random.default_rng(given.seed), 0
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="full-disk") as name:
        work = Path(name)
        library = build(work)
        if library is None:
            sys.exit("no C compiler to build what lets calls fail")
        for writer in writers(partial(finished, work / "made")):
            if any(word in writer.name for word in given.only):
                tried, wrong = attack(Attempts(writer, work / "tried", library), given.most, rng)
                counts, faults = counts + tried, faults + wrong
                shutil.rmtree(work / "tried")
    print(f"{sum(counts.values())} places: {dict(counts)}; {faults} with a fault")
    return int(bool(faults))


def attack(attempts: Attempts, most: int | None, rng: np.random.Generator) -> tuple[Counter[str], int]:
    """Try a command at its places; what became of them, and how many have a fault."""
    places, faults = places_in(attempts.log), 0
    tried: Counter[str] = Counter()
    for k, place in enumerate(chosen(places, most, rng)):
        number, once = (errno.ENOSPC, errno.EDQUOT)[k % 2], k % 3 == 2
        outcome, wrong = attempts.attack(place, number, once)
        tried[outcome] += 1
        faults += bool(wrong)
        for text in wrong:
            what = f"{attempts.writer.name}, {place.call} {place.path} ({place.number}), {os.strerror(number)}"
            print(f"FAULT {what}{', once' * once}: {text}", flush=True)
    print(
        f"{attempts.writer.name:20s} {len(places):4d} places, {sum(tried.values()):3d} tried: {dict(tried)}", flush=True
    )
    return tried, faults


if __name__ == "__main__":
    sys.exit(main())
