"""Settings of `plan` and `trials`."""

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import BeforeValidator, Field, model_validator

from piegraph_cli.dynamics.params import MODEL_NAMES, Label, PredictionParams
from piegraph_cli.environments.params import (
    ENVIRONMENT_NAMES,
    EnvironmentName,
    EnvironmentParams,
    EnvironmentSettings,
    SightParams,
    Tasks,
)
from piegraph_cli.params import Box, Boxes, Modes, Params, Pose2, Table, Thresholds, split_commas, split_pairs

TrialLabels = Annotated[tuple[Label | Literal["greedy"], ...], BeforeValidator(split_commas), Field(min_length=1)]


ENVIRONMENT = "ENV"
"""The last part of a path, or how it begins before a hyphen: the name of each environment."""
Looks = Literal["particles", "cameras"]
LOOK = "how --env is seen"

FIXED_GOALS = "goals of --env stay in place whatever the start, as the paper's; else each lies so far from its start"


class Place(NamedTuple):
    """Where points are: a file or folder, which of its frames, and which array of an .npz file."""

    file: Path
    frame: int | None = None
    key: str | None = None

    @classmethod
    def of(cls, text: str) -> "Place":
        """From FILE, FILE:FRAME, FILE.npz:KEY or FILE.npz:KEY:FRAME."""
        file, colon, frame = text.rpartition(":")
        numbered = bool(colon) and frame.lstrip("-").isdigit()
        file = file if numbered else text
        keyed = re.fullmatch(r"(.+\.npz):(.+)", file)
        file, key = keyed.groups() if keyed else (file, None)
        return cls(Path(file), int(frame) if numbered else None, key)

    @property
    def rest(self) -> str:
        """What stands behind the file's name."""
        return "".join(f":{part}" for part in (self.key, self.frame) if part is not None)


SEES = 3
"""Raised where plans through cameras see otherwise than before; the versions of `plan` and `trials` are of all plans."""


WEIGHED = 2
"""The same of plans with pushes and picks at once, where settings alone tell them: how they are weighed."""


class PlanParams(PredictionParams, EnvironmentParams):
    """Settings of `plan`."""

    query: ClassVar[tuple[str, ...]] = ("env", "state", "goal", "goal_pose", "goal_at")
    """What is asked. Giving any of these on the command line forgets the others: an old goal must not move a robot."""

    later: ClassVar[tuple[str, ...]] = (
        "goal_at",
        "keep_out",
        "approach_height",
        "retreat",
        "speed",
        "look_every",
        "caution",
        "stop",
        "fixed_goals",
        "look",
        "keep",
        "sight",
        "accept",
    )

    env: EnvironmentName | None = Field(None, description="simulated environment to act in, closed loop")
    state: Path | None = Field(None, description="the object now: cloud (.ply, .npz, .h5), or images as for look")
    goal: str | None = Field(None, description="goal: a cloud FILE[:KEY][:FRAME]")
    goal_pose: Pose2 | None = Field(None, description="goal: moved by DX,DY [m],DYAW [rad] from now")
    goal_at: Pose2 | None = Field(None, description="goal: pose X,Y [m],YAW [rad] in the world")
    table: Table | None = Field(
        None,
        description="plane of the table in the world of --state and --goal: HEIGHT [m], or HEIGHT,SLOPE_X,SLOPE_Y "
        "(default: as ingest.table)",
    )
    frame: Literal["world", "robot"] = Field("world", description="whose coordinates strokes are told in")
    cameras: Path | None = Field(
        None, description="cameras.json with T_world_robot, for --frame robot (default: the recording's)"
    )
    model: Label = Field("piegraph", description=f"model that predicts: {MODEL_NAMES}")
    cost: Literal["auto", "distance", "chamfer", "emd"] = Field(
        "auto",
        description="particle, earth mover's or chamfer distance; auto: the first if goal and object have one shape, else emd",
    )
    modes: Modes = Field((), description="kinds of strokes: push, pick (default: what model and environment both know)")
    planner: Literal["cem", "mppi", "greedy"] = Field(
        "cem", description="cross-entropy method, path integrals, or picking the worst particle without a model"
    )
    horizon: int = Field(1, ge=1, description="strokes planned ahead")
    samples: int = Field(100, ge=4, description="candidates per iteration")
    cem_iterations: int = Field(5, ge=1, description="iterations of the planner")
    converged: float = Field(2e-4, ge=0, description="CEM ends when its elites' costs lie within this [m]")
    elites: float = Field(0.1, gt=0, le=1, description="share of candidates that are elites of CEM")
    temperature: float = Field(0.005, ge=1e-6, description="cost that MPPI finds much [m]")
    noise: float = Field(0.1, gt=0, description="deviation of MPPI's candidates, as a share of the range")
    look_every: int = Field(
        1, ge=1, description="strokes of a plan that are carried out in --env before it looks again"
    )
    remember: bool = Field(
        True,
        description="a stroke of the episode that did not do as predicted counts by its error, and what is like it",
    )
    caution: float = Field(
        0.0,
        ge=0,
        description="weight of the error to expect of a prediction in its cost, for what was evaluated (0: none)",
    )
    stop: bool = Field(
        False, description="end an episode in --env when no stroke is expected to help by more than its expected error"
    )
    strokes: int = Field(13, ge=1, description="most strokes in one episode")
    state_noise: float = Field(
        0.0, ge=0, description="noise on the particles that the planner sees in --env, to test it [m]"
    )
    success: float = Field(0.02, gt=0, description="an episode has succeeded below this distance [m]")
    look: Looks = Field("particles", description=LOOK)
    accept: Annotated[tuple[str, ...], BeforeValidator(split_commas)] = Field(
        (), description="checks of a look that may be bad, as in `look --accept`: NAME,..."
    )
    keep: Literal["auto", "resample", "track"] = Field(
        "auto",
        description="particles with --look cameras: fresh ones at every look, or carried on by 5 Hz frames of the stroke; auto "
        "carries on those of sheets",
    )
    sight: Annotated[SightParams, BeforeValidator(split_pairs)] = Field(
        SightParams(), description="how the cameras of --look cameras see: NAME=VALUE,... (docs/trials.md)"
    )
    episodes: int = Field(1, ge=1, description="episodes in --env")
    fixed_goals: bool = Field(False, description=FIXED_GOALS)
    min_length: float = Field(0.02, ge=0.001, description="shortest stroke [m]")
    max_length: float = Field(0.14, gt=0, description="longest push [m]")
    max_carry: float = Field(0.3, gt=0, description="furthest that a pick carries along x and along y [m]")
    pusher_radius: float = Field(
        0.01, gt=0, description="radius of the robot's pusher [m]; in --env the default means that of its pusher"
    )
    margin: float = Field(0.002, ge=0, description="how far the object reaches beyond its particles [m]")
    workspace: Box = Field(
        (-0.45, 0.45, -0.45, 0.45, -0.02, 0.35), description="strokes stay inside: xmin,xmax,ymin,ymax,zmin,zmax [m]"
    )
    keep_out: Boxes = Field(
        (), description="boxes that the tool keeps out of: xmin,xmax,ymin,ymax,zmin,zmax;... [m], as --workspace"
    )
    approach_height: float = Field(0.1, gt=0, description="height above the table at which the tool comes and goes [m]")
    retreat: float = Field(0.02, ge=0, description="how far a push goes back along itself before the tool rises [m]")
    speed: float = Field(0.1, ge=1e-3, le=10, description="of the tool, all along its path [m/s]")
    seed: int = Field(0, ge=0, description="seed of starts, goals and candidates")

    @model_validator(mode="after")
    def _check_lengths(self) -> "PlanParams":
        if self.min_length >= self.max_length:
            raise ValueError(f"min_length {self.min_length:g} is not below max_length {self.max_length:g}")
        if self.look_every > self.horizon:
            raise ValueError(f"look_every {self.look_every} is more than horizon {self.horizon}: so many are planned")
        if self.look == "cameras" and self.state_noise:
            raise ValueError("state_noise is for look = particles: cameras have noise of their own, sight.noise")
        return self

    def goal_place(self) -> Place:
        """The goal's file, frame and array."""
        assert self.goal is not None
        return Place.of(self.goal)

    def state_place(self) -> Place:
        """The file or folder of the state, its frame and array."""
        assert self.state is not None
        return Place.of(str(self.state))

    def _placed(self) -> dict[str, Place]:
        goal = {"goal": self.goal_place()} if self.goal else {}
        return goal | ({"state": self.state_place()} if self.state else {})

    def content(self) -> dict[str, Any]:
        """As for all settings, and the frames of goal and state: of these files alone the content counts.

        Without how a plan is told; a table at z = 0, no file with the robot, and cameras that nobody sees by are left out.
        """
        placed = self._placed().items()
        frames: dict[str, Any] = {f"{name}_frame": place.frame for name, place in placed if place.frame is not None}
        frames |= {f"{name}_key": place.key for name, place in placed if place.key is not None}
        unsaid = {"frame"} | ({"table"} if not any(self.table or ()) else set()) | ({"cameras"} - {*self.files()})
        if self.look == "particles":
            unsaid |= {"keep", "sight"}
        else:
            frames |= {"sees": SEES}
        if len(self.modes) > 1 or (not self.modes and self.env in (None, "cloth")):
            frames |= {"weighed": WEIGHED}
        return {name: value for name, value in super().content().items() if name not in unsaid} | frames

    def files(self) -> dict[str, Path]:
        """As for all settings, and the goal's file; without frames and arrays."""
        return super().files() | {name: place.file for name, place in self._placed().items()}

    def placed(self, base: Path) -> dict[str, str]:
        """As for all settings; a frame and an array stay behind their file."""
        places = super().placed(base)
        return places | {name: places[name] + place.rest for name, place in self._placed().items()}


class TrialsParams(EnvironmentParams):
    """Settings of `trials`: the grid environments x models x goals x seeds of the paper's planning experiment."""

    envs: Tasks = Field(
        ("tblock", "rope-stiff", "rope-bendy", "tshirt"),
        description=f"simulated environments, of {ENVIRONMENT_NAMES}; tshirt:crumpled, cloth:crumpled: with such goals",
    )
    models: TrialLabels = Field(
        ("piegraph", "piegraph-ng", "static"),
        description=f"models to compare, of {MODEL_NAMES}; greedy: picks without a model",
    )
    goals: int = Field(10, ge=1, le=1000, description="goals per environment")
    seeds: int = Field(10, ge=1, le=100, description="starts per goal")
    fixed_goals: bool = Field(False, description=FIXED_GOALS)
    look: Looks = Field("particles", description=LOOK)
    strokes: int = Field(30, ge=1, description="most strokes in one trial")
    thresholds: Thresholds = Field(
        (0.02, 0.03, 0.05, 0.1), description="distances that count as success; the smallest one ends a trial [m]"
    )
    trained: Path | None = Field(
        None,
        description=f"folder with a trained run per environment, by its name (default: the one the run lies in), or a "
        f"run's folder with {ENVIRONMENT} in place of that name",
    )
    options: EnvironmentSettings = Field(
        {}, description="options of the environments: ENV.NAME=VALUE,... (docs/environments.md)"
    )
    plan: dict[str, Any] = Field({}, description="settings of `plan` in place of those of the trained runs")

    def trained_run(self, env: str, beside: Path) -> Path:
        """The folder of an environment's trained run, for trials in a run that lies in the folder `beside`."""
        given = self.trained or beside
        named = given.name == ENVIRONMENT or given.name.startswith(f"{ENVIRONMENT}-")
        return given.with_name(given.name.replace(ENVIRONMENT, env, 1)) if named else given / env


class TrialParams(Params):
    """Everything one trial depends on."""

    later = ("metrics",)

    goal: int = Field(ge=0, description="number of the goal")
    seed: int = Field(ge=0, description="number of the start")
    network: Path | None = Field(description="model artifact of the trained run; None where nothing is trained")
    metrics: Path | None = Field(None, description="metrics artifact of the same, where expected errors count")
    plan: PlanParams = Field(description="planning settings in force, with environment, model, strokes and success")

    def content(self) -> dict[str, Any]:
        """As for all settings, those of the plan too."""
        return super().content() | {"plan": self.plan.content()}

    def files(self) -> dict[str, Path]:
        """None: the network counts by the key of its artifact, and may be missing."""
        return {}

    def artifacts(self) -> dict[str, tuple[Path, str]]:
        """The network, and its metrics."""
        named = {"network": (self.network, "model"), "metrics": (self.metrics, "metrics")}
        return {name: (path, what) for name, (path, what) in named.items() if path}
