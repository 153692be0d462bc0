"""The command line: one command per stage, made from the stage table, and the commands around them.

Results go to stdout, everything else to stderr. Nothing heavy is imported before a command runs.
"""

import contextlib
import inspect
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer
from pydantic.fields import FieldInfo

from piegraph_cli import __version__
from piegraph_cli.dynamics.params import LEARNED, TrainParams, split_label, trained_label
from piegraph_cli.environments.params import SimulateParams
from piegraph_cli.errors import PiegraphError, UsageError
from piegraph_cli.params import Params
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.workspace.stage import Stage

app = typer.Typer(
    help="Learn how an object moves from RGB-D recordings of a person handling it, and plan with what was learned.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    add_completion=False,
)

INTERRUPTED = 130

FEW = 8
"""Up to this many sequences are listed one by one."""

OF_TRAINING = ("checkpoint_every", "tensorboard")
"""Settings of `train` that are not those of one model."""

RunFolder = Annotated[Path, typer.Option("--run", help="run folder")]
Force = Annotated[bool, typer.Option("--force", help="make it again even if it is fresh")]
Jobs = Annotated[int, typer.Option("--jobs", "-j", min=1, help="sequences or trials worked on at a time")]
Backend = Annotated[
    Literal["local", "ray"],
    typer.Option("--backend", help="this machine, or a Ray cluster whose nodes share the run folder"),
]
Device = Annotated[Literal["auto", "cpu", "cuda"], typer.Option("--device", help="device of the network")]
AsJson = Annotated[bool, typer.Option("--json", help="print one JSON object")]


@dataclass(frozen=True)
class _Report:
    """What a command prints: an object for `--json`, lines for people, and the exit code."""

    value: dict[str, Any]
    lines: list[str]
    exit_code: int = 0


def _emit(report: _Report, as_json: bool) -> None:
    if as_json:
        from piegraph_cli.evaluation.tables import as_json as text_of

        print(text_of(report.value))
    else:
        print("\n".join(report.lines))
    if report.exit_code:
        raise typer.Exit(report.exit_code)


def _summary(outcomes: list, folder: Path) -> _Report:
    """A line per stage, or per sequence where there are few; failures last. The exit code is the first failure's."""
    lines, failed = [], [o for o in outcomes if o.error]
    for name in dict.fromkeys(o.stage for o in outcomes):
        of_stage = [o for o in outcomes if o.stage == name and not o.error]
        if len(of_stage) > FEW:
            cached = sum(o.state == "cached" for o in of_stage)
            units = f"{STAGES[name].unit}s"
            lines.append(
                f"{name:24s} {len(of_stage)} {units}, {cached} of them fresh already; last: {of_stage[-1].quality}"
            )
        else:
            lines += [f"{name} {o.unit or '':{23 - len(name)}s} {o.state:6s}  {o.quality}" for o in of_stage]
    if failed:
        lines.append("failed: " + ", ".join(f"{o.stage} {o.unit}" if o.unit else o.stage for o in failed))
    value = {
        "run": str(folder),
        "outcomes": [asdict(o) | {"error": str(o.error) if o.error else None} for o in outcomes],
    }
    return _Report(value, lines or ["nothing to do"], failed[0].error.exit_code if failed else 0)


class _LogFile(logging.FileHandler):
    """A log file whose own failure (a full disk, say) neither ends nor clutters the command."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Drop what cannot be written."""

    def close(self) -> None:
        """Close, even if the last lines cannot be written."""
        with contextlib.suppress(OSError):
            super().close()


@contextlib.contextmanager
def _logging_to(folder: Path) -> Iterator[None]:
    """Log to stderr, and with details to RUN/run.log."""
    log = logging.getLogger("piegraph")
    log.setLevel(logging.DEBUG)
    stderr = logging.StreamHandler(sys.stderr)
    stderr.setLevel(logging.INFO)
    stderr.setFormatter(logging.Formatter("%(message)s"))
    folder.mkdir(parents=True, exist_ok=True)
    file = _LogFile(folder / "run.log", encoding="utf-8")
    file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.handlers = [stderr, file]
    log.debug("piegraph %s: %s", __version__, sys.argv[1:])
    try:
        yield
    finally:
        log.handlers = []
        file.close()


def _require_run(folder: Path) -> None:
    if not (folder / "recipe.toml").exists():
        raise UsageError(
            "not a run folder: it has no recipe.toml", str(folder), "start with piegraph ingest, or piegraph run"
        )


def _stage_command(stage: Stage) -> Callable[..., None]:
    """A command with one option per setting of the stage.

    Settings that worked are kept in the run's recipe, but not those of `plan`: each question to it stands for itself.
    """

    def command(run: Path, force: bool, jobs: int, backend: str, device: str, as_json: bool, **values: Any) -> None:
        from piegraph_cli.workspace.execute import LeftOut, Options, run_stage

        given = {name: value for name, value in values.items() if value is not None}
        opened = open_run(run)
        opened.recipe = opened.recipe.with_values(stage, given, f"piegraph {stage.name}", Path.cwd())
        if stage.reads:
            _require_run(run)
        options = Options((), force, jobs, backend, device)  # type: ignore[arg-type]
        with _logging_to(run):
            outcomes = run_stage(opened, stage, options)
            for outcome in outcomes:
                if isinstance(outcome.error, LeftOut):
                    logging.getLogger("piegraph").error("%s", outcome.error)
            if stage.name != "plan" and any(not o.error for o in outcomes):
                opened.save_recipe()
            report = _summary(outcomes, run)
        if stage.name == "trials":
            report = _with_trials(report, run)
        elif stage.name in ("plan", "evaluate") and not report.exit_code:
            report = _described(stage, run)
        _emit(report, as_json)

    common = {"run": RunFolder, "force": Force, "jobs": Jobs, "backend": Backend, "device": Device, "as_json": AsJson}
    defaults = {"force": False, "jobs": 1, "backend": "local", "device": "auto", "as_json": False}
    signature = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=defaults.get(name, Parameter.empty), annotation=annotation)
        for name, annotation in common.items()
    ]
    signature += _options(stage.params)
    command.__signature__ = Signature(signature)  # type: ignore[attr-defined]
    command.__doc__ = stage.help[0].upper() + stage.help[1:] + "."
    return command


def _options(params: type[Params]) -> list[Parameter]:
    """One typer option per setting; left out means: as in the run's recipe, else the default."""
    found = (
        _option(name, field, f"{field.description}{_default(field)}") for name, field in params.model_fields.items()
    )
    return [option for option in found if option is not None]


def _default(field: FieldInfo) -> str:
    """What help says of a default, if there is one."""
    shown = ",".join(map(str, field.default)) if isinstance(field.default, tuple) else field.default
    return "" if field.default in (None, (), {}) else f" [default: {shown}]"


def _option(name: str, field: FieldInfo, text: str) -> Parameter | None:
    """The option of one setting; None for a table, which only a recipe can give."""
    kind: Any = field.annotation
    if type(None) in get_args(kind):
        kind = next(a for a in get_args(kind) if a is not type(None))
    if (get_origin(kind) is dict and not field.metadata) or (isinstance(kind, type) and issubclass(kind, Params)):
        return None
    if kind not in (int, float, bool, Path) and get_origin(kind) is not Literal:
        kind = str
    flag = f"--{name.replace('_', '-')}"
    option = typer.Option(f"{flag}/--no-{flag[2:]}" if kind is bool else flag, help=text, show_default=False)
    annotation = Annotated[kind | None, option] if get_origin(kind) is not Literal else Annotated[kind, option]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


def _described(stage: Stage, folder: Path) -> _Report:
    """What `evaluate` and `plan` print: the numbers themselves."""
    from piegraph_cli.workspace.artifact import read_artifact

    if stage.name == "plan":
        from piegraph_cli.stages.plan import describe

        return _Report(*describe(read_artifact(folder / "plan.h5", "plan")))
    from piegraph_cli.stages.evaluate import describe as describe_metrics

    return _Report(*describe_metrics(open_run(folder)))


def _with_trials(report: _Report, folder: Path) -> _Report:
    """What `trials` prints: the summary of all that are done, and which ones failed."""
    from piegraph_cli.stages.trials import describe

    value, lines = describe(open_run(folder))
    failed = [{"trial": o["unit"], "error": o["error"]} for o in report.value["outcomes"] if o["error"]]
    if failed:
        lines += ["", f"failed: {', '.join(f['trial'] for f in failed)}"]
    return _Report(value | {"failed": failed}, lines, report.exit_code)


for _stage in STAGES.values():
    if _stage.name not in ("simulate", "train"):
        app.command(_stage.name)(_stage_command(_stage))


@app.command()
def run(
    recipe: Annotated[str | None, typer.Argument(help="a .toml file or the name of a shipped recipe")] = None,
    run: Annotated[Path | None, typer.Option("--run", help="run folder [default: runs/RECIPE]")] = None,
    until: Annotated[str | None, typer.Option(help="last stage to run")] = None,
    set: Annotated[
        list[str] | None, typer.Option("--set", help="STAGE.SETTING=VALUE, in place of the recipe's")
    ] = None,
    force: Force = False,
    jobs: Jobs = 1,
    backend: Backend = "local",
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Run a recipe's stages that are not fresh."""
    from piegraph_cli.workspace.execute import Options, run_chain
    from piegraph_cli.workspace.recipe import find_recipe, load_recipe, parse_setting

    if recipe is None and (run is None or not (run / "recipe.toml").exists()):
        raise UsageError("no recipe given", hint="piegraph run RECIPE, or --run with a folder that has a recipe.toml")
    folder = run or Path("runs") / Path(str(recipe)).stem
    opened = open_run(folder)
    if recipe is not None:
        opened.recipe = load_recipe(find_recipe(recipe), STAGES)
    for text in set or []:
        stage, setting, value = parse_setting(text, STAGES)
        opened.recipe = opened.recipe.with_values(stage, {setting: value}, f"--set {text}", Path.cwd())
    names = [stage.name for stage in opened.recipe.chain()]
    if until is not None and until not in names:
        raise UsageError(f"this recipe has no stage {until}", hint=f"one of {', '.join(names)}")
    with _logging_to(folder):
        opened.save_recipe()
        outcomes = run_chain(opened, until, Options((), force, jobs, backend, device))
    _emit(_summary(outcomes, folder), as_json)


@app.command()
def status(run: RunFolder, as_json: AsJson = False) -> None:
    """List a run's artifacts: fresh, stale or failed."""
    from piegraph_cli.workspace.execute import status as rows_of

    _require_run(run)
    rows = rows_of(open_run(run))
    width = max(16, *(len(r["unit"] or "") for r in rows))
    lines = [f"{'stage':10s} {'unit':{width}s} {'state':8s} quality"]
    for r in rows:
        why = (r["quality"] or r["failure"] or r["reason"]).replace("\n ", ";")
        lines.append(f"{r['stage']:10s} {r['unit'] or '-':{width}s} {r['state']:8s} {why}")
    _emit(_Report({"run": str(run), "artifacts": rows}, lines), as_json)


def _simulate(
    environment: Annotated[str, typer.Argument(help="simulated environment, by name (docs/environments.md)")],
    out: Annotated[
        Path | None, typer.Option(help="folder [default: runs/ENVIRONMENT, or recordings/ENVIRONMENT with --render]")
    ] = None,
    render: Annotated[bool, typer.Option("--render", help="record it with four RGB-D cameras and a hand")] = False,
    force: Force = False,
    jobs: Jobs = 1,
    backend: Backend = "local",
    as_json: AsJson = False,
    **values: Any,
) -> None:
    """Simulate random strokes, or render recordings.

    Without --render the true particles are written as tracks of a run; with it, a recording like one of real cameras.
    """
    from piegraph_cli.stages.simulate import record_sequences
    from piegraph_cli.workspace.execute import Options, run_stage

    stage = STAGES["simulate"]
    folder = out or Path("recordings" if render else "runs") / environment
    given = {name: value for name, value in values.items() if value is not None} | {"environment": environment}
    recipe = open_run(folder).recipe.with_values(stage, given, "piegraph simulate", Path.cwd())
    if render:
        settings = recipe.params(stage)
        assert isinstance(settings, SimulateParams)
        made = record_sequences(folder, settings, jobs=jobs, force=force)
        _emit(_Report({"recording": str(folder), "sequences": made}, [f"{folder}: {len(made)} sequences"]), as_json)
        return
    with _logging_to(folder):
        open_run(folder, recipe).save_recipe()
        begin = time.monotonic()
        outcomes = run_stage(open_run(folder, recipe), stage, Options((), force, jobs, backend))
        seconds = time.monotonic() - begin
    report = _summary(outcomes, folder)
    fresh = sum(o.state == "done" for o in outcomes)
    if fresh:
        rate = fresh * recipe.params(stage).strokes / seconds  # type: ignore[attr-defined]
        report.value["strokes_per_second"] = rate
        report.lines.append(f"{rate:.1f} strokes a second")
    _emit(report, as_json)


def _with_options(command: Callable[..., None], params: type[Params], named: str) -> Callable[..., None]:
    """The command with an option per setting in place of its `**values`; the setting `named` is its argument."""
    own = [p for p in inspect.signature(command).parameters.values() if p.kind is not Parameter.VAR_KEYWORD]
    more = [option for option in _options(params) if option.name != named]
    command.__signature__ = Signature(own + more)  # type: ignore[attr-defined]
    return command


app.command("simulate")(_with_options(_simulate, SimulateParams, "environment"))


def _train(
    run: RunFolder,
    model: Annotated[
        str | None,
        typer.Option(help="model to train, beside the run's others; pgnd@20: on 20 sequences [default: all]"),
    ] = None,
    seed: Annotated[
        str | None, typer.Option(help="seeds, as in 0,1,2: of weights, batches and choice of sequences")
    ] = None,
    force: Force = False,
    jobs: Jobs = 1,
    backend: Backend = "local",
    device: Device = "auto",
    as_json: AsJson = False,
    **values: Any,
) -> None:
    """Train models.

    Other options are settings of --model (piegraph where it is left out); those that it does not have are refused.
    """
    from piegraph_cli.stages.train import model_name
    from piegraph_cli.workspace.execute import Options, run_stage

    stage, opened = STAGES["train"], open_run(run)
    given = {name: value for name, value in values.items() if value is not None}
    section: dict[str, Any] = {n: given.pop(n) for n in OF_TRAINING if n in given}
    kept = opened.recipe.sections.get("train", {})
    if seed is not None:
        section["seeds"] = seed
    if model is not None:
        others = kept.get("models", ["piegraph"] if (run / "model").is_dir() else [])
        section["models"] = [*others, model]
    if given:
        own = split_label(trained_label(model) or model)[0] if model else "piegraph"
        section[own] = kept.get(own, {}) | given
    opened.recipe = opened.recipe.with_values(stage, section, "piegraph train", Path.cwd())
    _require_run(run)
    params = opened.recipe.params(stage)
    assert isinstance(params, TrainParams)
    only = tuple(model_name(params.models[-1], one) for one in params.seeds) if model else ()
    if model is not None:
        models = {"models": list(dict.fromkeys(params.models))}
        opened.recipe = opened.recipe.with_values(stage, models, "piegraph train", Path.cwd())
    with _logging_to(run):
        options = Options(only, force, jobs, backend, device)  # type: ignore[arg-type]
        outcomes = run_stage(opened, stage, options)
        if any(not o.error for o in outcomes):
            opened.save_recipe()
        report = _summary(outcomes, run)
    _emit(report, as_json)


def _training_options() -> list[Parameter]:
    """One option per setting of any model: what it means, and whose it is with which default."""
    fields: dict[str, dict[str, FieldInfo]] = {}
    for model, params in LEARNED.items():
        for name, field in params.model_fields.items():
            fields.setdefault(name, {})[model] = field
    options = []
    for name, of in fields.items():
        meanings = [str(meaning) for meaning in dict.fromkeys(field.description for field in of.values())]
        whose = {_default(field): [m for m, f in of.items() if _default(f) == _default(field)] for field in of.values()}
        models = "; ".join(f"{', '.join(names)}{default}" for default, names in whose.items())
        options.append(_option(name, next(iter(of.values())), f"{', or: '.join(meanings)} ({models})"))
    own = (_option(n, TrainParams.model_fields[n], str(TrainParams.model_fields[n].description)) for n in OF_TRAINING)
    return [option for option in (*options, *own) if option is not None]


_train.__signature__ = Signature(  # type: ignore[attr-defined]
    [p for p in inspect.signature(_train).parameters.values() if p.kind is not Parameter.VAR_KEYWORD]
    + _training_options()
)
app.command("train")(_train)


@app.command()
def report(run: RunFolder, as_json: AsJson = False) -> None:
    """Draw a run's pictures into RUN/report."""
    from piegraph_cli.report.draw import draw_report

    _require_run(run)
    with _logging_to(run):
        files = draw_report(run)
    _emit(_Report({"pictures": [str(f) for f in files]}, [str(f) for f in files]), as_json)


@app.command()
def reproduce(
    experiment: Annotated[str, typer.Argument(help="an experiment by name, or all (docs/experiments.md)")],
    runs: Annotated[
        Path | None,
        typer.Option(help="folder of the experiments' runs [default: runs/paper, or runs/quick with --quick]"),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="minutes in place of hours: fewer sequences, seeds and steps")
    ] = False,
    set: Annotated[
        list[str] | None, typer.Option("--set", help="SETTING=VALUE in place of the experiment's, as trials.seeds=3")
    ] = None,
    envs: Annotated[
        str, typer.Option(help="environments to do, as tblock,toy [default: all of the experiment's]")
    ] = "",
    show: Annotated[bool, typer.Option("--show", help="only print what is done")] = False,
    jobs: Jobs = 1,
    backend: Backend = "local",
    device: Device = "auto",
    as_json: AsJson = False,
) -> None:
    """Run an experiment of the paper, and print its table.

    Whatever is fresh is not done again. Table, numbers and pictures are kept in RUNS/report.
    """
    from piegraph_cli.experiments.recipes import load_experiment, names
    from piegraph_cli.experiments.run import run_experiment, write_report
    from piegraph_cli.workspace.execute import Options

    folder = runs or Path("runs") / ("quick" if quick else "paper")
    wanted = [experiment] if experiment != "all" else names()
    of = [env.strip() for env in envs.split(",") if env.strip()]
    chosen = {name: load_experiment(name, quick, set or (), of) for name in wanted}
    values, lines, code = {}, [], 0
    for name, params in chosen.items():
        with _logging_to(folder):
            failed = [] if show else run_experiment(name, params, folder, Options((), False, jobs, backend, device))  # type: ignore[arg-type]
            value, text, pictures = write_report(name, params, folder)
        code = code or (failed[0].exit_code if failed else 0)
        values[name] = value | {"pictures": [str(p) for p in pictures], "failed": [str(e) for e in failed]}
        lines += ["", *text, "", *map(str, pictures)]
    _emit(_Report(values, lines[1:], code), as_json)


@app.command()
def calibrate(
    recording: Annotated[Path, typer.Argument(help="recording folder whose cameras.json has K and distortion")],
    sequence: Annotated[str | None, typer.Option(help="sequence that shows the board [default: the first]")] = None,
    columns: Annotated[int, typer.Option(help="squares across the board")] = 7,
    rows: Annotated[int, typer.Option(help="squares down the board")] = 5,
    square: Annotated[float, typer.Option(help="edge of a square [m]")] = 0.04,
    marker: Annotated[float, typer.Option(help="edge of a marker [m]")] = 0.03,
    dictionary: Annotated[str, typer.Option(help="OpenCV's name of the marker dictionary")] = "DICT_5X5_100",
    as_json: AsJson = False,
) -> None:
    """Locate the cameras by a ChArUco board.

    The board lies on the table; its middle becomes the origin of the world, z up. Fills T_world_camera in cameras.json.
    """
    from piegraph_cli.recording.calibration import Board
    from piegraph_cli.recording.locate import calibrate as locate

    results = locate(recording, sequence, Board(columns, rows, square, marker, dictionary))
    lines = [
        f"{name:12s} {error:5.2f} px{'  poor: check K and distortion' if poor else ''}" for name, error, poor in results
    ]
    _emit(_Report({"cameras": {name: {"error_px": error} for name, error, _ in results}}, lines), as_json)


@app.command()
def view(
    run: RunFolder,
    sequence: Annotated[str | None, typer.Option(help="sequence to show [default: the first]")] = None,
    port: Annotated[int, typer.Option(min=1024, max=65535, help="port on this machine")] = 8080,
) -> None:
    """Show clouds and tracks in the browser.

    Serves on 127.0.0.1 only, until interrupted.
    """
    from piegraph_cli.viewer.serve import serve

    serve(run, sequence, port)


@app.command()
def doctor(
    fetch: Annotated[str | None, typer.Option(help="fetch a weight file by name")] = None, as_json: AsJson = False
) -> None:
    """Check what this machine lacks."""
    from piegraph_cli.doctor import check_machine
    from piegraph_cli.weights import fetch_weights

    if fetch:
        path = fetch_weights(fetch)
        _emit(_Report({"fetched": str(path)}, [str(path)]), as_json)
        return
    checks = check_machine()
    lines = [f"{'ok' if c.ok else 'MISSING':8s} {c.name:24s} {c.detail}" for c in checks]
    needed = [c for c in checks if not c.ok and c.needed]
    _emit(_Report({"checks": [asdict(c) for c in checks]}, lines, 4 if needed else 0), as_json)


@app.command()
def bench(
    subjects: Annotated[
        list[str] | None,
        typer.Argument(help="sms, egnn, plan, track, train, perception [default: all; perception only with --run]"),
    ] = None,
    run: Annotated[Path | None, typer.Option(help="run folder with a recording's results, for perception")] = None,
    roofline: Annotated[Path | None, typer.Option(help="picture (.png, .svg) of the kernels' rates")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure speed on this machine.

    Every figure comes after a check of the result, beside the machine's measured peak and the reference in PyTorch.
    """
    from tqdm import tqdm

    from piegraph_cli.bench.measure import table
    from piegraph_cli.bench.run import check_picture, draw_roofline, run_benchmarks

    if roofline is not None:
        check_picture(roofline)
    rows = list(tqdm(run_benchmarks(list(subjects or ()), run), desc="bench", unit=" rows", leave=False, disable=None))
    if roofline is not None:
        draw_roofline(rows).savefig(roofline, dpi=150)
    _emit(_Report({"rows": [row.as_dict() for row in rows]}, table(rows)), as_json)


def _version(value: bool) -> None:
    if value:
        print(f"piegraph {__version__}")
        raise typer.Exit()


@app.callback()
def _options_of_all(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version")
    ] = False,
) -> None:
    """Learn how an object moves from RGB-D recordings of a person handling it, and plan with what was learned."""


def _interrupt_again(unraisable: "sys.UnraisableHookArgs") -> None:
    """Ctrl-C that falls into a destructor, where Python drops exceptions, comes once more."""
    if unraisable.exc_type is KeyboardInterrupt:
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
    else:
        sys.__unraisablehook__(unraisable)


def main() -> None:
    """The `piegraph` program: a user's mistake ends with one message and its exit code, never a traceback."""
    sys.unraisablehook = _interrupt_again
    try:
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
        if code == INTERRUPTED:
            raise KeyboardInterrupt
        sys.exit(code)
    except PiegraphError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        print("interrupted; the same command goes on from here", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)
        command = f"piegraph {context.info_name}" if context is not None and context.parent is not None else "piegraph"
        print(f"error: {error.format_message()}\n  try: {command} --help", file=sys.stderr)
        sys.exit(error.exit_code)
