"""What a run trains, evaluates and tries: the name of each unit, and the settings that it depends on.

So a larger grid keeps what is done: every unit has its own artifact and its own key.
"""

from pathlib import Path

from piegraph_cli.dynamics.params import ModelParams, TrainParams, trained_label
from piegraph_cli.environments import check_options
from piegraph_cli.evaluation.params import EvaluateParams, ModelEvaluateParams
from piegraph_cli.params import validated
from piegraph_cli.planning.params import PlanParams, TrialParams, TrialsParams
from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.recipe import Recipe, load_recipe

_QUESTION = {"env", "state", "goal", "goal_pose", "model", "strokes", "success", "episodes", "seed"}
"""Settings of `plan` that the grid gives."""


def model_name(label: str, seed: int) -> str:
    """`pgnd@20.seed1`; or `static` alone, where nothing is trained."""
    return label if trained_label(label) is None else f"{label}.seed{seed}"


def split_model(name: str) -> tuple[str, int]:
    """Label and seed of a `model_name`; seed 0 where there is none."""
    label, _, seed = name.partition(".seed")
    return label, int(seed or 0)


def trained_name(name: str) -> str | None:
    """The trained model that a model uses: `piegraph.seed1` for `piegraph-ng.seed1`; None where nothing is trained."""
    label, seed = split_model(name)
    own = trained_label(label)
    return None if own is None else model_name(own, seed)


def trained_names(params: TrainParams) -> list[str]:
    """What a run trains."""
    return list(dict.fromkeys(model_name(label, seed) for label in params.models for seed in params.seeds))


def model_params(params: TrainParams, name: str) -> ModelParams:
    """The settings of one trained model."""
    label, seed = split_model(name)
    return ModelParams(
        label=label,
        seed=seed,
        settings=params.of(label),
        checkpoint_every=params.checkpoint_every,
        tensorboard=params.tensorboard,
    )


def evaluated_names(params: EvaluateParams, train: TrainParams) -> list[str]:
    """What a run evaluates: its models, from every seed that they are trained from."""
    return list(dict.fromkeys(model_name(label, seed) for label in params.models for seed in train.seeds))


def evaluate_params(params: EvaluateParams, name: str) -> ModelEvaluateParams:
    """The settings of one evaluation."""
    return ModelEvaluateParams(label=split_model(name)[0], **params.model_dump(exclude={"models"}))


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

    Planning settings are those of the trained run's recipe, where it has one; where that trains from several seeds, the
    starts take turns with them. Raises `UsageError` for options that the
    environment does not have.
    """
    env, model, goal, seed = split_name(name)
    path = trained / env / "recipe.toml"
    recipe = load_recipe(path) if path.is_file() else Recipe()
    kept, learned = recipe.params(STAGES["plan"]), recipe.params(STAGES["train"])
    assert isinstance(learned, TrainParams)
    settings = kept.model_dump(exclude=_QUESTION) | {k: v for k, v in params.plan.items() if k not in _QUESTION}
    if model == "greedy":
        settings |= {"model": "static", "planner": "greedy"}
    else:
        settings["model"] = model
    settings["options"] = kept.options | _options_of(params, env)  # type: ignore[attr-defined]
    check_options(env, settings["options"])
    for interpreter in ("daxbench_python", "daxbench_repo"):
        given = getattr(params, interpreter) or settings[interpreter]
        settings[interpreter] = given if env.startswith("daxbench-") else None
    settings |= {"env": env, "strokes": params.strokes, "success": min(params.thresholds)}
    plan = validated(PlanParams, settings, "plan", "trials.plan", "piegraph plan --help")
    own = trained_name(model_name(model, learned.seeds[seed % len(learned.seeds)]))
    network = trained / env / "model" / f"{own}.h5" if own else None
    return TrialParams(goal=goal, seed=seed, network=network, plan=plan)


def split_name(name: str) -> tuple[str, str, int, int]:
    """Environment, model, number of the goal and of the start of a trial, from its name."""
    env, model, goal, seed = name.split(".")
    return env, model, int(goal.removeprefix("goal")), int(seed.removeprefix("seed"))


def _options_of(params: TrialsParams, env: str) -> dict[str, float | str]:
    """The options `ENV.NAME` for one environment; those without an ENV are for all of them."""
    split = {name: name.rpartition(".") for name in params.options}
    return {option: params.options[name] for name, (of, _, option) in split.items() if of in ("", env)}
