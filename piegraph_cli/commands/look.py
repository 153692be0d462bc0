"""The command `look`: one set of images, of a folder or of cameras, to the object's cloud and particles."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piegraph_cli.commands.options import AsJson, Settings
from piegraph_cli.commands.output import Report, emit
from piegraph_cli.errors import UsageError
from piegraph_cli.params import split_commas
from piegraph_cli.recording.params import LAYOUT_HELP
from piegraph_cli.text import counted

if TYPE_CHECKING:
    from piegraph_cli.perception.look import Look, LookSettings
    from piegraph_cli.recording.film import Scene


PICTURES = (".png", ".jpg", ".jpeg")


def look(
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="SOURCE",
            help="RECORDING/SEQUENCE, RECORDING/SEQUENCE:FRAME, or a folder of single frames; with --live the RECORDING "
            "whose cameras.json has the cameras",
        ),
    ] = None,
    run: Annotated[
        Path | None, typer.Option("--run", help="run whose settings are taken and whose object is expected")
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="take the images from the cameras that are plugged in", show_default=False)
    ] = False,
    out: Annotated[Path | None, typer.Option(help="cloud to write (.ply, .npz), for plan --state")] = None,
    picture: Annotated[Path | None, typer.Option(help="picture of the masks to write (.png, .jpg)")] = None,
    set: Settings = None,
    accept: Annotated[
        str, typer.Option(help="checks that may be bad: NAME,... [default: none]", show_default=False)
    ] = "",
    layout: Annotated[str, typer.Option(help=f"layout of the images: auto, {', '.join(LAYOUT_HELP)}")] = "auto",
    as_json: AsJson = False,
) -> None:
    """See the object in one set of images: its cloud and particles.

    The verdict tells whether to trust them; where it is bad the exit code is 3 and no cloud is written.
    """
    from piegraph_cli.perception.look import look as look_at

    _check_outputs(out, picture)
    if source is None:
        raise UsageError("nothing to look at", "piegraph look", "give SOURCE, as in my_recording/sequence_0000:0")
    settings = _settings(run, set or [], accept)
    scene = _scene(source, layout, live)
    emit(_report(source, scene, look_at(*scene, settings), out, picture), as_json)


def _check_outputs(out: Path | None, picture: Path | None) -> None:
    from piegraph_cli.recording.points import check_points_file

    if out is not None:
        check_points_file(out)
    if picture is not None and picture.suffix not in PICTURES:
        kind = picture.suffix or "a file without suffix"
        raise UsageError(f"cannot draw a picture as {kind}", str(picture), "use .png")


def _scene(source: str, layout: str, live: bool) -> "Scene":
    from piegraph_cli.capture.live import open_cameras
    from piegraph_cli.stages.look import read_scene

    if not live:
        return read_scene(source, layout)
    with open_cameras(source) as cameras:
        return cameras.scene()


def _settings(run: Path | None, changes: list[str], accept: str) -> "LookSettings":
    from piegraph_cli.stages import STAGES
    from piegraph_cli.stages.look import look_settings
    from piegraph_cli.workspace.recipe import parse_setting

    given: dict[str, dict[str, Any]] = {}
    for text in changes:
        stage, setting, value = parse_setting(text, STAGES)
        given.setdefault(stage.name, {})[setting] = value
    names = [name for name in split_commas(accept) if name]  # type: ignore[attr-defined]
    return look_settings(run, accept=names, **given)


def _report(source: str, scene: "Scene", seen: "Look", out: Path | None, picture: Path | None) -> Report:
    """What was seen, for people and as one object; cloud and picture are written where they are asked for."""
    from piegraph_cli.recording.points import write_points
    from piegraph_cli.stages.look import look_value

    bad = seen.verdict == "bad"
    found = f"{counted(len(seen.cloud), 'point')}, {counted(len(seen.chosen), 'particle')}"
    lines = [f"{seen.verdict}: {found} in {seen.seconds['total']:.2f} s"]
    for finding in seen.findings:
        accepted = finding.name in seen.accepted and finding.checks[0].verdict == "bad"
        lines.append(f"{'accepted' if accepted else finding.checks[0].verdict}: {finding.name}: {finding.text}")
        lines += [f"  try: {finding.remedy}"] if finding.remedy else []
    if picture is not None:
        _draw(picture, scene, seen)
        lines.append(f"picture: {picture}")
    if out is not None and not bad:
        write_points(out, seen.cloud, particles=seen.chosen)
    if out is not None:
        lines.append(_nothing_written(out) if bad else f"cloud: {out}")
    files = {"cloud": str(out) if out and not bad else None, "picture": str(picture) if picture else None}
    value, doubts, error = look_value(seen, source)
    return Report({"source": source} | value | files, lines, 3 if bad else 0, error, doubts)


def _nothing_written(out: Path) -> str:
    """Put a cloud of an earlier look aside, so that nobody takes it for that of this one; what to say."""
    if not out.exists():
        return "no cloud is written"
    aside = out.with_name(f"{out.name}.earlier")
    out.replace(aside)
    return f"no cloud is written; that of an earlier look is now {aside}"


def _draw(path: Path, scene: "Scene", seen: "Look") -> None:
    """Write the images with what was seen in them."""
    import cv2

    from piegraph_cli.evaluation.overlays import look_sheet
    from piegraph_cli.files import atomic_file

    sheet = look_sheet(scene.color, scene.cameras, seen)
    with atomic_file(path) as temporary:
        temporary.write_bytes(cv2.imencode(path.suffix, cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1].tobytes())
