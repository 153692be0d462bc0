"""Settings of simulated environments, by name, and of `simulate`."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from piegraph_cli.params import Modes, Params, split_commas


def _settings(value: object) -> object:
    """`young=3e4,goal=crumpled` on the command line means a table of settings."""
    if not isinstance(value, str):
        return value
    pairs = [part.partition("=") for part in value.split(",") if part.strip()]
    if any(not equals for _, equals, _ in pairs):
        raise ValueError("give NAME=VALUE,NAME=VALUE")
    return {name.strip(): text.strip() for name, _, text in pairs}


EnvironmentName = Literal[
    "tblock", "rope-stiff", "rope-bendy", "tshirt", "cloth", "toy", "daxbench-rope", "daxbench-tshirt"
]
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
Environments = Annotated[tuple[EnvironmentName, ...], BeforeValidator(split_commas), Field(min_length=1)]
EnvironmentSettings = Annotated[dict[str, float | str], BeforeValidator(_settings)]


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
    daxbench_python: Path | None = Field(None, description="interpreter for daxbench-* (docs/daxbench.md)")
    daxbench_repo: Path | None = Field(None, description="DaXBench repository for daxbench-*")

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


class SimulateParams(SequenceParams):
    """Settings of `simulate`: true particles of random strokes in a simulated environment."""

    sequences: int = Field(20, ge=1, description="sequences to simulate")
