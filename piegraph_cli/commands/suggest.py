"""The command `suggest`: which strokes to record next, as a list and a picture."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piegraph_cli.commands.options import AsJson, RunFolder
from piegraph_cli.commands.output import Report, emit
from piegraph_cli.commands.stages import require_run
from piegraph_cli.errors import UsageError
from piegraph_cli.files import atomic_file
from piegraph_cli.params import mode_word
from piegraph_cli.text import Column, Line, Table, counted

if TYPE_CHECKING:
    from piegraph_cli.stages.suggest import Suggested

WHY = {
    "spread": "how far networks of several seeds lie apart",
    "expected error": "what errors to expect of the model",
    "motion": "how far the model moves the object; after `evaluate`, what errors to expect",
}
"""What `unsure` is from, in words."""


def suggest(
    run: RunFolder,
    model: Annotated[str, typer.Option(help="label of the model that shall learn")] = "piegraph",
    state: Annotated[
        Path | None,
        typer.Option(help="cloud of the object now: .ply, .npz, .h5 [default: where the last stroke left it]"),
    ] = None,
    strokes: Annotated[int, typer.Option(min=1, max=100, help="how many")] = 5,
    seed: Annotated[int, typer.Option(min=0, help="of the strokes that are compared")] = 0,
    picture: Annotated[
        Path | None, typer.Option(help="picture to write (.png) [default: RUN/suggested.png]", show_default=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Say which strokes to record next, so that the model learns most.

    The first is worth most; each is chosen in view of those recorded and those before it. Record them, ingest, train, ask
    again.
    """
    from piegraph_cli.evaluation.figures import suggestion_figure
    from piegraph_cli.stages.suggest import suggest_in

    require_run(run)
    if picture is not None and picture.suffix != ".png":
        raise UsageError(
            f"cannot draw a picture as {picture.suffix or 'a file without suffix'}", str(picture), "use .png"
        )
    made = suggest_in(run, model, state, strokes, seed)
    place = picture or run / "suggested.png"
    with atomic_file(place) as temporary:
        figure = suggestion_figure(made.state, made.past, made.found.strokes.ends.numpy())
        figure.savefig(temporary, dpi=150, format="png")
    emit(_report(made, place), as_json)


def _report(made: "Suggested", picture: Path) -> Report:
    rows = _rows(made)
    columns = [Column(name, 8, right=True) for name in ("start x", "y", "end x", "y", "unsure", "new")]
    told = [
        (
            str(k),
            row["mode"],
            *(f"{v:.3f}" for v in (*row["start"], *row["end"])),
            f"{row['unsure'] * 100:.2f} cm",
            f"{row['new']:.0%}",
        )
        for k, row in enumerate(rows, 1)
    ]
    seeds = f" of {made.seeds}" if made.seeds > 1 else ""
    lines: list[Line] = [
        Table([Column("", 3, right=True), Column("mode", 5), *columns], told),
        f"metres; unsure: {WHY[made.found.reason]}{seeds}; new: how unlike what was recorded and what stands above",
        f"picture: {picture}; learned from {counted(len(made.past), 'stroke')} so far",
    ]
    value = {"strokes": rows, "unsure_is": made.found.reason, "recorded": len(made.past), "picture": str(picture)}
    return Report(value, lines, warnings=made.warnings)


def _rows(made: "Suggested") -> list[dict[str, Any]]:
    found = made.found
    ends, modes = found.strokes.ends.double().tolist(), found.strokes.mode.tolist()
    numbers = zip(ends, modes, found.unsure.tolist(), found.new.tolist(), strict=True)
    return [
        {"mode": mode_word(mode), "start": start, "end": end, "unsure": unsure, "new": new}
        for (start, end), mode, unsure, new in numbers
    ]
