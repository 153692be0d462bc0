"""The changes that mutation testing makes: they are changes, one each, and what a test need not notice stays as it is."""

import ast

import pytest

from tests.mutation.operators import mutants_of, mutated
from tests.mutation.run import NOTICED, STOPPED, SURVIVED, TESTS, choose, modules, read, report, selection_of, settled

SOURCE = '''
"""Not 1 + 1."""
import logging

Alias = tuple[int, int]
LIMIT: int = 3


def closest(values: list[float], to: float = 0.5, *, signed: bool = False) -> float:
    """Not 2."""
    log.info("at most %s", 4)
    found = [v - to for v in values[1:] if v > 0]
    if len(found) < LIMIT and not signed:
        raise ValueError(f"only {len(found) + 1} of 5")
    return min(found, key=abs)
'''


def of(kind: str) -> list[tuple[str, str]]:
    """Before and after of every change of a kind."""
    return [(m.before, m.after) for place in mutants_of("a.py", SOURCE) for m in place if m.kind.startswith(kind)]


@pytest.mark.parametrize(
    ("kind", "before", "after"),
    [
        ("comparison", "v > 0", "v >= 0"),
        ("arithmetic", "v - to", "v + to"),
        ("constant", "3", "4"),
        ("constant", "False", "True"),
        ("constant", "0.5", "1.0"),
        ("slice", "1:", ":"),
        ("name", "min", "max"),
        ("and, or", "len(found) < LIMIT and (not signed)", "len(found) < LIMIT or not signed"),
        ("condition left out", "len(found) < LIMIT and (not signed)", "not signed"),
        ("sign or not", "not signed", "signed"),
        ("filter left out", "for v in values[1:] if v > 0", "for v in values[1:]"),
        ("argument left out", "min(found, key=abs)", "min(found)"),
        ("result turned", "return min(found, key=abs)", "return -min(found, key=abs)"),
    ],
)
def test_mistakes_of_each_kind_are_made(kind, before, after):
    assert (before, after) in [(b.strip(), a.strip()) for b, a in of(kind)]


def test_text_messages_logs_annotations_and_types_stay():
    every = [m for place in mutants_of("a.py", SOURCE) for m in place]
    assert {m.line for m in every if m.kind.startswith("constant")} == {6, 9, 12}
    assert not any(m.line in (5, 11, 14) for m in every)


def test_each_change_is_another_whole_module_and_has_its_own_name():
    every = [m for place in mutants_of("a.py", SOURCE) for m in place]
    texts = [mutated(SOURCE, m) for m in every]
    plain = ast.unparse(ast.parse(SOURCE))
    assert all(text != plain for text in texts)
    assert len({m.name for m in every}) == len(every) > 20
    assert len(set(texts)) > 0.9 * len(texts)
    for text in texts:
        compile(text, "a.py", "exec")


def test_a_smaller_sample_is_the_beginning_of_a_larger_one():
    sources = {"a.py": SOURCE, "b.py": SOURCE}
    names = [[m.name for m in choose(sources, count, seed)] for count, seed in ((5, 0), (12, 0), (5, 1))]
    assert names[0] == names[1][:5]
    assert names[0] != names[2]


def test_the_sample_stays_where_other_code_changes():
    more = SOURCE + "\n\ndef another(value: float) -> float:\n    return value * 2 + 1\n"
    before = [m.name for m in choose({"a.py": SOURCE}, 12, 0)]
    after = [m.name for m in choose({"a.py": more}, 16, 0) if m.function != "another"]
    assert before[: len(after)] == after[:12]
    assert len(after) >= 12


def test_arguments_that_a_function_needs_are_not_left_out():
    code = "def f(a, b):\n    return a\n\n\ndef g(x):\n    return f(x, 1), np.sum(x, 1)\n"
    left = [
        m.before for place in mutants_of("a.py", code, frozenset({"f"})) for m in place if m.kind == "argument left out"
    ]
    assert left == ["np.sum(x, 1)"]


def test_every_module_has_its_tests():
    found = modules("")
    assert "planning/search.py" in found
    assert "evaluation/figures.py" not in found
    assert all(any(path.startswith(begin) for begin, _ in TESTS) for path in found)
    assert selection_of("planning/search.py")[0] == "tests/planning"
    assert modules("planning/sear") == ["planning/search.py"]


def test_what_is_known_holds_until_the_module_or_for_survivors_the_tests_change(tmp_path):
    record = tmp_path / "results.jsonl"
    record.write_text('{"name": "x", "outcome": "survived"}\n{"name": "x", "outcome": "noticed"}\n{"name": "y", "outc')
    assert read(record) == {"x": {"name": "x", "outcome": "noticed"}}
    for outcome, again in ((NOTICED, True), (STOPPED, True), (SURVIVED, False)):
        row = {"outcome": outcome, "source": "s", "tests": "t"}
        assert settled(row, "s", "t")
        assert not settled(row, "other", "t")
        assert settled(row, "s", "other") == again
    assert not settled(None, "s", "t")


def test_the_report_counts_by_room_and_lists_what_survived():
    chosen = choose({"planning/a.py": SOURCE, "stages/b.py": SOURCE}, 10, 0)
    known = {
        m.name: {"name": m.name, "line": 1, "outcome": SURVIVED if k < 2 else NOTICED} for k, m in enumerate(chosen)
    }
    lines, left = report(chosen, known)
    assert left == 2
    assert "8 of 10 noticed or shown equivalent: 80 %" in lines
    assert [line.split()[0] for line in lines[1:4]] == ["planning", "stages", "all"]
    assert lines[3].split()[1:] == ["10", "8", "0", "0", "2"]
    assert lines[-2:] == sorted(f"    1  {m.name}" for m in chosen[:2])
