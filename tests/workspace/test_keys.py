"""Keys: those of the demo recipe stay what they are, and settings that change no result change no key."""

import json
from pathlib import Path

import pytest

from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.execute import Options, run_stage
from piegraph_cli.workspace.recipe import Recipe, load_recipe
from piegraph_cli.workspace.run import Run
from tests.cli import REPOSITORY

GOLDEN = Path(__file__).parent / "golden_keys.json"


def keys_of_the_demo(folder: Path) -> dict[str, dict[str, str]]:
    """By stage, the keys of a run of the demo recipe in which nothing is made yet."""
    run = Run(folder, load_recipe(REPOSITORY / "pipelines" / "demo.toml", STAGES))
    return {stage.name: {str(unit): run.key(stage, unit) for unit in run.units(stage)} for stage in run.chain}


def test_keys_of_the_demo_stay(tmp_path):
    """A key that changes makes every user's artifacts stale: only a stage's version, settings or sources may change it.

    Where that is meant, `python -m tests.workspace.test_keys` writes the golden file anew.
    """
    golden, found = json.loads(GOLDEN.read_text()), keys_of_the_demo(tmp_path / "run")
    assert found.keys() == golden["keys"].keys()
    for name, keys in found.items():
        assert STAGES[name].version == golden["versions"][name], f"{name} has a new version: write the golden file anew"
        assert keys == golden["keys"][name], name


def simulated(folder: Path, **settings) -> Run:
    return Run(folder, Recipe(STAGES, {"simulate": settings}))


def test_further_sequences_keep_those_that_are_done(tmp_path):
    settings = {"environment": "tblock", "strokes": 1, "particles": 20}
    run_stage(simulated(tmp_path, **settings, sequences=2), STAGES["simulate"], Options())
    outcomes = run_stage(simulated(tmp_path, **settings, sequences=3), STAGES["simulate"], Options())
    assert [o.state for o in outcomes] == ["cached", "cached", "done"]


@pytest.mark.parametrize("stage", ["simulate", "plan"])
@pytest.mark.parametrize(
    "changes",
    [
        {"options": {"timeout": "30"}},
        {"options": {"python": "/elsewhere/bin/python", "repo": "/elsewhere"}},
        {"daxbench_python": "/usr/bin/python3.11"},
        {"daxbench_python": "../bin/python", "daxbench_repo": "./DaXBench"},
    ],
)
def test_how_daxbench_is_run_is_no_part_of_a_key(tmp_path, stage, changes):
    name = {"simulate": "environment", "plan": "env"}[stage]
    given = {name: "daxbench-rope", "daxbench_python": "/usr/bin/python3"}

    def key(more: dict) -> str:
        run = Run(tmp_path, Recipe(STAGES, {"simulate": {}} | {stage: given | more}))
        return run.key(STAGES[stage], run.units(STAGES[stage])[0])

    assert key(changes) == key({})
    assert key({"options": {"stiffness": 2.0}}) != key({})


def test_keys_do_not_depend_on_where_the_run_is(tmp_path):
    first, second = (keys_of_the_demo(tmp_path / name) for name in ("a", "b/c"))
    assert first == second


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as temporary:
        keys = keys_of_the_demo(Path(temporary) / "run")
    GOLDEN.write_text(json.dumps({"versions": {n: STAGES[n].version for n in keys}, "keys": keys}, indent=1) + "\n")
    print(f"wrote {GOLDEN.relative_to(REPOSITORY)}")
