"""Options that several commands share, and options made from the settings of a stage."""

from inspect import Parameter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_origin

import typer

from piegraph_cli.workspace.call import Call, Folder, Option

if TYPE_CHECKING:
    from piegraph_cli.workspace.execute import Options

MORE, RUNNING = "More settings", "Running"
"""Headings in the help of a stage, after its options."""

RunFolder = Annotated[Path, typer.Option("--run", help="run folder")]
Force = Annotated[
    bool, typer.Option("--force", help="make it again even if it is fresh", rich_help_panel=RUNNING, show_default=False)
]
Jobs = Annotated[
    int, typer.Option("--jobs", "-j", min=1, help="sequences or trials worked on at a time", rich_help_panel=RUNNING)
]
Backend = Annotated[
    Literal["local", "ray"],
    typer.Option(
        "--backend", help="this machine, or a Ray cluster whose nodes share the run folder", rich_help_panel=RUNNING
    ),
]
Device = Annotated[
    Literal["auto", "cpu", "cuda"], typer.Option("--device", help="device of the network", rich_help_panel=RUNNING)
]
Rehash = Annotated[
    bool,
    typer.Option(
        "--rehash",
        help="read every file again, even if it looks as it did when it was last read",
        rich_help_panel=RUNNING,
        show_default=False,
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="print one JSON object", show_default=False)]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        help="write the artifact (.h5) there, and nothing into the run",
        rich_help_panel=RUNNING,
        show_default=False,
    ),
]
Settings = Annotated[list[str] | None, typer.Option("--set", help="STAGE.SETTING=VALUE, in place of the recipe's")]


def running(
    only: tuple[str | None, ...], force: bool, jobs: int, backend: Literal["local", "ray"], device: str
) -> "Options":
    """How to run stages. Raises `MissingError` for a GPU that is not there; on a cluster other machines have theirs."""
    from piegraph_cli.workspace.execute import Options

    if device == "cuda" and backend == "local":
        from piegraph_cli.process import choose_device

        choose_device(device)
    return Options(only, force, jobs, backend, device)  # type: ignore[arg-type]


_RUNNING: dict[str, tuple[Any, Any]] = {
    "force": (Force, False),
    "jobs": (Jobs, 1),
    "backend": (Backend, "local"),
    "device": (Device, "auto"),
    "as_json": (AsJson, False),
}


def stage_parameters(call: Call, options: dict[str, Option]) -> list[Parameter]:
    """The parameters of a stage's command: its argument, the folder, the settings (first ones first), how to run it."""
    ordered = {name: options[name] for name in call.first} | options
    found = [_argument(call.argument, ordered.pop(call.argument))] if call.argument else []
    found.append(_folder(call.folder))
    if call.instead:
        flag = typer.Option(f"--{call.instead.flag}", help=call.instead.help, show_default=False)
        found.append(_parameter(call.instead.flag, Annotated[bool, flag], False))
    for name, option in ordered.items():
        found.append(_setting(name, option, None if name in call.first or not call.first else MORE))
    if call.out:
        found.append(_parameter("out", Out, None))
    return found + [_parameter(name, annotation, default) for name, (annotation, default) in _RUNNING.items()]


def _parameter(name: str, annotation: Any, default: Any = Parameter.empty) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _argument(name: str, option: Option) -> Parameter:
    return _parameter(name, Annotated[option.kind, typer.Argument(help=option.meaning, metavar=name.upper())])


def _folder(folder: Folder) -> Parameter:
    option = typer.Option(f"--{folder.option}", help=folder.help, show_default=False)
    if folder.default is None:
        return _parameter("folder", Annotated[Path, option])
    return _parameter("folder", Annotated[Path | None, option], None)


def _setting(name: str, option: Option, panel: str | None) -> Parameter:
    """The option of one setting; left out it means: as in the run's recipe, else the default."""
    flag, kind = f"--{name.rstrip('_').replace('_', '-')}", option.kind  # a word of Python's ends in _ as a name
    text = option.meaning + (f" [default: {option.default}]" if option.default else "")
    names = f"{flag}/--no-{flag[2:]}" if kind is bool else flag
    given = typer.Option(names, help=text, show_default=False, rich_help_panel=panel)
    return _parameter(name, Annotated[kind if get_origin(kind) is Literal else kind | None, given], None)
