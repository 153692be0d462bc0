"""The grid of a run's trials: the name of each, and the settings it depends on; so that a larger grid keeps what is done."""

from pathlib import Path

from piegraph_cli.environments import check_options
from piegraph_cli.params import PlanParams, TrialParams, TrialsParams
from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.recipe import Recipe, load_recipe

UNTRAINED = ("static", "greedy")
"""What needs no trained network."""

_QUESTION = {"env", "state", "goal", "goal_pose", "model", "strokes", "success", "episodes", "seed"}
"""Settings of `plan` that the grid gives."""


def trial_names(params: TrialsParams) -> list[str]:
    """`tblock.piegraph.goal00.seed03` and so on, models innermost: what is done first can be compared first."""
    return [
        f"{env}.{model}.goal{goal:02d}.seed{seed:02d}"
        for env in dict.fromkeys(params.envs)
        for goal in range(params.goals)
        for seed in range(params.seeds)
        for model in dict.fromkeys(params.models)
    ]


def trial_params(params: TrialsParams, name: str, trained: Path) -> TrialParams:
    """The settings of one trial of the grid, where `trained` holds a trained run per environment.

    Planning settings are those of the trained run's recipe, where it has one. Raises `UsageError` for options that the
    environment does not have.
    """
    env, model, goal, seed = split_name(name)
    recipe = trained / env / "recipe.toml"
    kept = (load_recipe(recipe) if recipe.is_file() else Recipe()).params(STAGES["plan"])
    settings = kept.model_dump(exclude=_QUESTION)
    if model == "greedy":
        settings |= {"model": "static", "planner": "greedy"}
    else:
        settings["model"] = model
    settings["options"] = kept.options | _options_of(params, env)  # type: ignore[attr-defined]
    check_options(env, settings["options"])
    for interpreter in ("daxbench_python", "daxbench_repo"):
        given = getattr(params, interpreter) or settings[interpreter]
        settings[interpreter] = given if env.startswith("daxbench-") else None
    plan = PlanParams(env=env, strokes=params.strokes, success=min(params.thresholds), **settings)  # type: ignore[arg-type]
    network = None if model in UNTRAINED else trained / env / "model.h5"
    return TrialParams(goal=goal, seed=seed, network=network, plan=plan)


def split_name(name: str) -> tuple[str, str, int, int]:
    """Environment, model, number of the goal and of the start of a trial, from its name."""
    env, model, goal, seed = name.split(".")
    return env, model, int(goal.removeprefix("goal")), int(seed.removeprefix("seed"))


def _options_of(params: TrialsParams, env: str) -> dict[str, float | str]:
    """The options `ENV.NAME` for one environment; those without an ENV are for all of them."""
    split = {name: name.rpartition(".") for name in params.options}
    return {option: params.options[name] for name, (of, _, option) in split.items() if of in ("", env)}
