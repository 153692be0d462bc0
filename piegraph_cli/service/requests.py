"""What may be asked: a model of each kind of request, which refuses unknown fields and bounds sizes; and how clouds travel."""

import base64
import binascii
import json
from typing import Annotated, Any, Literal, NoReturn

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.params import Mode, Pose2

MOST_BYTES = 8 << 20
"""Of one request."""
MOST_POINTS = 300_000
"""Of one cloud: what a depth image gives."""
MOST_PARTICLES = 1_000
"""Of an object whose strokes are predicted."""
MOST_STROKES = 1_000
"""Predicted in one request."""
FARTHEST = 100.0
"""Metres from the origin: coordinates beyond are millimetres, or none at all."""

Encoding = Literal["lists", "base64"]


def points_of(value: Any) -> np.ndarray:
    """Points [P, 3] float32 (m) of a list of [x, y, z], or of base64 text of little-endian float32. Raises ValueError."""
    if isinstance(value, str):
        array = _decoded(value)
    elif isinstance(value, list):
        array = _listed(value)
    else:
        raise ValueError("give points as a list of [x, y, z], or as base64 of little-endian float32")
    if not 0 < len(array) <= MOST_POINTS:
        raise ValueError(f"{len(array)} points: give 1 to {MOST_POINTS}")
    if not np.isfinite(array).all():
        raise ValueError(f"point {int((~np.isfinite(array)).any(1).argmax())} is not finite")
    if np.abs(array).max() > FARTHEST:
        raise ValueError(f"a coordinate beyond {FARTHEST:g} m: points are metres in the world frame")
    return array


def _decoded(text: str) -> np.ndarray:
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise ValueError("not base64") from None
    if len(data) % 12:
        raise ValueError(f"{len(data)} bytes are no rows of three float32")
    return np.frombuffer(data, "<f4").reshape(-1, 3).astype(np.float32)


def _listed(value: list) -> np.ndarray:
    try:
        array = np.array(value)
    except ValueError:
        raise ValueError("points are rows of three numbers") from None
    if array.size and (array.dtype.kind not in "iuf" or array.ndim != 2 or array.shape[1] != 3):
        raise ValueError("points are rows of three numbers")
    with np.errstate(over="ignore"):
        return array.reshape(-1, 3).astype(np.float32)


def written(points: Any, encoding: Encoding) -> Any:
    """Points [..., 3] (m) for an answer: lists to a thousandth of a millimetre, or base64 of little-endian float32."""
    array = np.asarray(points, "<f4")
    if encoding == "base64":
        return base64.b64encode(array.tobytes()).decode()
    return np.round(array.astype(float), 6).tolist()


Points = Annotated[Any, BeforeValidator(points_of)]
Planar = tuple[Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)], Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]]


class Request(BaseModel):
    """Base of all requests."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class InfoRequest(Request):
    """What is served."""


class PlanRequest(Request):
    """The next strokes for an object, as `Model.plan`."""

    state: Points
    """The object's cloud now."""
    goal: Points | None = None
    """A cloud of the goal."""
    goal_pose: Pose2 | None = None
    """The goal as a motion of the object: [DX, DY (m), DYAW (rad)]."""
    candidates: int = Field(0, ge=0, le=1000)
    """How many of the best candidates to tell."""
    encoding: Encoding = "lists"
    """How clouds are answered."""
    settings: dict[str, Any] = Field({}, max_length=50)
    """Settings of `piegraph plan`, by name."""


class StrokeRequest(Request):
    """One stroke to predict."""

    start: Planar
    end: Planar
    mode: Mode = "push"


class PredictRequest(Request):
    """What the object's particles do under strokes, each from the same state, as `Model.predict`."""

    state: Points
    """The object's particles now."""
    strokes: list[StrokeRequest] = Field(min_length=1, max_length=MOST_STROKES)
    rest: Points | None = None
    """The object's rest shape, in the same order of particles; where left out, the state."""
    encoding: Encoding = "lists"


class LookRequest(Request):
    """The object in one image of each camera."""

    source: str | None = Field(None, min_length=1, max_length=200, pattern=r"^[^/\\\x00]+$")
    """SEQUENCE or SEQUENCE:FRAME of the served recording; left out: what its cameras see now."""
    cloud: bool = False
    """Whether the whole cloud is answered, beside the particles."""
    encoding: Encoding = "lists"


REQUESTS: dict[str, type[Request]] = {
    "plan": PlanRequest,
    "predict": PredictRequest,
    "look": LookRequest,
    "info": InfoRequest,
}


def parsed(data: bytes) -> dict[str, Any]:
    """The JSON object of a request. Raises `DataError` where it is none."""
    if len(data) > MOST_BYTES:
        hint = "send large clouds as base64 of float32, or fewer points"
        raise DataError(f"a request of more than {MOST_BYTES >> 20} MB", "request", hint)
    try:
        value = json.loads(data or b"{}", parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        reason = str(error).splitlines()[0][:200]
        raise DataError(f"not JSON: {reason}", "request", "send one JSON object, without NaN and Infinity") from None
    if not isinstance(value, dict):
        raise DataError(f"not a JSON object but {type(value).__name__}", "request", 'as in {"command": "info"}')
    return value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number of JSON")


def request_of(command: Any, fields: dict[str, Any]) -> Request:
    """A request with its fields checked. Raises `UsageError` for what there is not, and wrong fields."""
    if not isinstance(command, str) or command not in REQUESTS:
        given = f"no command {command!r:.40}" if command is not None else "no command is named"
        raise UsageError(given, "request", f"one of {', '.join(REQUESTS)}")
    model = REQUESTS[command]
    try:
        return model.model_validate(fields)
    except ValidationError as error:
        problem = error.errors(include_input=False, include_url=False)[0]
    where = ".".join([command, *(str(part)[:60] for part in problem["loc"])])
    if problem["type"] == "extra_forbidden":
        raise UsageError("unknown field", where, f"fields of {command}: {', '.join(model.model_fields)}")
    if problem["type"] == "missing":
        raise UsageError("the field is missing", where, f"fields of {command}: {', '.join(model.model_fields)}")
    raise UsageError(problem["msg"].removeprefix("Value error, ")[:500], where, "see docs/robot.md")
