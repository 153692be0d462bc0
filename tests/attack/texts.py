"""Recipes, settings of the command line, requests of `serve`, and what is kept beside a run as JSON."""

import functools
import io
import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from piegraph_cli.errors import DataError, PiegraphError
from piegraph_cli.files import refused
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.stages import STAGES
from tests.attack.engine import Attack
from tests.attack.mutators import ODD_TEXTS, ODD_VALUES, text_of
from tests.cli import SAMPLE
from tests.stages.make_recording import make_recording

if TYPE_CHECKING:
    from piegraph_cli.service.service import Service
    from piegraph_cli.workspace.recipe import Recipe

RECIPE = """
[ingest]
recording = "rec"
workspace = [-0.5, 0.5, -0.5, 0.5, -0.02, 0.3]
offsets = { front = 0.1 }

[segment.prompts]
front = [120, 80, 190, 140]

[segment.points]
left = [155, 110]

[dataset]
train = 2
validation = 1

[train]
models = ["piegraph", "rigid"]
seeds = [0, 1]

[train.piegraph]
steps = 40
hidden = 8

[evaluate]
horizons = [1, 2]

[plan]
env = "tblock"
samples = 12
goal_pose = [0.1, 0.2, 0.3]
"""


def _write(name: str, text: str, folder: Path) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def _read_recipe(path: Path) -> Any:
    from piegraph_cli.workspace.recipe import load_recipe

    return _used(load_recipe(path, STAGES), path.parent)


def _read_settings(path: Path) -> Any:
    return settled(path.read_bytes().decode("utf-8", "surrogateescape").split("\n")[:-1], path.parent)


def settled(lines: list[str], folder: Path) -> str:
    """As so many `--set` make it."""
    from piegraph_cli.workspace.recipe import Recipe, parse_setting

    recipe = Recipe(STAGES)
    for line in lines:
        stage, setting, value = parse_setting(line, STAGES)
        recipe = recipe.with_values(stage, {setting: value}, f"--set {line}", folder)
    return _used(recipe, folder)


def _used(recipe: "Recipe", folder: Path) -> str:
    """The settings, after a run has kept them, read them again, and listed what it makes."""
    from piegraph_cli.workspace.recipe import load_recipe
    from piegraph_cli.workspace.run import Run

    found = "\n".join(repr(recipe.params(stage)) for stage in recipe.chain())
    recipe.save(folder / "run.toml")
    again = load_recipe(folder / "run.toml", STAGES)
    assert found == "\n".join(repr(again.params(stage)) for stage in again.chain())
    try:
        run = Run(folder / "run", again)
        for stage in run.chain:
            for unit in run.units(stage)[:2]:
                run.key(stage, unit)
    except PiegraphError:  # what they name is not there
        return found.replace(str(folder), "")
    except OSError as error:  # as the program has it
        if told := refused(error, "run"):
            raise told from error
        raise
    return found.replace(str(folder), "")


ODD_SETTINGS = (
    *ODD_TEXTS, "1e8", "100000000", "9" * 4000, "9" * 5000, "-1", "0.5", "true", "''", "~", "[]", "{}", "[[[]]]", "[{}]",
    "[" * 3000, "{a=" * 2000, "{''=1}", "{a=1}", "x" * 300, "x" * 5000, '"\\u0000"', "\udcff", "/dev/zero", "[1, 1]",
    "[0, 0, 0, 0, 0, 0]", "[1e300, 1e300, 1e300]", "['a', 'a']", "1979-05-27", "a,b", "a=1,b=2", ";;", "a\rb",
)  # fmt: skip


def _any_setting(path: Path, rng: np.random.Generator) -> str:
    """One setting of any stage has an odd value."""
    of = [f"{name}.{setting}" for name, stage in STAGES.items() for setting in _settings_of(stage.params)]
    place, value = of[int(rng.integers(len(of)))], ODD_SETTINGS[int(rng.integers(len(ODD_SETTINGS)))]
    with path.open("ab") as file:
        file.write(f"{place}={value}\n".encode("utf-8", "surrogateescape"))
    return f"{place}={value[:20]!a}"


def _settings_of(params: type[BaseModel]) -> list[str]:
    """Their names, those of tables as TABLE.NAME."""
    found = []
    for name, field in params.model_fields.items():
        of, name = field.annotation, field.alias or name
        table = isinstance(of, type) and issubclass(of, BaseModel)
        found += [name, *(f"{name}.{inner}" for inner in _settings_of(of))] if table else [name]
    return found


SETTINGS = (
    "ingest.recording=rec\ntrack.stiffness=0.1\ntrain.piegraph.steps=500\nplan.samples=12\nevaluate.horizons=[1, 2]\n"
)


def _make_json(kind: str, folder: Path) -> Path:
    if kind == "cameras":
        return make_recording(folder / "rec", 1) / "cameras.json"
    return _write(f"{kind}.json", json.dumps(JSONS[kind]), folder)


CLOUD = np.random.default_rng(0).uniform([-0.1, -0.1, 0], [0.1, 0.1, 0.03], (60, 3)).round(4).tolist()
JSONS: dict[str, Any] = {
    "failures": {"track/s": {"key": "k", "message": "why"}},
    "plan": {"state": CLOUD, "goal_pose": [0.1, 0, 0.5], "candidates": 2, "settings": {"samples": 8, "horizon": 1}},
    "settings": {
        "state": CLOUD,
        "goal": CLOUD,
        "settings": {
            **{
                "samples": 4,
                "horizon": 2,
                "look_every": 1,
                "cem_iterations": 1,
                "noise": 0.1,
                "success": 0.01,
                "seed": 3,
            },
            **{"workspace": [-0.5, 0.5, -0.5, 0.5, -0.02, 0.3], "modes": ["push"], "cost": "chamfer", "table": 0.0},
            **{"min_length": 0.02, "max_length": 0.2, "strokes": 3, "accept": [], "frame": "world"},
        },
    },
    "info": {},
    "look": {"source": "sequence_0000:4", "cloud": True, "encoding": "lists"},
    "line": {"command": "predict", "state": CLOUD[:5], "strokes": [{"start": [-0.2, 0], "end": [0, 0]}]},
    "predict": {
        "state": CLOUD,
        "rest": CLOUD,
        "strokes": [{"start": [-0.2, 0.0], "end": [-0.02, 0.0], "mode": "push"}],
        "encoding": "base64",
    },
}


def _read_cameras(path: Path) -> Any:
    from piegraph_cli.recording.layout import read_cameras

    return [
        [getattr(c, name) for name in ("name", "width", "height", "K", "distortion")]
        for c in read_cameras(path.parent / "s")
    ]


@functools.cache
def _service() -> "Service":
    """One that has nothing to load, and looks at the sample."""
    from piegraph_cli.planning.model import Model
    from piegraph_cli.service.service import Eye, Service
    from piegraph_cli.service.setup import _recorded
    from piegraph_cli.stages.look import look_settings

    eye = Eye(look_settings(), partial(_recorded, SAMPLE), "the sample")
    return Service(Model("static", None, PlanParams(samples=8, cem_iterations=1)), eye=eye)


def read_request(path: Path) -> Any:
    """As `piegraph serve` takes it: what it calls a bug is one."""
    command = {"settings": "plan"}.get(path.stem, path.stem)
    return _answer(_service().reply(path.read_bytes(), command).text)


def _read_lines(path: Path) -> Any:
    """As `piegraph serve --stdio` takes it; whatever comes, the whole request after it is answered."""
    from piegraph_cli.service.stdio import serve_lines

    answers = io.BytesIO()
    serve_lines(_service(), io.BytesIO(path.read_bytes() + b'\n{"command": "info"}\n'), answers)
    *found, info = answers.getvalue().splitlines()
    assert json.loads(info)["error"] is None
    return [_answer(line) for line in found]


def _answer(text: bytes) -> Any:
    told = json.loads(text)
    if told["error"] and told["error"]["exit_code"] == PiegraphError.exit_code:
        raise RuntimeError(told["error"])
    if told["error"]:
        raise DataError(str(told["error"]))
    return {name: value for name, value in told["result"].items() if name != "seconds"}


def _any_request(path: Path, rng: np.random.Generator) -> str:
    """One setting of a plan has an odd value, or the request is damaged as any."""
    if rng.random() < 0.3:
        return text_of(path, rng)
    names, value = list(_settings_of(PlanParams)), json.loads(path.read_text())
    name, odd = names[int(rng.integers(len(names)))], ODD_VALUES[int(rng.integers(len(ODD_VALUES)))]
    path.write_text(json.dumps(value | {"settings": value["settings"] | {name: odd}}))
    return f"{name}: {str(odd)[:20]!a}"


def _read_failures(path: Path) -> Any:
    """As a run reads them, whatever they say: nobody is told of what cannot be read, and nothing stops."""
    from piegraph_cli.workspace.recipe import Recipe
    from piegraph_cli.workspace.run import Run

    run = Run(path.parent, Recipe(STAGES, {"simulate": {"sequences": 1}}))
    return [run.failure(stage, unit) for stage in run.chain for unit in run.units(stage)]


def texts() -> list[Attack]:
    """Recipes, settings of the command line, and JSON."""
    return [
        Attack("recipe", partial(_write, "recipe.toml", RECIPE), text_of, _read_recipe),
        Attack("settings", partial(_write, "settings.txt", SETTINGS), text_of, _read_settings),
        Attack("cameras.json", partial(_make_json, "cameras"), text_of, _read_cameras),
        Attack("failures.json", partial(_make_json, "failures"), text_of, _read_failures),
        Attack("any setting", partial(_write, "settings.txt", SETTINGS), _any_setting, _read_settings),
        Attack("request settings", partial(_make_json, "settings"), _any_request, read_request),
        *(
            Attack(f"request {n}", partial(_make_json, n), text_of, read_request)
            for n in ("plan", "predict", "info", "look")
        ),
        Attack("request line", partial(_make_json, "line"), text_of, _read_lines),
        Attack("splits", partial(_write, "split.csv", "a,train\nb,validation\nc,test\n"), text_of, _read_split),
    ]


def _read_split(path: Path) -> Any:
    from piegraph_cli.stages.dataset import _read_split as read_split

    return read_split(path)
