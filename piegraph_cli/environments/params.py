"""Settings of simulated environments, by name, and of `simulate`."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from piegraph_cli.params import Modes, Params, split_commas, split_pairs


def _spaced(value: object) -> object:
    """`0 0 0.01` inside a table on the command line means a list."""
    return value.split() if isinstance(value, str) else value


EnvironmentName = Literal[
    "tblock", "rope-stiff", "rope-bendy", "tshirt", "cloth", "toy", "daxbench-rope", "daxbench-tshirt"
]
TaskName = Literal[EnvironmentName, "tshirt:crumpled", "cloth:crumpled"]
ENVIRONMENT_HELP: dict[str, str] = {
    "tblock": "a rigid T-shaped block, pushed (Pymunk)",
    "rope-stiff": "a rope that hardly bends, pushed (MuJoCo)",
    "rope-bendy": "a rope that bends where it is pushed (MuJoCo)",
    "tshirt": "a T-shirt, picked up or pushed (MuJoCo)",
    "cloth": "a square cloth, picked up or pushed (MuJoCo)",
    "toy": "a soft toy with head, arms and legs, pushed (MuJoCo)",
    "daxbench-rope": "DaXBench's rope, pushed (docs/daxbench.md)",
    "daxbench-tshirt": "DaXBench's T-shirt, picked up (docs/daxbench.md)",
}
"""What each environment is, in a line."""
ENVIRONMENT_NAMES = ", ".join(ENVIRONMENT_HELP)
SIMULATORS: dict[str, str] = {
    name: "Pymunk" if name == "tblock" else "DaXBench" if name.startswith("daxbench") else "MuJoCo"
    for name in ENVIRONMENT_HELP
}
"""What moves each of them."""
Numbers3 = Annotated[tuple[float, float, float], BeforeValidator(_spaced)]
Tasks = Annotated[tuple[TaskName, ...], BeforeValidator(split_commas), Field(min_length=1)]
Environments = Annotated[tuple[EnvironmentName, ...], BeforeValidator(split_commas), Field(min_length=1)]
EnvironmentSettings = Annotated[dict[str, float | str], BeforeValidator(split_pairs)]


def split_task(task: str) -> tuple[str, dict[str, str]]:
    """The environment of a task, and the option that asks for its kind of goals: `tshirt:crumpled` has crumpled ones."""
    environment, _, goals = task.partition(":")
    return environment, {"goal": goals} if goals else {}


class TBlockOptions(Params):
    """The T-block."""

    friction: float = Field(0.85, ge=0, description="Coulomb coefficient between block and pusher")
    turning_length: float = Field(0.06, gt=0, description="how hard it turns against how hard it slides [m]")


class RopeOptions(Params):
    """A rope; the stiff one by default."""

    young: float = Field(2e6, gt=0, description="Young's modulus [Pa]")
    length: float = Field(0.4, gt=0, description="length [m]")
    radius: float = Field(0.008, gt=0, description="radius [m]")
    density: float = Field(500.0, gt=0, description="density [kg/m3]")
    friction: float = Field(0.6, ge=0, description="Coulomb coefficient with table and pusher")
    curl: float = Field(0.0, description="shape memory: the angle through which the rope bends at rest [rad]")


class BendyRopeOptions(RopeOptions):
    """A rope that keeps the shape it is pushed into."""

    young: float = Field(2e4, gt=0, description="Young's modulus [Pa]")


class ClothOptions(Params):
    """A square cloth."""

    size: float = Field(0.3, gt=0, description="width and height [m]")
    young: float = Field(3e4, gt=0, description="Young's modulus [Pa]")
    density: float = Field(0.25, gt=0, description="mass per area [kg/m2]")
    friction: float = Field(0.6, ge=0, description="Coulomb coefficient with table, pusher and itself")
    goal: Literal["moved", "crumpled"] = Field(
        "moved", description="goals: moved up to 15 cm and turned up to 70 degrees, or what two random picks make"
    )


class TShirtOptions(ClothOptions):
    """A T-shirt."""


class ToyOptions(Params):
    """A soft toy with limbs."""

    young: float = Field(3e3, gt=0, description="Young's modulus [Pa]")
    mass: float = Field(0.15, gt=0, description="mass [kg]")
    size: float = Field(0.2, gt=0, description="length from head to feet [m]")
    friction: float = Field(0.6, ge=0, description="Coulomb coefficient with table and pusher")


VARIABLES = {"python": "PIEGRAPH_DAXBENCH_PYTHON", "repo": "PIEGRAPH_DAXBENCH_REPO"}
"""Of the shell, that name what runs DaXBench where its options are not given."""


class DaXBenchOptions(Params):
    """An environment of DaXBench, run by an interpreter of its own (docs/daxbench.md)."""

    python: Path | None = Field(None, description="interpreter that has DaXBench's packages")
    repo: Path | None = Field(None, description="folder of the DaXBench repository")
    timeout: float = Field(600.0, gt=0, description="longest wait for one answer of DaXBench [s]")


class EnvironmentParams(Params):
    """What a simulated environment needs beside its name."""

    options: EnvironmentSettings = Field(
        {}, description="options of the environment: NAME=VALUE,... (docs/environments.md)"
    )
    daxbench_python: Path | None = Field(
        None, description=f"interpreter for daxbench-* [default: ${VARIABLES['python']}]"
    )
    daxbench_repo: Path | None = Field(
        None, description=f"DaXBench repository for daxbench-* [default: ${VARIABLES['repo']}]"
    )

    def content(self) -> dict[str, Any]:
        """As for all settings, without what runs DaXBench and how long it is waited for."""
        options = {name: value for name, value in self.options.items() if name not in ("python", "repo", "timeout")}
        return super().content() | {"options": options, "daxbench_python": None, "daxbench_repo": None}

    def files(self) -> dict[str, Path]:
        """As for all settings, without what runs DaXBench: its content is not the run's."""
        return {k: v for k, v in super().files().items() if not k.startswith("daxbench_")}


class SequenceParams(EnvironmentParams):
    """Everything that one simulated sequence depends on, beside its number."""

    environment: EnvironmentName = Field("tblock", description="simulated environment, by name")
    strokes: int = Field(4, ge=1, description="strokes per sequence")
    modes: Modes = Field(
        (), description="kinds of strokes, at random: push, pick (default: the environment's main one)"
    )
    particles: int = Field(50, ge=4, le=2000, description="particles per object")
    seed: int = Field(0, ge=0, description="seed; sequence i depends on (seed, i) alone")


MOST_CAMERAS = 8
Texture = Literal["plain", "faint", "print"]
PATTERNED = ("tshirt", "cloth")
"""Environments whose object can have a pattern."""


class TroubleParams(Params):
    """What goes wrong in a rendered recording, on purpose; truth.h5 says what was done."""

    of: Annotated[tuple[Annotated[int, Field(ge=0, lt=MOST_CAMERAS)], ...], BeforeValidator(_spaced)] = Field(
        (1,), description="numbers of the cameras that are moved, turned, late or have unregistered depth"
    )
    noise: float = Field(1.0, ge=0, le=10, description="noise of the sensors, times a D455's")
    dropped: float = Field(0.0, ge=0, lt=1, description="share of each camera's frames that are lost, at random")
    late: float = Field(
        0.0, ge=-10, le=10, description="how far what the cameras show lies behind their time stamps [s]"
    )
    moved: Numbers3 = Field(
        (0.0, 0.0, 0.0), description="how far cameras.json has them from where they are, along the world's axes [m]"
    )
    turned: Numbers3 = Field(
        (0.0, 0.0, 0.0), description="how cameras.json has them turned, about the world's axes, at their place [deg]"
    )
    aside: float = Field(
        0.0, ge=-0.2, le=0.2, description="depth is seen from so far to the right of colour, and not registered [m]"
    )
    hidden: int = Field(0, ge=0, description="frames in which half of the object is under an opaque box")
    hidden_from: int = Field(-1, ge=-1, description="the first of them; -1: they lie about the middle of the recording")
    gone_from: int = Field(-1, ge=-1, description="frame from which on the object is out of view; -1: never")
    beside: Literal["none", "same", "other"] = Field(
        "none", description="a second thing beside the object that nobody touches, of the same or of another colour"
    )
    beside_size: float = Field(0.08, gt=0, le=0.3, description="length of that thing [m]")
    resting_hand: bool = Field(False, description="a second hand rests on the table")
    bend: float = Field(
        0.0, ge=-180, le=180, description="angle through which pushes turn without lifting, to either side [deg]"
    )
    corners: int = Field(3, ge=1, le=8, description="in how many corners they turn")


class SightParams(Params):
    """How the cameras over a simulated table see, where a plan looks through them."""

    cameras: int = Field(4, ge=1, le=MOST_CAMERAS, description="cameras")
    noise: float = Field(1.0, ge=0, le=10, description="noise of depth, times a D455's")
    moved: float = Field(0.0, ge=0, le=0.1, description="how far each camera is from where it is said to be [m]")
    turned: float = Field(0.0, ge=0, le=20, description="how far it is turned from how it is said to be [deg]")
    arm: bool = Field(False, description="the arm stays where its stroke ended, or else goes out of view")


class RecordingParams(SequenceParams):
    """Everything that one rendered sequence depends on, beside its number."""

    later = ("cameras", "trouble", "texture")

    cameras: int = Field(4, ge=1, le=MOST_CAMERAS, description="cameras of a rendered recording")
    trouble: Annotated[TroubleParams, BeforeValidator(split_pairs)] = Field(
        TroubleParams(), description="what goes wrong in a rendered recording: NAME=VALUE,... (docs/environments.md)"
    )

    texture: Texture = Field("plain", description="pattern of a rendered cloth: plain, faint or print")

    @model_validator(mode="after")
    def _check_texture(self) -> "RecordingParams":
        if self.texture != "plain" and self.environment not in PATTERNED:
            raise ValueError(f"{self.environment} has no pattern: texture is for {', '.join(PATTERNED)}")
        return self

    @model_validator(mode="after")
    def _check_cameras(self) -> "RecordingParams":
        usual, single = TroubleParams(), ("of", "late", "moved", "turned", "aside")
        asked = any(getattr(self.trouble, name) != getattr(usual, name) for name in single)
        unknown = [k for k in self.trouble.of if k >= self.cameras]
        if unknown and asked:
            raise ValueError(f"trouble.of: there is no camera {unknown[0]}, {self.cameras} are numbered from 0")
        return self


class SimulateParams(RecordingParams):
    """Settings of `simulate`: true particles of random strokes in a simulated environment."""

    sequences: int = Field(20, ge=1, le=100_000, description="sequences to simulate")
