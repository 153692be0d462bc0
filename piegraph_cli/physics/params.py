"""Settings of `track` and of the guidance by springs."""

from typing import Literal

from pydantic import Field, model_validator

from piegraph_cli.params import Lengths, Params


class TrackParams(Params):
    """Settings of `track`."""

    later = ("object",)

    association: Literal["soft", "nearest"] = Field("soft", description="soft assignment, or the paper's nearest point")
    particles: int = Field(50, ge=4, le=2000, description="particles exported")
    tracked: int = Field(150, ge=4, le=2000, description="particles tracked; the first ones are exported")
    damping: float = Field(0.8, gt=0, lt=1, description="velocity kept per step, delta")
    stiffness: float = Field(0.15, gt=0, description="spring stiffness k dt^2/m, lowered to 0.8 of the stability bound")
    gain: float = Field(0.03, gt=0, description="proportional gain Kp dt^2/m")
    rounds: int = Field(20, ge=3, description="assignments per frame")
    iterations: int = Field(10, ge=1, description="spring iterations after each assignment")
    scales: Lengths = Field((0.020, 0.012, 0.008), description="widths of the assignment, in turn over the rounds [m]")
    points: int = Field(800, ge=20, description="points a cloud is thinned to for the assignment")
    mode: Literal["push", "pick"] = Field("push", description="how the hand moves the object")
    object: Literal["auto", "sheet", "solid"] = Field(
        "auto",
        description="what is followed: a sheet by its colours too; auto: a sheet where the first frame shows one",
    )

    @model_validator(mode="after")
    def _check_counts(self) -> "TrackParams":
        if self.particles > self.tracked:
            raise ValueError(f"{self.particles} particles cannot be exported of {self.tracked} tracked ones")
        return self

    @property
    def turns(self) -> list[int]:
        """How many of the rounds each scale gets."""
        share, more = divmod(self.rounds, len(self.scales))
        return [share + (k < more) for k in range(len(self.scales))]


class GuidanceParams(Params):
    """How springs follow a setpoint. Gains are dimensionless: k dt^2/m for springs, Kp dt^2/m for the controller."""

    stiffness: float = Field(0.15, ge=0, description="spring stiffness k dt^2/m")
    gain: float = Field(0.03, ge=0, description="proportional gain Kp dt^2/m")
    damping: float = Field(0.8, gt=0, le=1, description="velocity kept per step, delta")
    integral: float = Field(0.0, ge=0, description="integral gain; above 0, convergence undoes the guidance")
    integral_limit: float = Field(0.1, ge=0, description="longest summed error of a particle [m x iterations]")
    derivative: float = Field(0.0, ge=0, description="derivative gain")
    friction: float = Field(0.0, ge=0, description="Coulomb coefficient of the table")
    tension_only: bool = Field(False, description="springs pull but never push, as in cloth")
    iterations: int = Field(200, ge=1, description="most iterations of the springs")
    tolerance: float = Field(1e-5, ge=0, description="springs are at rest below this motion per iteration [m]")
