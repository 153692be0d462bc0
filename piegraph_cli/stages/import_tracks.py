"""Stage `import`: particles over time that others measured, checked, as tracks; a file each, named like it."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import PICK
from piegraph_cli.recording.params import ImportParams, MotionFileParams
from piegraph_cli.workspace.call import Call, Given, Option, options_of
from piegraph_cli.workspace.stage import Context, Output, Stage, Unit

if TYPE_CHECKING:
    import numpy as np

    from piegraph_cli.workspace.run import Run

LONGEST_NAME = 100
"""Bytes."""


def _files(run: "Run") -> dict[str, Path]:
    """The files of a run by name of the sequence; of sources that are gone, what was imported before."""
    from piegraph_cli.recording.motion import list_files

    sources = run.params(STAGE.name).sources
    if not sources:
        raise UsageError("nothing to import", str(run.folder), "piegraph import FILE --run RUN")
    found: dict[str, Path] = {}
    gone = [source for source in sources if not source.exists() and _kept(run, source)]
    for source in (source for source in sources if source not in gone):
        for file in list_files(source, READERS):
            name = file.name if file.is_dir() else file.stem
            if name in found:
                raise DataError(f"two files are called {name}", str(file), f"rename one of them: {found[name]}")
            if len(name.encode()) > LONGEST_NAME:
                raise DataError("the name is too long for a sequence", str(file), f"at most {LONGEST_NAME} letters")
            found[name] = file
    for source in gone:  # which of several a sequence came from is not known, nor needed
        found = {file.stem: file for file in _kept(run, source)} | found
    return found


def _kept(run: "Run", source: Path) -> list[Path]:
    """Files of a source that is gone, as far as the run has what was made of them."""
    if source.suffix.lower() in (".npz", ".csv", *READERS):
        return [source] if run.path("tracks", source.stem).exists() else []
    return [source / f"{path.stem}.npz" for path in sorted((run.folder / "tracks").glob("*.h5"))]


def _units(run: "Run") -> Sequence[Unit]:
    return list(_files(run))


def _settings(run: "Run", unit: str) -> MotionFileParams:
    params = run.params(STAGE.name)
    return MotionFileParams(file=_files(run)[unit], mode=params.mode, radius=params.radius, particles=params.particles)


def _options() -> dict[str, Option]:
    """Several sources may be given, one after the other."""
    options = options_of(ImportParams)
    return options | {"sources": Option(list[Path], options["sources"].meaning)}


def _apply(run: "Run", given: Given) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The settings; refused where the run has tracks of its own, and for sources that there never were."""
    from piegraph_cli.recording.motion import list_files

    own = [name for name in ("ingest", "simulate") if name in run.recipe.sections]
    if own:
        raise UsageError(f"this run has its tracks from {own[0]}", str(run.folder), "give --run another folder")
    before = {str(source) for source in run.recipe.sections.get(STAGE.name, {}).get("sources", ())}
    for source in given.get("sources", ()):
        if not source.exists() and os.path.realpath(source) not in before:
            list_files(source, READERS)  # says what is wrong with it; one that was imported may be gone
    return dict(given), ()


STAGE = Stage(
    "import",
    "import particles over time",
    (),
    "tracks",
    ImportParams,
    version=1,
    run="piegraph_cli.stages.import_tracks:run",
    units=_units,
    settings=_settings,
    call=Call(
        more="Of motion capture, another tracker or a simulator: .npz, .h5, .csv or folders (docs/formats.md), as tracks of a "
        "run.",
        argument="sources",
        first=("mode", "radius", "particles"),
        options=_options,
        apply=_apply,
    ),
)


def run(inputs: dict[str, Any], params: MotionFileParams, context: Context) -> Output:
    """Read and check one file."""
    from functools import partial

    import numpy as np

    from piegraph_cli.physics.springs import farthest_point_sample
    from piegraph_cli.recording.motion import read_motion

    choose = partial(farthest_point_sample, count=params.particles) if params.particles else None
    found = read_motion(params.file, params.radius, params.mode, READERS, choose)
    frames, particles = found.positions.shape[:2]
    arrays = {name: getattr(found, name) for name in ("positions", "end_effector", "time", "contact", "mode")}
    if found.opening is not None:
        arrays |= _held(found.contact, found.mode, found.opening)
    arrays |= {"visibility": found.visibility, "residual": np.zeros(frames)}
    quality = f"{frames} frames, {particles} particles, contact in {arrays['contact'].mean():.0%} of the frames"
    quality += "" if found.contact_given else f" (hand within {params.radius:g} m of a particle)"
    return Output(arrays, quality, found.warnings)


def _held(contact: "np.ndarray", mode: "np.ndarray", opening: "np.ndarray") -> "dict[str, np.ndarray]":
    """Contact and mode of a gripper: one that opens and closes holds while it is closed, and that is a pick."""
    import numpy as np

    from piegraph_cli.perception.clouds import opens, while_closed

    holds = while_closed(contact, opening)
    return {"contact": holds, "mode": np.where(holds & opens(opening), PICK, mode)}


def read_h5(path: Path) -> "dict[str, np.ndarray]":
    """The plain datasets at the root of an HDF5 file that have a name we know; nothing else in it is looked at.

    Links, data in other files, and types that are not numbers or short texts are refused: the file may be anybody's.
    """
    from piegraph_cli.recording.motion import ALL_NAMES
    from piegraph_cli.recording.points import check_size
    from piegraph_cli.workspace.structure import read_datasets

    check_size(path)
    return read_datasets(path, ALL_NAMES, "write plain datasets of numbers")


READERS = {".h5": read_h5}
