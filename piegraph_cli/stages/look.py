"""What a look needs beside its images: settings and the object of a run, and images that lie in a recording."""

import os
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np

from piegraph_cli.errors import DataError, InputError, UsageError
from piegraph_cli.params import validated
from piegraph_cli.perception.judgement import JUDGED
from piegraph_cli.perception.look import Look, LookSettings
from piegraph_cli.physics.particles import Sizes
from piegraph_cli.recording.film import Film, Scene
from piegraph_cli.recording.folders import layout_of, sequences_in
from piegraph_cli.recording.images import decode_color
from piegraph_cli.recording.params import CheckName, ReadParams
from piegraph_cli.recording.readers import read_films
from piegraph_cli.recording.registration import register_depth
from piegraph_cli.stages import STAGES, open_run, sequences
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run

STATES = 20
"""Frames of each sequence whose particles tell how large the trained object is."""
USED = ("ingest", "segment", "fuse", "track")
"""Stages whose settings a look takes."""


def look_settings(
    run: Path | str | None = None, *, accept: Collection[str] = (), **settings: Mapping[str, Any]
) -> LookSettings:
    """With what to look: the settings of a run and the size of its object, or the defaults without a run.

    `settings` are in place of the run's, by stage: `segment={"points": {"cam0": (320, 200)}}`; `accept` names checks of
    the look that may be bad. Prompts of the run are left out: they point into its first frames. Raises `UsageError` for
    what is no run, and for settings that are none.
    """
    recipe, sizes = Recipe(STAGES), None
    if run is not None:
        if not (Path(run) / "recipe.toml").is_file():
            raise UsageError("not a run folder: it has no recipe.toml", str(run), "give the run of the trained model")
        opened = open_run(run)
        recipe, sizes = opened.recipe, _sizes(opened)
    segment = {k: v for k, v in recipe.sections.get("segment", {}).items() if k not in ("prompts", "points")}
    recipe = Recipe(STAGES, recipe.sections | {"segment": segment})
    for name, values in settings.items():
        if name not in USED:
            raise UsageError(f"a look has no settings of {name}", "look", f"it takes those of {', '.join(USED)}")
        recipe = recipe.with_values(STAGES[name], values, "look", Path.cwd())
    unknown = sorted(set(accept) - {*JUDGED, *get_args(CheckName)})
    if unknown:
        known = ", ".join((*get_args(CheckName), *JUDGED))
        raise UsageError(f"no check is called {unknown[0]}", "look, accept", f"one of {known}")
    ingest, of_segment, fuse, track = (recipe.params(STAGES[name]) for name in USED)
    particles: int = track.particles  # type: ignore[attr-defined]
    return LookSettings(ingest, of_segment, fuse, particles, sizes, tuple(accept))  # type: ignore[arg-type]


def _sizes(run: Run) -> Sizes | None:
    """How large the object of a run is, by its tracks; None where nothing was tracked yet."""
    states: list[np.ndarray] = []
    for name in sequences(run):
        try:
            positions = run.read("tracks", name)["positions"]
        except InputError:
            continue
        states += list(positions[:: max(1, len(positions) // STATES)])
    return Sizes.of(states) if states and len(states[0]) > 1 else None


def look_value(seen: Look, source: str) -> tuple[dict[str, Any], list[str], DataError | None]:
    """What was seen, for programs; what is doubtful in it, in words; and what makes it useless, if anything does."""
    findings = [
        {"check": f.name, "verdict": f.checks[0].verdict, "cameras": f.cameras, "text": f.text, "try": f.remedy}
        for f in seen.findings
    ]
    checks = [
        {"check": c.name, "cameras": list(c.cameras), "figure": c.figure, "unit": c.unit, "verdict": c.verdict}
        for c in seen.checks
    ]
    doubts = [f for f in seen.findings if f.name in seen.accepted or f.checks[0].verdict != "bad"]
    error = None
    try:
        seen.require()
    except DataError as useless:
        error = DataError(useless.message, source, useless.hint)
    value = {
        "verdict": seen.verdict,
        "findings": findings,
        "checks": checks,
        "points": len(seen.cloud),
        "particles": None if seen.verdict == "bad" else seen.chosen.tolist(),
        "seconds": seen.seconds,
        "frame": "world",
        "units": "m",
    }
    return value, [f"{f.name}: {f.text}" for f in doubts], error


def read_scene(source: Path | str, layout: str = "auto") -> Scene:
    """One image of each camera: of a folder of single frames, or a recording's SEQUENCE or SEQUENCE:FRAME.

    The frame counts as the first camera's images are numbered, and is the last one if left out; the other cameras give
    what is nearest to it in time. Raises `DataError` for folders, images and frames that cannot be used.
    """
    folder, number = _place(str(source))
    if not os.path.isdir(folder):  # a name that is too long is none
        raise DataError("no such folder", str(folder), "give RECORDING/SEQUENCE:FRAME, or a folder of single frames")
    params = validated(ReadParams, {"layout": layout}, "ingest", str(folder), "piegraph list layouts")
    inside = sequences_in(folder, params.layout)
    if inside:
        hint = f"give one of them, as in {folder / inside[0]}:0"
        raise DataError(f"this is a recording of {len(inside)} sequences, not one of them", str(folder), hint)
    films, _ = read_films(folder, layout_of(folder, params.layout), params)
    time = _time(films[0], number, folder)
    taken = [_image_at(film, time, folder) for film in films]
    pairs = [_read(film, k) for film, k in zip(films, taken, strict=True)]
    return Scene([c for c, _ in pairs], [d for _, d in pairs], [film.camera for film in films])


def _place(source: str) -> tuple[Path, int | None]:
    """A folder and a frame, from FOLDER or FOLDER:FRAME."""
    folder, colon, frame = source.rpartition(":")
    numbered = colon and folder and re.fullmatch(r"[0-9]{1,18}", frame)
    return (Path(folder), int(frame)) if numbered else (Path(source), None)


def _time(film: Film, number: int | None, folder: Path) -> float:
    """The time (s) of a frame of the leading camera."""
    if number is None:
        return float(film.times[-1])
    found = np.flatnonzero(film.numbers == number)
    if not len(found):
        text = f"camera {film.camera.name} has no frame {number}"
        raise DataError(text, str(folder), f"its frames are {film.numbers[0]} to {film.numbers[-1]}")
    return float(film.times[found[0]])


def _image_at(film: Film, time: float, folder: Path) -> int:
    """Which image of a camera is nearest to a time (s)."""
    nearest = int(np.abs(film.times - time).argmin())
    skew, most = abs(film.times[nearest] - time), ReadParams().max_skew
    if skew > most:
        raise DataError(
            f"camera {film.camera.name} has no image within {most * 1000:.0f} ms of {time:.3f} s, the nearest is "
            f"{skew * 1000:.0f} ms away",
            str(folder),
            "take another frame, or check the time stamps",
        )
    return nearest


def _read(film: Film, image: int) -> tuple[np.ndarray, np.ndarray]:
    """Colour and depth of one image, depth registered to colour."""
    color = decode_color(np.frombuffer(film.images.color(image), np.uint8))
    depth = film.depth(image)[0]
    return color, depth if film.camera.depth_view is None else register_depth(depth, film.camera)
