"""`piegraph pretrain`: a prior, from which `train --from` begins."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from piegraph_cli.commands.options import AsJson
from piegraph_cli.commands.output import Report, emit
from piegraph_cli.dynamics.family.params import Family, PretrainParams
from piegraph_cli.errors import UsageError
from piegraph_cli.params import validated
from piegraph_cli.text import Line, counted


def pretrain(
    out: Annotated[Path, typer.Option(help="file to write (.h5)")],
    family: Annotated[Family | None, typer.Option(help="kind of object [default: blocks]", show_default=False)] = None,
    seed: Annotated[int | None, typer.Option(help="seed of weights, objects and strokes [default: 0]")] = None,
    steps: Annotated[int | None, typer.Option(help="training steps [default: 16000]")] = None,
    hours: Annotated[float | None, typer.Option(help="stop after so long; the same command goes on")] = None,
    as_json: AsJson = False,
) -> None:
    """Train a prior on random objects of this project's own physics, for `train --from`.

    Interrupt and repeat at will: it goes on from its last checkpoint, beside the file.
    """
    from tqdm import tqdm

    from piegraph_cli.stages.prior import PRETRAIN, key_of
    from piegraph_cli.stages.prior import pretrain as train_prior
    from piegraph_cli.workspace.artifact import read_header

    given = {"family": family, "seed": seed, "steps": steps}
    values = {name: value for name, value in given.items() if value is not None}
    params = validated(PretrainParams, values, "pretrain", "piegraph pretrain", "piegraph pretrain --help")
    if hours is not None and not hours > 0:
        raise UsageError(f"--hours {hours:g}: nothing is done in that time", hint="--hours 2")
    header = read_header(out, PRETRAIN.writes)
    if header is None and out.exists():
        raise UsageError("there is something already that is no prior", str(out), "another --out")
    if header is not None and header.key == key_of(params):
        emit(Report({"file": str(out)}, [f"{out} is there already: {header.quality}"]), as_json)
        return

    def tell(items: range) -> Iterable[int]:
        return tqdm(items, "pretrain", params.steps, initial=items.start, leave=False, disable=None, unit=" steps")

    told = train_prior(params, out, hours, tell)
    if told is None:
        emit(Report({"file": None}, [f"stopped after {hours:g} hours; the same command goes on"]), as_json)
        return
    emit(Report(told, _lines(told)), as_json)


def _lines(told: dict[str, Any]) -> list[Line]:
    """What a prior has seen, for people."""
    strokes = counted(told["strokes"], "stroke")
    minutes = f"{told['cpu_minutes']:g} CPU minutes"
    return [f"{told['file']}: {strokes} of {', '.join(told['simulators'])}, {minutes}, loss {told['loss']:.4f}"]
