"""The program: its commands in groups, their help, and how it ends: exit codes, errors without a traceback, Ctrl-C."""

import os
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from piegraph_cli import __version__
from piegraph_cli.commands import experiments, look, record, runs, survey, tools
from piegraph_cli.commands.answer import answering, error_object, wants_json
from piegraph_cli.commands.calibrate import calibrate
from piegraph_cli.commands.pretrain import pretrain
from piegraph_cli.commands.serve import serve
from piegraph_cli.commands.stages import stage_commands
from piegraph_cli.commands.suggest import suggest
from piegraph_cli.errors import DataError, PiegraphError, UsageError
from piegraph_cli.files import MAKE_ROOM, NO_SPACE, refused
from piegraph_cli.signals import stopped

GROUPS: dict[str, dict[str, Callable[..., None]]] = {
    "Stages, in the order of the pipeline": stage_commands(),
    "Runs": {
        "run": runs.run,
        "status": survey.status,
        "clean": survey.clean,
        "report": runs.report,
        "view": runs.view,
        "suggest": suggest,
    },
    "Robots": {"serve": serve},
    "Cameras": {"record": record.record, "look": look.look},
    "Experiments": {"reproduce": experiments.reproduce},
    "Tools": {
        "list": tools.list_names,
        "unpack": tools.unpack,
        "calibrate": calibrate,
        "pretrain": pretrain,
        "doctor": tools.doctor,
        "bench": tools.bench,
    },
}
"""All commands by name, under the headings of the help."""


def _write_sections(formatter: Any, rows: Iterable[tuple[str, tuple[str, str]]]) -> None:
    """Rows of a help text, each under its heading, in the order of the headings' first rows."""
    sections: dict[str, list[tuple[str, str]]] = {}
    for heading, row in rows:
        sections.setdefault(heading, []).append(row)
    for heading, of in sections.items():
        with formatter.section(heading):
            formatter.write_dl(of)


def _write_options(command: Any, ctx: Any, formatter: Any) -> None:
    """Arguments, then options under the headings they name."""
    rows = [(param, param.get_help_record(ctx)) for param in command.get_params(ctx)]
    heading = {"argument": "Arguments", "option": "Options"}
    named = [(getattr(p, "rich_help_panel", None) or heading[p.param_type_name], row) for p, row in rows if row]
    _write_sections(formatter, sorted(named, key=lambda item: item[0] not in heading.values()))


class Command(TyperCommand):
    """A command whose options stand under headings."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the sections of the options."""
        _write_options(self, ctx, formatter)


class Group(TyperGroup):
    """The program, whose commands stand under headings."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the sections of the commands, then the options."""
        width = formatter.width - 6 - max(map(len, self.commands))
        commands: Any = self.commands.values()
        _write_sections(formatter, [(c.rich_help_panel, (c.name, c.get_short_help_str(width))) for c in commands])
        _write_options(self, ctx, formatter)


def _version(value: bool) -> None:
    if value:
        print(f"piegraph {__version__}")
        raise typer.Exit()


def _options_of_all(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version", show_default=False)
    ] = False,
) -> None:
    """Learn how an object moves from RGB-D recordings of a person handling it, and plan with what was learned."""


def _make() -> typer.Typer:
    made = typer.Typer(
        cls=Group,
        callback=_options_of_all,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    for heading, commands in GROUPS.items():
        for name, command in commands.items():
            made.command(name, cls=Command, rich_help_panel=heading)(command)
    return made


app = _make()


class Interrupted(PiegraphError):
    """A signal that ends the program."""

    kind = "interrupted"

    def __init__(self, number: int):
        said = "interrupted" if number == signal.SIGINT else f"ended by {signal.Signals(number).name}"
        super().__init__(said, hint="the same command goes on from here")
        self.exit_code = 128 + number

    def __str__(self) -> str:
        return f"{self.message}; {self.hint}"


def call(arguments: Sequence[str]) -> int:
    """Run one command line; returns its exit code. A user's mistake is one message, never a traceback.

    With `--json` one object goes to stdout, however the command ends.
    """
    name = next((word for word in arguments[:1] if any(word in group for group in GROUPS.values())), None)
    with answering(name) as answer:
        try:
            code = _ended(arguments)
        except PiegraphError as error:
            said = str(error) if isinstance(error, Interrupted) else f"error: {error}"
            print(said, file=sys.stderr)
            answer.error, code = error_object(error), error.exit_code
        except Exception as bug:
            hint = "the traceback is on stderr: report it"
            answer.error = error_object(PiegraphError(f"{type(bug).__name__}: {bug}", "bug in piegraph", hint))
            raise
        finally:
            said_more = answer.result is not None or answer.error is not None
            if wants_json(arguments) and said_more and not answer.told:
                print(answer.text(), flush=True)
    return code


def _ended(arguments: Sequence[str]) -> int:
    """The exit code of a command line. Whatever a user can cause or mend is raised as a `PiegraphError`."""
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        raise Interrupted(stopped() or signal.SIGINT) from None
    except Exception as error:
        if (number := stopped()) is not None:  # whatever the signal was made into on its way
            raise Interrupted(number) from None
        if told := refused(error, "output"):
            raise told from error
        raise


def _run(arguments: Sequence[str]) -> int:
    try:
        code = app(list(arguments) or ["--help"], prog_name="piegraph", standalone_mode=False)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except SystemExit as ended:
        if ended.code == 1:  # typer's word for a reader that has left
            raise BrokenPipeError from None
        raise
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)
        command = f"piegraph {context.info_name}" if context is not None and context.parent is not None else "piegraph"
        raise UsageError(error.format_message(), hint=f"{command} --help") from None
    if code == 128 + signal.SIGINT:
        raise KeyboardInterrupt
    return int(code or 0)


def run() -> int:
    """The `piegraph` program's exit code."""
    try:
        code = call(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:  # who read it has left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 128 + signal.SIGPIPE
    except OSError as error:  # what was still to be written to a file
        if error.errno not in NO_SPACE:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        print(f"error: stdout: cannot be written: {error}\n  try: {MAKE_ROOM}", file=sys.stderr)
        code = DataError.exit_code
    return code
