"""What is written down about settings, stages and artifacts stays: names, defaults, bounds, versions, types and units."""

import importlib
import json
from dataclasses import astuple
from pathlib import Path
from typing import Any

import pytest

import piegraph_cli
from piegraph_cli.params import Params
from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.schema import FIXED_AXES, SCHEMAS

GOLDEN = Path(__file__).parent / "golden_schemas.json"
WORDS = ("title", "description")


def settings_of(params: type[Params]) -> dict[str, Any]:
    """By name, what a setting may be, and what it is where nobody gives it; without words."""

    def plain(part: Any) -> Any:
        if isinstance(part, dict):
            return {name: plain(inner) for name, inner in part.items() if name not in WORDS}
        return [plain(inner) for inner in part] if isinstance(part, list) else part

    schema = params.model_json_schema()
    return {
        name: plain(found) | {"needed": name in schema.get("required", ())}
        for name, found in schema["properties"].items()
    }


def all_settings() -> dict[str, dict[str, Any]]:
    """Those of every class of every room."""
    files = Path(piegraph_cli.__file__).parent.glob("*/params.py")
    rooms = [importlib.import_module(f"piegraph_cli.{file.parent.name}.params") for file in sorted(files)]
    found = {one for room in rooms for one in vars(room).values() if isinstance(one, type) and issubclass(one, Params)}
    by_name = {f"{one.__module__.split('.')[-2]}.{one.__name__}": one for one in found - {Params}}
    return {name: settings_of(by_name[name]) for name in sorted(by_name)}


def all_stages() -> dict[str, dict[str, Any]]:
    """What of their records is in keys, recipes and names of files."""
    return {
        name: {
            "version": stage.version,
            "reads": [*stage.reads, *(f"{artifact}?" for artifact in stage.optional)],
            "writes": stage.writes,
            "settings": stage.params.__name__,
            "on demand": stage.on_demand,
        }
        for name, stage in STAGES.items()
    }


def all_artifacts() -> dict[str, dict[str, Any]]:
    found = {name: {dataset: list(astuple(field)) for dataset, field in of.items()} for name, of in SCHEMAS.items()}
    return found | {"axes": dict(FIXED_AXES)}


def found() -> dict[str, dict[str, dict[str, Any]]]:
    return json.loads(json.dumps({"settings": all_settings(), "stages": all_stages(), "artifacts": all_artifacts()}))


@pytest.mark.parametrize("what", ["settings", "stages", "artifacts"])
def test_what_is_written_down_stays(what):
    """A default that moves makes every artifact of its stage stale and gives old recipes another meaning; so does a version,
    which is raised where a stage's output changes; and a dataset of another type cannot be read from older files.

    Where a change is meant, `python -m tests.workspace.test_schemas` writes the golden file anew.
    """
    golden, now = json.loads(GOLDEN.read_text())[what], found()[what]
    assert now.keys() == golden.keys()
    for name, part in now.items():
        assert part == golden[name], name


def test_bounds_in_the_wrong_order_are_refused():
    from piegraph_cli.planning.params import PlanParams

    for name, wrong in (("workspace", (0, 1, 1, 1, 0, 1)), ("workspace", (1, 0, 0, 1, 0, 1)), ("min_length", 0.14)):
        with pytest.raises(ValueError, match="is not below"):
            PlanParams(**{name: wrong})
    assert PlanParams(min_length=0.1399).min_length == 0.1399


def lines(of: dict[str, Any], depth: int = 0) -> str:
    """JSON with a line per setting, so that a change of one is a change of one line."""
    if depth == 3:
        return json.dumps(of)
    pad = " " * (depth + 1)
    return (
        "{\n"
        + ",\n".join(
            f"{pad}{json.dumps(n)}: {lines(inner, depth + 1) if isinstance(inner, dict) else json.dumps(inner)}"
            for n, inner in of.items()
        )
        + "\n"
        + " " * depth
        + "}"
    )


if __name__ == "__main__":
    GOLDEN.write_text(lines(found()) + "\n")
    print(f"wrote {GOLDEN}")
