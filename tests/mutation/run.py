"""Do the tests notice a mistake? Makes small changes to the code, one at a time, and counts those that a test fails on.

    python -m tests.mutation.run --sample 150 --seed 0

Works on a copy of the tree, never on the tree itself. Every change is one line in the results; run again after an
interruption, or after writing tests, and only what is not known yet is done. See docs/testing.md.
"""

import argparse
import hashlib
import json
import os
import shutil
import signal
import sys
import time
from collections import Counter
from pathlib import Path

from tests.mutation.operators import Mutant, mutants_of, mutated, strict_functions

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "piegraph_cli"
MODULES = (
    "evaluation",
    "experiments",
    "dynamics/models.py",
    "dynamics/examples.py",
    "dynamics/dataset.py",
    "dynamics/cutting.py",
    "planning",
    "workspace",
    "stages",
)
PICTURES = ("figures.py", "trial_figures.py", "overlays.py", "top_view.py", "colors.py", "view.py")
"""What people look at: a test need not notice that a line is wider."""
TESTS = (
    ("evaluation", ("tests/evaluation", "tests/experiments")),
    ("experiments", ("tests/experiments", "tests/test_experiments.py")),
    ("dynamics", ("tests/dynamics", "tests/stages/test_splits.py")),
    ("planning", ("tests/planning", "tests/stages/test_trial_distances.py")),
    ("workspace", ("tests/workspace", "tests/experiments", "tests/stages/test_trial_distances.py")),
    (
        "stages",
        ("tests/stages", "tests/evaluation/test_windows.py", "tests/planning", "tests/physics/test_track_settings.py"),
    ),
)
"""By the beginning of a module's path, the tests that it is to be noticed by."""
ROOMS = ("dynamics", "evaluation", "experiments", "planning", "stages", "workspace")
EVERYTHING = (*(f"tests/{room}" for room in ROOMS), "tests/test_experiments.py")
"""What is run, beside those, where those did not notice."""
LONG = ("test_every_trained_model_learns_and_goes_on_from_its_state",)
PROGRAMS = ("piegraph", "piegraph_json", "subprocess", "Popen", "tiny_run", "sample_run", "sam_checkpoint")
"""Tests that call or need one of these start programs, or train for long: they are left out, for they take minutes."""
EASE, FACTOR = 10.0, 3.0
"""Seconds, and times what all tests take without a change, after which they are stopped: they would go on for ever."""
NOTICED, SURVIVED, STOPPED = "noticed", "survived", "stopped"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, default=150, help="changes to make, chosen at random (default: 150)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the choice (default: 0)")
    parser.add_argument("--only", default="", help="modules whose path begins so, as in planning/search")
    parser.add_argument("--jobs", type=int, default=1, help="processes that work at a time (default: 1)")
    parser.add_argument("--results", type=Path, default=ROOT / ".mutants", help="folder of results (default: .mutants)")
    parser.add_argument("--list", action="store_true", help="show the changes and make none")
    given = parser.parse_args()
    sources = {path: (ROOT / PACKAGE / path).read_text() for path in modules(given.only)}
    chosen = choose(sources, given.sample, given.seed)
    if given.list:
        for mutant in chosen:
            print(f"{mutant.line:5d}  {mutant.name}")
        return
    given.results.mkdir(exist_ok=True)
    record = given.results / "results.jsonl"
    tests = fingerprint(sorted((ROOT / "tests").rglob("*.py")))
    known = read(record)
    open_ = [m for m in chosen if not settled(known.get(m.name), digest(sources[m.module]), tests)]
    print(f"{len(chosen)} changes, {len(chosen) - len(open_)} of them known", file=sys.stderr)
    work(open_, sources, tests, record, given)
    lines, left = report(chosen, read(record))
    print("\n".join(lines))
    sys.exit(1 if left else 0)


def modules(only: str) -> list[str]:
    """Paths of the modules to change, within the package."""
    found = []
    for place in MODULES:
        path = ROOT / PACKAGE / place
        files = [path] if path.is_file() else sorted(path.rglob("*.py"))
        found += [file.relative_to(ROOT / PACKAGE).as_posix() for file in files if file.name not in PICTURES]
    return [path for path in found if path.startswith(only)]


def choose(sources: dict[str, str], count: int, seed: int) -> list[Mutant]:
    """A sample of places, one change at each; the sample of a smaller number is the beginning of that of a larger.

    A place is drawn by its own name, so that the sample stays as it is where other code changes.
    """
    files = (ROOT / PACKAGE).rglob("*.py")
    strict = frozenset(name for file in files for name in strict_functions(file.read_text()))
    places = [place for path, source in sources.items() for place in mutants_of(path, source, strict)]
    drawn = sorted((digest(f"{seed} {place[0].name}"), place) for place in places)
    return [place[int(number, 16) % len(place)] for number, place in drawn[:count]]


def selection_of(module: str) -> tuple[str, ...]:
    """The tests that a module is to be noticed by first."""
    return next((paths for begin, paths in TESTS if module.startswith(begin)), EVERYTHING)


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def fingerprint(files: list[Path]) -> str:
    """What tells one set of files from another."""
    return digest("".join(f"{file}\0{file.read_text()}\0" for file in files if file.is_file()))


def read(record: Path) -> dict[str, dict]:
    """The last result of each change; a line that was cut off is none."""
    found = {}
    for line in record.read_text().splitlines() if record.exists() else []:
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        found[row["name"]] = row
    return found


def settled(row: dict | None, source: str, tests: str) -> bool:
    """Whether a result still holds: the module is the same, and the tests are or had noticed it."""
    return row is not None and row["source"] == source and (row["outcome"] != SURVIVED or row["tests"] == tests)


def work(open_: list[Mutant], sources: dict[str, str], tests: str, record: Path, given: argparse.Namespace) -> None:
    """Try the changes, in as many processes as asked for."""
    if not open_:
        return
    preload()
    limit = limit_of(given.results / "tree0")
    workers = []
    for k in range(min(given.jobs, len(open_))):
        pid = os.fork()
        if pid == 0:
            try_all(open_[k :: given.jobs], sources, tests, limit, record, given.results / f"tree{k}")
            os._exit(0)
        workers.append(pid)
    for pid in workers:
        os.waitpid(pid, 0)


def limit_of(tree: Path) -> float:
    """The time (s) after which tests are stopped, from what all of them take; they have to pass without a change."""
    copy_tree(tree)
    every = dict.fromkeys((*EVERYTHING, *(path for _, paths in TESTS for path in paths)))
    passed, seconds, said = run_tests(tree, tuple(every), 1800.0)
    if not passed:
        sys.exit(f"the tests fail without a change:\n{said[-3000:]}")
    print(f"the tests take {seconds:.0f} s without a change", file=sys.stderr, flush=True)
    return EASE + FACTOR * seconds


def preload() -> None:
    """Import what takes long and is not ours, once: every trial of a change begins as a fork of this process."""
    os.environ |= {"OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1", "MPLBACKEND": "agg"}
    sys.dont_write_bytecode = True
    import cv2  # noqa: F401
    import h5py  # noqa: F401
    import hypothesis  # noqa: F401
    import matplotlib.figure  # noqa: F401
    import open3d  # noqa: F401
    import pydantic  # noqa: F401
    import pytest  # noqa: F401
    import scipy.optimize
    import scipy.spatial  # noqa: F401
    import torch

    torch.set_num_threads(1)


def try_all(open_: list[Mutant], sources: dict[str, str], tests: str, limit: float, record: Path, tree: Path) -> None:
    """Try changes in a copy of the tree, and note what became of each."""
    copy_tree(tree)
    for number, mutant in enumerate(open_, 1):
        target = tree / PACKAGE / mutant.module
        begin, outcome, said = time.monotonic(), SURVIVED, ""
        first = selection_of(mutant.module)
        for options in (first, (*EVERYTHING, *(f"--ignore={path}" for path in first))):
            target.write_text(mutated(sources[mutant.module], mutant))
            passed, seconds, said = run_tests(tree, options, limit)
            target.write_text(sources[mutant.module])
            if not passed:
                outcome = STOPPED if seconds >= limit else NOTICED
                break
        seconds = time.monotonic() - begin
        by = next((line.split(" - ")[0][7:] for line in said.splitlines() if line.startswith(("FAILED", "ERROR "))), "")
        row = {"name": mutant.name, "line": mutant.line, "outcome": outcome, "by": by, "seconds": round(seconds, 1)}
        with record.open("a") as file:
            file.write(json.dumps(row | {"source": digest(sources[mutant.module]), "tests": tests}) + "\n")
        print(f"{number:4d}/{len(open_)} {outcome:9s} {seconds:5.1f} s  {mutant.name}", file=sys.stderr, flush=True)


def copy_tree(tree: Path) -> None:
    """A fresh copy of what the tests need."""
    shutil.rmtree(tree, ignore_errors=True)
    unneeded = shutil.ignore_patterns("__pycache__", "*.pyc")
    for name in (PACKAGE, "tests", "pipelines", "sample_data", "docs"):
        shutil.copytree(ROOT / name, tree / name, ignore=unneeded)
    for name in ("pyproject.toml", "Makefile", "README.md"):
        shutil.copy(ROOT / name, tree / name)


def run_tests(tree: Path, chosen: tuple[str, ...], limit: float) -> tuple[bool, float, str]:
    """Whether tests pass in a copy of the tree, how long they took (s), and what they said."""
    said, begin = tree / "said.txt", time.monotonic()
    shutil.rmtree(tree / ".hypothesis", ignore_errors=True)
    pid = os.fork()
    if pid == 0:
        _be_pytest(tree, chosen, said)
    status = None
    while status is None and time.monotonic() - begin < limit:
        done, code = os.waitpid(pid, os.WNOHANG)
        status = os.waitstatus_to_exitcode(code) if done else None
        time.sleep(0.02)
    seconds = time.monotonic() - begin
    if status is None:
        os.killpg(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    return status == 0, seconds, said.read_text(errors="replace") if said.exists() else ""


def _be_pytest(tree: Path, chosen: tuple[str, ...], said: Path) -> None:
    """Turn this process, a fork, into a run of the tests."""
    code = 3
    try:
        os.setsid()
        os.chdir(tree)
        out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        os.environ["PYTHONPATH"] = str(tree)
        sys.path[:] = [str(tree), *(p for p in sys.path if p not in ("", str(ROOT)))]
        for name in [name for name in sys.modules if name.partition(".")[0] == "tests"]:
            del sys.modules[name]
        import pytest

        options = ["-x", "-q", "--no-header", "--tb=no", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
        code = int(pytest.main([*options, *chosen], plugins=[Quick()]))
    except BaseException as error:
        print(f"ERROR {type(error).__name__}: {error}")
    sys.stdout.flush()
    os._exit(code)


class Quick:
    """Leaves out tests that take long."""

    def pytest_collection_modifyitems(self, config, items) -> None:
        """Keep those that call nothing and need nothing of `PROGRAMS`."""
        items[:] = [item for item in items if not self.takes_long(item)]

    @staticmethod
    def takes_long(item) -> bool:
        uses = {*item.fixturenames, *item.function.__code__.co_names, *item.function.__code__.co_freevars}
        return bool(uses & set(PROGRAMS)) or item.originalname in LONG


def report(chosen: list[Mutant], known: dict[str, dict]) -> tuple[list[str], int]:
    """The figures for people, and how many changes were neither noticed nor named as equivalent."""
    named = tomllib.loads((Path(__file__).parent / "equivalent.toml").read_text())
    rows = [known[m.name] for m in chosen if m.name in known]
    survivors = [row for row in rows if row["outcome"] == SURVIVED]
    left = [row for row in survivors if row["name"] not in named]
    lines = [f"{'room':12s} {'changes':>8s} {'noticed':>8s} {'stopped':>8s} {'equivalent':>11s} {'survived':>9s}"]
    rooms = dict.fromkeys(row["name"].partition("/")[0] for row in rows)
    for room in (*sorted(rooms), ""):
        own = [row for row in rows if not room or row["name"].startswith(f"{room}/")]
        counts = Counter(
            "equivalent" if row["outcome"] == SURVIVED and row["name"] in named else row["outcome"] for row in own
        )
        figures = [counts[outcome] for outcome in (NOTICED, STOPPED, "equivalent", SURVIVED)]
        lines.append(
            f"{room or 'all':12s} {len(own):8d} {figures[0]:8d} {figures[1]:8d} {figures[2]:11d} {figures[3]:9d}"
        )
    good = len(rows) - len(left)
    lines.append(f"{good} of {len(rows)} noticed or shown equivalent: {100 * good / max(1, len(rows)):.0f} %")
    lines += ["", "survived:"] if left else []
    lines += [f"{row['line']:5d}  {row['name']}" for row in sorted(left, key=lambda row: row["name"])]
    return lines, len(left)


if __name__ == "__main__":
    main()
