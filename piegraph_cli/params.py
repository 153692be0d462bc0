"""Every setting of every stage: one frozen model per stage, the source of CLI options, recipe checks and cache keys.

Nothing heavy is imported here, so that `piegraph --help` answers at once. The core takes these models as they are.
"""

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializeAsAny,
    ValidationError,
    model_validator,
)

from piegraph_cli.errors import UsageError


def _split(value: object) -> object:
    """`1,2,3` on the command line means a list."""
    return [part.strip() for part in value.split(",")] if isinstance(value, str) else value


def _settings(value: object) -> object:
    """`young=3e4,goal=crumpled` on the command line means a table of settings."""
    if not isinstance(value, str):
        return value
    pairs = [part.partition("=") for part in value.split(",") if part.strip()]
    if any(not equals for _, equals, _ in pairs):
        raise ValueError("give NAME=VALUE,NAME=VALUE")
    return {name.strip(): text.strip() for name, _, text in pairs}


def _check_box(box: tuple[float, ...]) -> tuple[float, ...]:
    for axis, low, high in zip("xyz", box[::2], box[1::2], strict=True):
        if low >= high:
            raise ValueError(f"{axis}min {low:g} is not below {axis}max {high:g}: give xmin,xmax,ymin,ymax,zmin,zmax")
    return box


ModelName = Literal[
    "piegraph",
    "piegraph-ng",
    "kabsch",
    "egnn-g",
    "gnn",
    "gnn-aug",
    "sms-no",
    "sms-o",
    "pgnd",
    "gbnd",
    "static",
]
EnvironmentName = Literal[
    "tblock", "rope-stiff", "rope-bendy", "tshirt", "cloth", "toy", "daxbench-rope", "daxbench-tshirt"
]
Mode = Literal["push", "pick"]
PUSH, PICK = 0, 1
MODE_NAMES = get_args(Mode)
"""Names of the modes of a stroke, by number."""
TRAINED_AS = {"piegraph-ng": "piegraph", "kabsch": "piegraph", "static": None, "sms-no": None, "greedy": None}
"""Whose weights a model uses that has none of its own."""


def split_label(label: str) -> tuple[str, str, int | None]:
    """Model, variant of its settings and number of training sequences of `pgnd:fine@20`; "" and None where not given."""
    model, _, count = label.partition("@")
    name, _, variant = model.partition(":")
    return name, variant, int(count) if count else None


def trained_label(label: str) -> str | None:
    """What must be trained for a model: `piegraph@20` for `piegraph-ng@20`; None where nothing is."""
    name = re.split("[:@]", label, maxsplit=1)[0]
    own = TRAINED_AS.get(name, name)
    return None if own is None else own + label[len(name) :]


_LABEL = re.compile(r"([a-z-]+)(:[a-z0-9_-]+)?(@[1-9][0-9]*)?")


def _check_label(label: str) -> str:
    parts = _LABEL.fullmatch(label)
    if parts is None:
        raise ValueError(f"{label!r} is no model: give NAME, NAME@SEQUENCES or NAME:VARIANT@SEQUENCES")
    if parts[1] not in get_args(ModelName):
        raise ValueError(f"no model {parts[1]}: {', '.join(get_args(ModelName))}")
    if trained_label(parts[1]) is None and parts[1] != label:
        raise ValueError(f"{label}: {parts[1]} is not trained, so it has no variants and learns from no sequences")
    return label


def _check_trainable(label: str) -> str:
    own = trained_label(_check_label(label))
    if own is None:
        raise ValueError(f"{label} is not trained")
    return own


Label = Annotated[str, AfterValidator(_check_label)]
"""A model by name; after : a variant of its settings (`train.variants`), after @ how many sequences it learns from."""
Labels = Annotated[tuple[Label, ...], BeforeValidator(_split), Field(min_length=1)]
TrialLabels = Annotated[tuple[Label | Literal["greedy"], ...], BeforeValidator(_split), Field(min_length=1)]
Pose2 = Annotated[tuple[float, float, float], BeforeValidator(_split)]
Box = Annotated[tuple[float, float, float, float, float, float], BeforeValidator(_split), AfterValidator(_check_box)]
Counts = Annotated[tuple[Annotated[int, Field(ge=1)], ...], BeforeValidator(_split), Field(min_length=1)]
Lengths = Annotated[
    tuple[Annotated[float, Field(gt=0)], ...], BeforeValidator(_split), Field(min_length=1, max_length=3)
]
Thresholds = Annotated[tuple[Annotated[float, Field(gt=0)], ...], BeforeValidator(_split), Field(min_length=1)]
Environments = Annotated[tuple[EnvironmentName, ...], BeforeValidator(_split), Field(min_length=1)]
Modes = Annotated[tuple[Mode, ...], BeforeValidator(_split)]
EnvironmentSettings = Annotated[dict[str, float | str], BeforeValidator(_settings)]


class Params(BaseModel):
    """Base of all settings: frozen, unknown keys refused, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    query: ClassVar[tuple[str, ...]] = ()
    """Settings that belong together: giving one forgets the others."""

    def files(self) -> dict[str, Path]:
        """Files and folders these settings name; their content, not their path, enters the cache key."""
        return {name: value for name, value in self if isinstance(value, Path)}


Settings = TypeVar("Settings", bound=Params)


def validated(params: type[Settings], values: Any, name: str, where: str, hint: str) -> Settings:
    """Settings of that type. Raises `UsageError` that names the first wrong one, as a part of `name`."""
    try:
        return params.model_validate(values)
    except ValidationError as error:
        problem = error.errors()[0]
        setting = ".".join([name, *(str(part) for part in problem["loc"])])
        if problem["type"] != "extra_forbidden":
            message = problem["msg"].removeprefix("Value error, ")
            raise UsageError(f"{setting}: {message}", where, hint) from None
        table: type[BaseModel] = params
        for part in problem["loc"][:-1]:
            inner = next((f.annotation for n, f in table.model_fields.items() if part in (n, f.alias)), None)
            table = inner if isinstance(inner, type) and issubclass(inner, BaseModel) else table
        known = ", ".join(field.alias or field_name for field_name, field in table.model_fields.items())
        of = setting.rpartition(".")[0]
        raise UsageError(f"{setting}: unknown setting", where, f"settings of {of}: {known}") from None


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

    def files(self) -> dict[str, Path]:
        """As for all settings; what runs DaXBench counts by its path, since its content is not the run's."""
        return {k: v for k, v in super().files().items() if not k.startswith("daxbench_")}


class SimulateParams(EnvironmentParams):
    """Settings of `simulate`: true particles of random strokes in a simulated environment."""

    environment: EnvironmentName = Field("tblock", description="simulated environment, by name")
    sequences: int = Field(20, ge=1, description="sequences to simulate")
    strokes: int = Field(4, ge=1, description="strokes per sequence")
    modes: Modes = Field(
        (), description="kinds of strokes, at random: push, pick (default: the environment's main one)"
    )
    particles: int = Field(50, ge=4, le=2000, description="particles per object")
    seed: int = Field(0, ge=0, description="seed; sequence i depends on (seed, i) alone")


class IngestParams(Params):
    """Settings of `ingest`: what is recorded, and where."""

    recording: Path | None = Field(None, description="recording folder (docs/formats.md)")
    fps: float = Field(5.0, gt=0, description="frames a second to resample to [Hz]")
    max_skew: float = Field(0.05, gt=0, description="largest difference in time between cameras in one frame [s]")
    workspace: Box = Field(
        (-0.45, 0.45, -0.45, 0.45, -0.02, 0.35),
        description="box of interest in the world: xmin,xmax,ymin,ymax,zmin,zmax [m]",
    )


class HandsParams(Params):
    """Settings of `hands`."""

    hand_model: Path | None = Field(None, description="hand_landmarker.task file (default: the fetched one)")
    max_gap: float = Field(0.5, ge=0, description="longest gap in the hand's path that is filled [s]")


class SegmentParams(Params):
    """Settings of `segment`."""

    segmenter: Literal["grabcut", "sam"] = Field("grabcut", description="how the object's mask is found")
    min_height: float = Field(0.006, gt=0, description="height above the table from which depth tells the object [m]")
    min_contrast: float = Field(
        0.25, gt=0, description="colour difference from the table that tells the object [log ratio]"
    )
    min_area: float = Field(4e-4, gt=0, description="smallest object, as table area covered [m2]")
    sam_checkpoint: Path | None = Field(None, description="weights for --segmenter sam")
    sam_model: Literal["vit_h", "vit_l", "vit_b", "tiny"] = Field("vit_b", description="SAM model of the checkpoint")
    sam_every: int = Field(10, ge=1, description="frames between SAM key frames; masks are propagated between them")
    prompts: dict[str, tuple[float, float, float, float]] = Field(
        {}, description="box x0,y0,x1,y1 [px] in the first frame, per camera; automatic where not given"
    )


class FuseParams(Params):
    """Settings of `fuse`."""

    voxel_size: float = Field(0.004, gt=0, description="edge of the voxel grid the cloud is thinned on [m]")
    contact_radius: float = Field(0.03, gt=0, description="hand and object closer than this touch [m]")


class TrackParams(Params):
    """Settings of `track`."""

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


class ScoreParams(Params):
    """Settings of `score`: none."""


class DatasetParams(Params):
    """Settings of `dataset`."""

    train: int = Field(10, ge=1, description="sequences to train on")
    validation: int = Field(0, ge=0, description="sequences to choose the checkpoint on (0: the last one is kept)")
    min_gap: int = Field(2, ge=1, description="fewest frames between the two frames of a training pair")
    min_stroke: float = Field(0.01, ge=0.001, description="shortest stroke that is kept [m]")
    seed: int = Field(0, ge=0, description="seed of the split")


class LearningParams(Params):
    """How any model is trained."""

    learning_rate: float = Field(2e-3, gt=0, description="learning rate at the start of the cosine")
    weight_decay: float = Field(1e-4, ge=0, description="AdamW weight decay")
    clip: float = Field(1.0, gt=0, description="largest gradient norm")
    batch: int = Field(8, ge=1, description="training examples per step")
    steps: int = Field(2600, ge=1, description="training steps")


class GraphParams(LearningParams):
    """Settings of the graph networks that predict a stroke at once."""

    neighbors: int = Field(12, ge=1, description="neighbours of a particle in the graph")
    hidden: int = Field(32, ge=1, description="width of the network")
    layers: int = Field(4, ge=1, description="message-passing layers")
    pool: bool = Field(True, description="mix the mean over all particles into each layer")
    shape_weight: float = Field(0.1, ge=0, description="weight of the shape loss")
    mirror: bool = Field(False, description="mirror half of the pairs: right where the mirror image moves alike")


class EGNNParams(GraphParams):
    """Settings of piegraph's network."""

    mirror: bool = Field(True, description="equivariant to reflection: wrong where left and right differ unseen")
    action_head: bool = Field(True, description="add a displacement in the stroke's frame")


class SMSParams(LearningParams):
    """The springs and the pusher of a spring-mass system alone, and how they are optimised."""

    learning_rate: float = Field(0.05, gt=0, description="learning rate at the start of the cosine")
    weight_decay: float = Field(0.0, ge=0, description="AdamW weight decay")
    batch: int = Field(2, ge=1, description="training sequences per step")
    steps: int = Field(120, ge=1, description="training steps")
    radius: float = Field(0.05, gt=0, description="particles closer than this are joined by a spring [m]")
    stride: float = Field(1e-3, gt=0, description="the hand's motion per iteration [m]")
    settle: int = Field(20, ge=0, description="iterations after the hand has stopped")
    stiffness: float = Field(0.15, gt=0, description="spring stiffness k dt^2/m at the start")
    damping: float = Field(0.8, gt=0, lt=1, description="velocity kept per iteration at the start")
    friction: float = Field(0.5, gt=0, description="Coulomb coefficient of the table at the start")
    gravity: float = Field(1e-4, gt=0, description="g dt^2 at the start [m]")
    reach: float = Field(0.015, gt=0, description="distance that the pusher keeps particles away, at the start [m]")
    tension_only: bool = Field(False, description="springs pull but never push, as in cloth")


class StepParams(LearningParams):
    """Settings of the models that predict frame by frame."""

    rollout: int = Field(3, ge=1, description="frames predicted in a row in training")
    noise: float = Field(0.002, ge=0, description="noise on the particles in training [m]")
    turn: bool = Field(True, description="turn every training example about the vertical by a random angle")


class PGNDParams(StepParams):
    """Settings of Particle-Grid Neural Dynamics."""

    learning_rate: float = Field(1e-3, gt=0, description="learning rate at the start of the cosine")
    weight_decay: float = Field(0.0, ge=0, description="AdamW weight decay")
    clip: float = Field(0.1, gt=0, description="largest gradient norm")
    steps: int = Field(2000, ge=1, description="training steps")
    rollout: int = Field(5, ge=1, description="frames predicted in a row in training")
    noise: float = Field(0.0, ge=0, description="noise on the particles in training [m]")
    cell: float = Field(0.02, gt=0, description="edge of a grid cell [m]")
    reach: float = Field(0.2, gt=0, description="particles within this of a node give its feature [m]")
    gripper: float = Field(0.04, gt=0, description="nodes within this of the hand take its velocity [m]")


class GBNDParams(StepParams):
    """Settings of graph-based neural dynamics with a tool node."""

    learning_rate: float = Field(1e-3, gt=0, description="learning rate at the start of the cosine")
    weight_decay: float = Field(0.0, ge=0, description="AdamW weight decay")
    steps: int = Field(1500, ge=1, description="training steps")
    hidden: int = Field(150, ge=1, description="width of the network")
    neighbors: int = Field(5, ge=1, description="neighbours of a particle in the graph")
    radius: float = Field(0.075, gt=0, description="particles further apart than this are no neighbours [m]")
    edge_weight: float = Field(0.05, ge=0, description="weight of the loss on edge lengths")


class TrainParams(Params):
    """Settings of `train`: which models, from which seeds, and a table of settings for each."""

    models: Annotated[tuple[Annotated[str, AfterValidator(_check_trainable)], ...], BeforeValidator(_split)] = Field(
        ("piegraph",), min_length=1, description="models to train, by name; pgnd@20: on 20 of the training sequences"
    )
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], BeforeValidator(_split)] = Field(
        (0,), min_length=1, description="seeds of weights, batches and choice of sequences; each trains every model"
    )
    checkpoint_every: int = Field(500, ge=1, description="steps between checkpoints")
    tensorboard: bool = Field(False, description="write TensorBoard events to RUN/tensorboard")
    piegraph: EGNNParams = Field(EGNNParams(), description="its settings")
    egnn_g: GraphParams = Field(GraphParams(), alias="egnn-g", description="its settings")
    gnn: GraphParams = Field(GraphParams(), description="its settings")
    gnn_aug: GraphParams = Field(GraphParams(), alias="gnn-aug", description="its settings")
    sms_o: SMSParams = Field(SMSParams(), alias="sms-o", description="its settings")
    pgnd: PGNDParams = Field(PGNDParams(), description="its settings")
    gbnd: GBNDParams = Field(GBNDParams(), description="its settings")
    variants: dict[str, dict[str, Any]] = Field({}, description="other settings of a model, by MODEL:VARIANT")

    def of(self, label: str) -> LearningParams:
        """The settings of one model. Raises `UsageError` for a variant that is not declared or does not fit the model."""
        name, variant, _ = split_label(label)
        settings: LearningParams = getattr(self, name.replace("-", "_"))
        if not variant:
            return settings
        key = f"{name}:{variant}"
        if key not in self.variants:
            raise UsageError(f"no variant {key}", "train.variants", f'a section [train.variants."{key}"] in the recipe')
        return validated(
            type(settings), settings.model_dump() | self.variants[key], f"train.variants.{key}", "recipe", ""
        )


LEARNED: dict[str, type[LearningParams]] = {
    name.replace("_", "-"): type(field.default)
    for name, field in TrainParams.model_fields.items()
    if isinstance(field.default, LearningParams)
}
"""What can be trained, by name, with its settings."""


class ModelParams(Params):
    """Everything that one trained model depends on."""

    label: str = Field(description="model; after : a variant, after @ the number of training sequences")
    seed: int = Field(ge=0, description="seed of weights, batches and choice of sequences")
    settings: SerializeAsAny[LearningParams] = Field(description="settings of the model")
    checkpoint_every: int = Field(500, ge=1, description="steps between checkpoints")
    tensorboard: bool = Field(False, description="write TensorBoard events to RUN/tensorboard")


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


class PredictionParams(GuidanceParams):
    """What a prediction by name needs: the springs' reach beside the guidance."""

    spring_radius: float = Field(0.05, gt=0, description="particles closer than this are joined by a spring [m]")


class EvaluateParams(PredictionParams):
    """Settings of `evaluate`."""

    models: Labels = Field(("static", "piegraph-ng", "piegraph", "kabsch"), description="models to compare, by name")
    horizons: Counts = Field((1, 2, 4), description="strokes predicted in a row")


class ModelEvaluateParams(PredictionParams):
    """Everything that the evaluation of one model depends on, beside what it learned."""

    label: str = Field(description="model; after : a variant, after @ the number of training sequences")
    horizons: Counts = Field(description="strokes predicted in a row")


class PlanParams(PredictionParams, EnvironmentParams):
    """Settings of `plan`."""

    query: ClassVar[tuple[str, ...]] = ("env", "state", "goal", "goal_pose")
    """What is asked. Giving any of these on the command line forgets the others: an old goal must not move a robot."""

    env: EnvironmentName | None = Field(None, description="simulated environment to act in, closed loop")
    state: Path | None = Field(None, description="cloud of the object now (.ply, .npz, .h5): print the next strokes")
    goal: str | None = Field(None, description="goal cloud FILE or FILE:FRAME (.ply, .npz, .h5)")
    goal_pose: Pose2 | None = Field(None, description="goal as a motion of the object: DX,DY [m],DYAW [rad]")
    model: Label = Field("piegraph", description="model that predicts, by name")
    cost: Literal["auto", "distance", "chamfer", "emd"] = Field(
        "auto",
        description="particle, chamfer or earth mover's distance; auto: the first where particles correspond, else chamfer",
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
    temperature: float = Field(0.005, gt=0, description="cost that MPPI finds much [m]")
    noise: float = Field(0.1, gt=0, description="deviation of MPPI's candidates, as a share of the range")
    strokes: int = Field(13, ge=1, description="most strokes in one episode")
    state_noise: float = Field(
        0.0, ge=0, description="noise on the particles that the planner sees in --env, to test it [m]"
    )
    success: float = Field(0.02, gt=0, description="an episode has succeeded below this distance [m]")
    episodes: int = Field(1, ge=1, description="episodes in --env, each from its own random start")
    min_length: float = Field(0.02, ge=0.001, description="shortest stroke [m]")
    max_length: float = Field(0.14, gt=0, description="longest push [m]")
    max_carry: float = Field(0.3, gt=0, description="furthest that a pick carries along x and along y [m]")
    pusher_radius: float = Field(0.01, gt=0, description="radius of the robot's pusher [m]")
    margin: float = Field(0.002, ge=0, description="how far the object reaches beyond its particles [m]")
    workspace: Box = Field(
        (-0.45, 0.45, -0.45, 0.45, -0.02, 0.35), description="strokes stay inside: xmin,xmax,ymin,ymax,zmin,zmax [m]"
    )
    seed: int = Field(0, ge=0, description="seed of starts, goals and candidates")

    @model_validator(mode="after")
    def _check_lengths(self) -> "PlanParams":
        if self.min_length >= self.max_length:
            raise ValueError(f"min_length {self.min_length:g} is not below max_length {self.max_length:g}")
        return self

    def goal_file(self) -> tuple[Path, int | None]:
        """The goal's file and frame, from FILE or FILE:FRAME."""
        assert self.goal is not None
        file, colon, frame = self.goal.rpartition(":")
        return (Path(file), int(frame)) if colon and frame.lstrip("-").isdigit() else (Path(self.goal), None)

    def files(self) -> dict[str, Path]:
        """As for all settings, and the goal's file."""
        return super().files() | ({"goal": self.goal_file()[0]} if self.goal else {})


class TrialsParams(EnvironmentParams):
    """Settings of `trials`: the grid environments x models x goals x seeds of the paper's planning experiment."""

    envs: Environments = Field(
        ("tblock", "rope-stiff", "rope-bendy", "tshirt"), description="simulated environments, by name"
    )
    models: TrialLabels = Field(
        ("piegraph", "piegraph-ng", "static"), description="models to compare, by name; greedy: picks without a model"
    )
    goals: int = Field(10, ge=1, description="goals per environment")
    seeds: int = Field(10, ge=1, description="starts per goal")
    strokes: int = Field(30, ge=1, description="most strokes in one trial")
    thresholds: Thresholds = Field(
        (0.02, 0.03, 0.05, 0.1), description="distances that count as success; the smallest one ends a trial [m]"
    )
    trained: Path | None = Field(
        None, description="folder with a trained run per environment, by its name (default: the one the run lies in)"
    )
    options: EnvironmentSettings = Field(
        {}, description="options of the environments: ENV.NAME=VALUE,... (docs/environments.md)"
    )
    plan: dict[str, Any] = Field({}, description="settings of `plan` in place of those of the trained runs")


class TrialParams(Params):
    """Everything one trial depends on."""

    goal: int = Field(ge=0, description="number of the goal")
    seed: int = Field(ge=0, description="number of the start")
    network: Path | None = Field(description="model artifact of the trained run; None where nothing is trained")
    plan: PlanParams = Field(description="planning settings in force, with environment, model, strokes and success")

    def files(self) -> dict[str, Path]:
        """None: the network counts by the key of its artifact, and may be missing."""
        return {}


class ExperimentTrials(Params):
    """The planning of an experiment."""

    models: TrialLabels = Field(description="models that plan, by name")
    goals: int = Field(ge=1, description="goals per environment")
    seeds: int = Field(ge=1, description="starts per goal")
    strokes: int = Field(ge=1, description="most strokes in one trial")
    thresholds: Thresholds = Field((0.02, 0.03, 0.05, 0.1), description="distances that count as success [m]")
    plan: dict[str, Any] = Field({}, description="settings of `plan` in place of the recipes'")


class ExperimentParams(Params):
    """An experiment: runs of the shipped recipes of some environments, and the table that they end in."""

    title: str = Field(description="what it shows")
    table: Literal["dynamics", "guidance", "interactions", "search"] = Field(description="the table it ends in")
    interactions: dict[EnvironmentName, Counts] = Field(description="training sequences, by environment", min_length=1)
    models: Labels = Field(description="models to compare, by name")
    variants: dict[str, dict[str, Any]] = Field({}, description="as `train.variants`")
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] = Field(
        (0, 1, 2), description="seeds of training"
    )
    training: int = Field(100, ge=1, description="simulated sequences that training ones are chosen from")
    validation: int = Field(10, ge=0, description="sequences that the best weights are chosen on")
    test: int = Field(100, ge=1, description="held-out sequences")
    strokes: int = Field(4, ge=1, description="strokes per sequence")
    horizons: Counts = Field((1, 2, 4), description="strokes predicted in a row")
    recordings: bool = Field(
        False, description="render recordings and see them through the pipeline, or true particles"
    )
    steps: float = Field(1.0, gt=0, description="share of the recipes' training steps")
    trials: ExperimentTrials | None = Field(None, description="planning with the trained models")
    paper: dict[str, dict[str, tuple[float, ...]]] = Field(
        {}, description="the paper's figures, by environment and row"
    )

    @model_validator(mode="after")
    def _check_counts(self) -> "ExperimentParams":
        most = max(n for counts in self.interactions.values() for n in counts)
        if most > self.training:
            raise ValueError(f"{most} interactions cannot be chosen of {self.training} training sequences")
        return self

    def labels(self, environment: str) -> list[str]:
        """The models to compare in an environment, each with its number of training sequences."""
        counts = self.interactions[environment]  # type: ignore[index]
        return [_on(model, count) for count in counts for model in self.models if trained_label(model)] + [
            model for model in self.models if not trained_label(model)
        ]

    def trial_labels(self, environment: str) -> list[str]:
        """The models that plan in an environment."""
        assert self.trials is not None
        counts = self.interactions[environment]  # type: ignore[index]
        return list(dict.fromkeys(_on(model, n) for n in counts for model in self.trials.models))


def _on(model: str, count: int) -> str:
    return f"{model}@{count}" if trained_label(model) else model
