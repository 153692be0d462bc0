"""The service: one warm model, and what it answers to each kind of request. It knows neither sockets nor pipes."""

import json
import logging
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from piegraph_cli import __version__
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.errors import DataError, PiegraphError, UsageError, error_object
from piegraph_cli.params import mode_number, mode_word, validated
from piegraph_cli.perception.look import LookSettings, look
from piegraph_cli.planning.expected import check_object
from piegraph_cli.planning.model import Model
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.question import answer
from piegraph_cli.planning.told import answer_value
from piegraph_cli.recording.film import Scene
from piegraph_cli.service.requests import (
    MOST_BYTES,
    MOST_PARTICLES,
    MOST_POINTS,
    MOST_STROKES,
    REQUESTS,
    LookRequest,
    PlanRequest,
    PredictRequest,
    Request,
    parsed,
    request_of,
    written,
)
from piegraph_cli.stages.look import look_value
from piegraph_cli.stages.plan import told_by
from piegraph_cli.workspace.artifact import read_key

log = logging.getLogger("piegraph")

MOST_WORK = 100_000
"""Candidates that one plan may look at: samples x iterations x strokes ahead, some seconds of search."""
HERE = {*PlanParams.query, "model", "cameras", "episodes", "daxbench_python", "daxbench_repo"}
"""Settings of a plan that a request does not choose: what it asks has fields of its own, and files are the server's."""


@dataclass(frozen=True)
class Origin:
    """Where the served model came from; nothing for a model that is not trained."""

    file: Path | None = None
    key: str | None = None
    """Of the artifact as it was read."""


@dataclass(frozen=True)
class Eye:
    """How the service sees: with what settings, and where the images come from."""

    settings: LookSettings
    scene: Callable[[str | None], Scene]
    """From SEQUENCE:FRAME, or of what cameras see now."""
    what: str
    """For people."""


@dataclass(frozen=True)
class Reply:
    """An answer: the envelope as one line of JSON, and the exit code that a command would end with."""

    text: bytes
    exit_code: int


@dataclass
class Service:
    """Answers requests, one at a time; nothing in one changes another's answer."""

    model: Model
    origin: Origin = Origin()
    robot: Callable[[], np.ndarray] = lambda: np.eye(4)
    """Gives `T_world_robot` [4, 4], or raises where it is not known."""
    eye: Eye | None = None
    _seen: tuple[Any, str] = field(default=(None, ""), repr=False)

    def reply(self, data: bytes, command: str | None = None) -> Reply:
        """The answer to one JSON object; the command is its field `command` where none is given. Never raises."""
        result: dict[str, Any] | None = None
        warnings: list[str] = []
        error: PiegraphError | None = None
        begin = time.perf_counter()
        try:
            fields = parsed(data)
            asked = fields.pop("command", None) if command is None else command
            command = asked if isinstance(asked, str) and asked in REQUESTS else None
            request = request_of(asked, fields)
            begun = time.perf_counter()
            result, warnings, error = self._answered(request)
            result["seconds"] = {"request": begun - begin} | result.get("seconds", {})
            result["seconds"]["total"] = time.perf_counter() - begin
        except PiegraphError as known:
            error = known
        except Exception as bug:
            log.error("%s", traceback.format_exc())
            error = PiegraphError(f"{type(bug).__name__}: {bug}", "bug in piegraph", "the traceback is on stderr")
        return envelope(command, result, warnings, error)

    def _answered(self, request: Request) -> tuple[dict[str, Any], list[str], PiegraphError | None]:
        """Result, warnings, and the error that a result may have beside it."""
        error = None
        if isinstance(request, PlanRequest):
            result, warnings = self._plan(request)
        elif isinstance(request, PredictRequest):
            result, warnings = self._predict(request)
        elif isinstance(request, LookRequest):
            result, warnings, error = self._look(request)
        else:
            result, warnings = self._info(), []
        replaced = self._on_disk()
        if replaced != "same":
            warnings = [
                *warnings,
                f"the model file is {replaced} on disk: this is still the one of key {self.origin.key}",
            ]
        return {"model": {"label": self.model.label, "key": self.origin.key}} | result, warnings, error

    def _plan(self, request: PlanRequest) -> tuple[dict[str, Any], list[str]]:
        params = self._settings(request)
        begin = time.perf_counter()
        found = answer(
            self.model.trained,
            params,
            request.state,
            request.goal,
            device=self.model.device,
        )
        seconds = {"plan": time.perf_counter() - begin}
        value = answer_value(found, params, told_by(params, self.robot), request.candidates)
        warnings = value.pop("warnings")
        for row in value["strokes"]:
            row["predicted"] = written(row["predicted"], request.encoding)
        return value | {"frame": params.frame, "seconds": seconds}, warnings

    def _settings(self, request: PlanRequest) -> PlanParams:
        """The model's settings, with those of the request in place. Raises `UsageError`."""
        kept = [name for name in request.settings if name in HERE]
        if kept:
            hint = "state, goal and goal_pose are fields of the request; the model is the one that is served"
            raise UsageError(f"{kept[0]} is no setting of a request", "plan.settings", hint)
        values = self.model.settings.model_dump() | {"model": self.model.label, "goal_pose": request.goal_pose}
        params = validated(PlanParams, values | request.settings, "plan.settings", "request", "docs/robot.md")
        work = params.samples * params.cem_iterations * params.horizon
        if work > MOST_WORK:
            text = f"samples x cem_iterations x horizon is {work}, at most {MOST_WORK} are looked at in one request"
            raise UsageError(text, "plan.settings", "fewer samples")
        return params

    def _predict(self, request: PredictRequest) -> tuple[dict[str, Any], list[str]]:
        needed, rest = len(request.state), request.rest
        if needed > MOST_PARTICLES or (rest is not None and len(rest) != needed):
            given = f"{needed} particles" + (f" and a rest shape of {len(rest)}" if rest is not None else "")
            raise DataError(
                given, "predict", f"give the same number, at most {MOST_PARTICLES}; plan takes whole clouds"
            )
        sizes = self.model.trained.sizes if self.model.trained is not None else None
        whole = sizes is not None and needed >= self.model.trained.particles  # type: ignore[union-attr]
        warnings = check_object(request.state, request.state, sizes) if whole else []  # type: ignore[arg-type]
        starts, ends = ([getattr(stroke, end) for stroke in request.strokes] for end in ("start", "end"))
        strokes = Strokes.of(starts, ends, [mode_number(stroke.mode) for stroke in request.strokes])
        begin = time.perf_counter()
        after = self.model.predict(request.state, strokes, rest=rest)
        if not np.isfinite(after).all():
            raise DataError(
                "the prediction is not finite", "predict", "give particles of an object, some centimetres large"
            )
        seconds = {"predict": time.perf_counter() - begin}
        predicted = [written(one, request.encoding) for one in after]
        return {"predicted": predicted, "units": "m", "seconds": seconds}, warnings

    def _look(self, request: LookRequest) -> tuple[dict[str, Any], list[str], PiegraphError | None]:
        if self.eye is None:
            hint = "start the service with --recording RECORDING, or with --live too"
            raise UsageError("this service has no images to look at", "look", hint)
        begin = time.perf_counter()
        scene = self.eye.scene(request.source)
        images = time.perf_counter() - begin
        seen = look(*scene, self.eye.settings)
        value, warnings, error = look_value(seen, request.source or self.eye.what)
        value["seconds"] = {"images": images, "look": seen.seconds["total"]}
        if value["particles"] is not None:
            value["particles"] = written(value["particles"], request.encoding)
        if request.cloud:
            value["cloud"] = None if error else written(seen.cloud, request.encoding)
        return value, warnings, error

    def _info(self) -> dict[str, Any]:
        trained = self.model.trained
        return {
            "file": str(self.origin.file) if self.origin.file else None,
            "on_disk": self._on_disk(),
            "particles": self.model.particles,
            "modes": [mode_word(mode) for mode in trained.modes] if trained else None,
            "device": self.model.device,
            "settings": self.model.settings.model_dump(mode="json", exclude=HERE),
            "look": self.eye.what if self.eye else None,
            "commands": list(REQUESTS),
            "limits": {
                "bytes": MOST_BYTES,
                "points": MOST_POINTS,
                "particles": MOST_PARTICLES,
                "strokes": MOST_STROKES,
                "candidates": MOST_WORK,
            },
            "version": __version__,
        }

    def _on_disk(self) -> str:
        """Whether the model's file is the one that is served: same, replaced or gone. It is read only when it changed."""
        if self.origin.file is None:
            return "same"
        try:
            found = self.origin.file.stat()
        except OSError:
            return "gone"
        mark = (found.st_ino, found.st_size, found.st_mtime_ns)
        if self._seen[0] != mark:
            self._seen = mark, "same" if read_key(self.origin.file, "model") == self.origin.key else "replaced"
        return self._seen[1]


def envelope(
    command: str | None, result: dict[str, Any] | None, warnings: list[str], error: PiegraphError | None
) -> Reply:
    """The answer as one line: the names of the commands' `--json`."""
    value = {
        "command": command,
        "version": __version__,
        "result": result,
        "warnings": warnings,
        "error": error_object(error) if error else None,
    }
    return Reply(json.dumps(value, allow_nan=False).encode(), error.exit_code if error else 0)
