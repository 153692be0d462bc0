"""Doing what an experiment's runs lack, and writing its tables and pictures."""

import logging
from pathlib import Path
from typing import Any

from piegraph_cli.environments.params import SimulateParams
from piegraph_cli.errors import DataError, PiegraphError
from piegraph_cli.evaluation.tables import as_json
from piegraph_cli.experiments.figures import draw
from piegraph_cli.experiments.measured import write_strokes
from piegraph_cli.experiments.params import MEASURED, ExperimentParams
from piegraph_cli.experiments.recipes import recipe_of, recording_of, trial_recipe
from piegraph_cli.experiments.results import read_results
from piegraph_cli.experiments.tables import describe
from piegraph_cli.files import atomic_file
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.stages.simulate import record_sequences
from piegraph_cli.workspace.execute import Options, run_chain, run_stage
from piegraph_cli.workspace.recipe import SHIPPED, load_recipe

log = logging.getLogger("piegraph")


def run_experiment(name: str, params: ExperimentParams, folder: Path, options: Options) -> list[PiegraphError]:
    """Do what the experiment's runs under `folder` lack; returns what failed."""
    failed: list[PiegraphError] = []
    last = "train" if params.table == "search" else "evaluate"
    for environment in params.interactions:
        own, recording = folder / params.run_name(environment), recording_of(params, environment, folder)
        if environment == MEASURED:
            write_strokes(params.data, folder / "recordings" / environment)
        elif recording:
            _render(recording, params, environment, options.jobs)
        recipe = recipe_of(params, environment, recording)
        log.info("%s: %s", name, own)
        run = open_run(own, recipe)
        outcomes = run_chain(run, last, options)
        failed += [o.error for o in outcomes if o.error]
        run.save_recipe()
    for environment in params.interactions if params.trials else ():
        log.info("%s: %s", name, folder / name / environment)
        grid = open_run(folder / name / environment, trial_recipe(params, environment, folder))
        outcomes = run_stage(grid, STAGES["trials"], options)
        failed += [o.error for o in outcomes if o.error]
        grid.save_recipe()
    return failed


def _render(recording: Path, params: ExperimentParams, environment: str, jobs: int) -> None:
    shipped = load_recipe(SHIPPED / f"{environment}.toml", STAGES).params(STAGES["simulate"])
    assert isinstance(shipped, SimulateParams)
    count = params.training + params.validation + params.test
    settings = shipped.model_copy(update={"sequences": count, "strokes": params.strokes})
    record_sequences(recording, settings, jobs=jobs, force=False)


def write_report(name: str, params: ExperimentParams, folder: Path) -> tuple[dict[str, Any], list[str], list[Path]]:
    """The experiment's tables as an object and as lines, and its pictures; all are kept in `folder`/report.

    Raises `DataError` when nothing has been done yet.
    """
    results = read_results(name, params, folder)
    if not any(results.metrics.values()) and not any(results.models.values()):
        raise DataError("no run of this experiment has results yet", str(folder), f"piegraph reproduce {name}")
    value, lines = describe(params, results)
    out = folder / "report"
    for suffix, text in (("txt", "\n".join(lines)), ("json", as_json(value))):
        with atomic_file(out / f"{name}.{suffix}") as temporary:
            temporary.write_text(text + "\n")
    pictures = []
    for kind, figure in draw(params, results):
        path = out / f"{name}_{kind}.png"
        with atomic_file(path) as temporary:
            figure.savefig(temporary, dpi=110, format="png")
        pictures.append(path)
    return value, lines, pictures
