"""Two processes that change one run at a time with different settings: what one keeps of the other's, and what is said."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from piegraph_cli.workspace.execute import Outcome
from piegraph_cli.workspace.recipe import Recipe, load_recipe
from piegraph_cli.workspace.run import Run
from piegraph_cli.workspace.stage import Stage

log = logging.getLogger("piegraph")


def keep_settings(run: Run, stage: Stage, before: Recipe) -> None:
    """Keep a stage's settings in the run's recipe, beside what others changed there since it was read as `before`."""
    path = run.folder / "recipe.toml"

    def kept() -> Recipe:
        return load_recipe(path, run.recipe.table) if path.exists() else before

    if path.exists() and kept() == run.recipe:
        return  # a run that cannot be written is one that nothing changes
    with run.lock(path.name):
        now = kept()
        if now != before:
            changed = _changed(now, before, stage.name)
            if changed:
                what = f"another piegraph has changed {changed} meanwhile, which is as this command has it now"
                log.warning("%s: %s", path, what)
            own = {name: of for name, of in run.recipe.sections.items() if name == stage.name}
            run.recipe = replace(now, sections=now.sections | own)
        run.save_recipe()


def tell_changes(run: Run, outcomes: Sequence[Outcome]) -> None:
    """Say what another process made meanwhile in the place of what was made here, with other settings or inputs."""
    now = Run(run.folder, run.recipe)
    made = [o for o in outcomes if not o.error]
    lost = [o for o in made if not now.fresh(now.recipe.table[o.stage], o.unit)]
    if lost:
        names = ", ".join(f"{o.stage} {o.unit}" if o.unit else o.stage for o in lost)
        log.warning("%s: another piegraph has made this with other settings meanwhile: %s", run.folder, names)


def tell_recipe(folder: Path, recipe: Recipe) -> None:
    """Say where the run has another recipe by now than the one that it was given."""
    path = folder / "recipe.toml"
    now = load_recipe(path, recipe.table) if path.exists() else recipe
    changed = ", ".join(filter(None, (_changed(now, recipe, name) for name in recipe.table)))
    if changed:
        log.warning(
            "%s: another piegraph has changed %s meanwhile: `piegraph status` shows what is stale", path, changed
        )


def _changed(now: Recipe, before: Recipe, stage: str) -> str:
    """The settings of a stage that differ, by their names."""
    one, other = (_flat(recipe.sections.get(stage, {})) for recipe in (now, before))
    names = sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))
    return ", ".join(f"{stage}.{name}" for name in names)


def _flat(section: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in section.items():
        found |= {f"{name}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {name: value}
    return found
