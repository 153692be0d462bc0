"""Settings of the dataset, of every model that is trained, and of predictions; and the names of models."""

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, Field, SerializeAsAny

from piegraph_cli.dynamics.dataset_params import DatasetParams as DatasetParams
from piegraph_cli.errors import UsageError
from piegraph_cli.params import Params, split_commas, validated
from piegraph_cli.physics.params import GuidanceParams

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
    "rigid",
    "rigid-gp",
    "static",
]
MODEL_HELP: dict[str, str] = {
    "piegraph": "the network's prediction, kept physical by springs it guides",
    "piegraph-ng": "the network alone, no guidance",
    "kabsch": "the network's prediction, made rigid: an oracle for rigid objects",
    "egnn-g": "the stroke as two nodes of the graph in place of canonical actions, and guidance",
    "gnn": "a graph network without equivariance",
    "gnn-aug": "the same, trained on turned examples",
    "sms-no": "springs pushed by a disc, their numbers as given",
    "sms-o": "springs pushed by a disc or carried, their reach and numbers fitted to the strokes",
    "pgnd": "Particle-Grid Neural Dynamics",
    "gbnd": "graph-based neural dynamics with a tool node",
    "rigid": "a rigid body pushed over a table: an analytic model, five numbers fitted",
    "rigid-gp": "the same, and a Gaussian process on what it leaves",
    "static": "nothing moves: the floor of every comparison",
}
"""What each model is, in a line."""
MODEL_NAMES = ", ".join(MODEL_HELP)
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


_LABEL = re.compile(r"([a-z-]+)(:[a-z0-9_-]+)?(@(?:0|[1-9][0-9]*))?")


def _check_label(label: str) -> str:
    parts = _LABEL.fullmatch(label)
    if parts is None:
        raise ValueError(f"{label!r} is no model: give NAME, NAME@SEQUENCES or NAME:VARIANT@SEQUENCES")
    if parts[1] not in get_args(ModelName):
        raise ValueError(f"no model {parts[1]}: {', '.join(get_args(ModelName))}")
    if parts[3] == "@0" and trained_label(parts[1]) != "piegraph":
        raise ValueError(f"{label}: of no sequences only piegraph learns, which can begin with a prior")
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
Labels = Annotated[tuple[Label, ...], BeforeValidator(split_commas), Field(min_length=1)]


class FittedParams(Params):
    """Settings of what any model learns from a dataset."""

    revision: ClassVar[int] = 1
    """Raised where this model alone learns something else than before of the same settings; `train`'s version is of all."""


class LearningParams(FittedParams):
    """How a model is trained by gradient."""

    learning_rate: float = Field(2e-3, gt=0, description="learning rate at the start of the cosine")
    weight_decay: float = Field(1e-4, ge=0, description="AdamW weight decay")
    clip: float = Field(1.0, gt=0, description="largest gradient norm")
    batch: int = Field(8, ge=1, description="training examples per step")
    steps: int = Field(2600, ge=1, description="training steps of the first cycle")
    cycles: int = Field(
        3, ge=1, description="most cycles, each as long as all before; the next only where validation gained 3 %"
    )


class GraphParams(LearningParams):
    """Settings of the graph networks that predict a stroke at once."""

    neighbors: int = Field(12, ge=1, description="neighbours of a particle in the graph")
    hidden: int = Field(32, ge=1, description="width of the network")
    layers: int = Field(4, ge=1, description="message-passing layers")
    pool: bool = Field(True, description="mix the mean over all particles into each layer")
    shape_weight: float = Field(0.1, ge=0, description="weight of the shape loss")
    mirror: bool = Field(False, description="mirror half of the pairs: right where the mirror image moves alike")


PRIOR = Path("prior")
"""The word for the priors that are shipped, in place of a file."""
SHIPPED_PRIORS = {family: Path(__file__).parent.parent / "priors" / f"{family}.h5" for family in ("blocks", "ropes")}
"""Those that are shipped, by family; all networks have the same size."""


class EGNNParams(GraphParams):
    """Settings of piegraph's network."""

    later: ClassVar[tuple[str, ...]] = ("prior",)

    mirror: bool = Field(True, description="equivariant to reflection: wrong where left and right differ unseen")
    action_head: bool = Field(True, description="add a displacement in the stroke's frame")
    prior: Path | None = Field(
        None,
        description="what it begins with: `prior`, that of the shipped ones that is for such an object (blocks, ropes), or a "
        "file of `piegraph pretrain`; its network's size is taken, and how long it learns is chosen",
    )

    def files(self) -> dict[str, Path]:
        """As for all settings; priors that are shipped lie in the package, and the recording tells which one it is."""
        if self.prior != PRIOR:
            return super().files()
        return {"prior": SHIPPED_PRIORS["blocks"], "prior_ropes": SHIPPED_PRIORS["ropes"]}


class ActionNodeParams(GraphParams):
    """Settings of the network that sees the stroke as two nodes."""

    mirror: bool = Field(False, description="no effect on egnn-g, whose network tells no left from right")


class SMSParams(FittedParams):
    """A spring-mass system alone has no settings: how far springs reach, and all of their numbers, are fitted."""

    revision: ClassVar[int] = 2


class StepParams(LearningParams):
    """Settings of the models that predict frame by frame."""

    step: float = Field(0.01, gt=0, description="the hand's motion from one frame to the next, at most [m]")
    rollout: int = Field(3, ge=1, description="frames predicted in a row in training")
    noise: float = Field(0.002, ge=0, description="noise on the particles in training [m]")
    turn: bool = Field(True, description="turn every training example about the vertical by a random angle")

    @property
    def frames(self) -> int:
        """The frames that the network sees, now among them."""
        raise NotImplementedError


class PGNDParams(StepParams):
    """Settings of Particle-Grid Neural Dynamics."""

    @property
    def frames(self) -> int:
        """The frames that its network sees, now among them: each place with the velocity that led there."""
        return self.history + 2

    learning_rate: float = Field(1e-3, gt=0, description="learning rate at the start of the cosine")
    weight_decay: float = Field(0.0, ge=0, description="AdamW weight decay")
    clip: float = Field(0.1, gt=0, description="largest gradient norm")
    steps: int = Field(1500, ge=1, description="training steps of the first cycle")
    rollout: int = Field(10, ge=1, description="frames predicted in a row in training")
    noise: float = Field(0.0, ge=0, description="noise on the particles in training [m]")
    history: int = Field(2, ge=0, description="past places and velocities that the network sees")
    cell: float = Field(0.02, gt=0, description="edge of a grid cell [m]")
    reach: float = Field(0.1, gt=0, description="particles within this of a node give its feature [m]")
    gripper: float = Field(0.04, gt=0, description="nodes within this of a hand that holds take its velocity [m]")
    pusher: float = Field(0.01, gt=0, description="radius of the ring of points that stands for a pusher [m]")


class GBNDParams(StepParams):
    """Settings of graph-based neural dynamics with nodes on the tool."""

    @property
    def frames(self) -> int:
        """The frames that its network sees, now among them."""
        return self.history + 1

    learning_rate: float = Field(1e-3, gt=0, description="learning rate at the start of the cosine")
    weight_decay: float = Field(0.0, ge=0, description="AdamW weight decay")
    steps: int = Field(1500, ge=1, description="training steps of the first cycle")
    history: int = Field(0, ge=0, description="past motions that the network sees")
    hidden: int = Field(150, ge=1, description="width of the network")
    neighbors: int = Field(5, ge=1, description="neighbours of a particle in the graph")
    radius: float = Field(0.075, gt=0, description="particles further apart than this are no neighbours [m]")
    edge_weight: float = Field(0.05, ge=0, description="weight of the loss on edge lengths")
    pusher: float = Field(0.01, gt=0, description="radius of the ring of points that stands for a pusher [m]")


class RigidParams(FittedParams):
    """What is thought of a rigid body before its strokes are seen."""

    revision: ClassVar[int] = 2

    refine: bool = Field(
        True,
        description="let the strokes refine the outline that the particles have; else it stays an alpha shape of them",
    )
    alpha: float = Field(
        1.8,
        ge=1,
        description="without `refine`: coarsest triangles of the outline, times those that join the particles",
    )
    friction: float = Field(0.25, gt=0, description="friction with the pusher, before strokes are seen")
    reach: float = Field(
        0.01,
        gt=0,
        description="distance of the pusher's centre from the outline that it keeps, before strokes are seen [m]",
    )
    outline: Path | None = Field(
        None,
        description="outline from above, x,y [m] in any frame: .csv, or .npz with outline (default: of the particles)",
    )
    fit: bool = Field(
        True, description="fit the five numbers to the strokes; else they stay as before strokes are seen"
    )


BUILT_IN: dict[str, dict[str, Any]] = {"piegraph:prior": {"prior": str(PRIOR)}}
"""Variants that need not be declared."""


class TrainParams(Params):
    """Settings of `train`: which models, from which seeds, and a table of settings for each."""

    models: Annotated[tuple[Annotated[str, AfterValidator(_check_trainable)], ...], BeforeValidator(split_commas)] = (
        Field(
            ("piegraph",),
            min_length=1,
            description="models to train, by name; pgnd@20: on 20 of the training sequences",
        )
    )
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], BeforeValidator(split_commas)] = Field(
        (0,), min_length=1, description="seeds of weights, batches and choice of sequences; each trains every model"
    )
    model_seeds: dict[str, Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)]] = Field(
        {}, description="seeds of single models in place of `seeds`, by name"
    )
    checkpoint_every: int = Field(500, ge=1, description="steps between checkpoints")
    tensorboard: bool = Field(False, description="write TensorBoard events to RUN/tensorboard")
    piegraph: EGNNParams = Field(EGNNParams(), description="its settings")
    egnn_g: ActionNodeParams = Field(ActionNodeParams(), alias="egnn-g", description="its settings")
    gnn: GraphParams = Field(GraphParams(), description="its settings")
    gnn_aug: GraphParams = Field(GraphParams(), alias="gnn-aug", description="its settings")
    sms_o: SMSParams = Field(SMSParams(), alias="sms-o", description="its settings")
    pgnd: PGNDParams = Field(PGNDParams(), description="its settings")
    gbnd: GBNDParams = Field(GBNDParams(), description="its settings")
    rigid: RigidParams = Field(RigidParams(), description="its settings")
    rigid_gp: RigidParams = Field(RigidParams(), alias="rigid-gp", description="its settings")
    variants: dict[str, dict[str, Any]] = Field({}, description="other settings of a model, by MODEL:VARIANT")

    def files(self) -> dict[str, Path]:
        """As for all settings, and those of variants."""
        known = {key for key in self.variants if split_label(key)[0] in LEARNED}
        return super().files() | {
            f"variants.{key}.{name}": file for key in sorted(known) for name, file in self.of(key).files().items()
        }

    def placed(self, base: Path) -> dict[str, str]:
        """As for all settings; the priors that are shipped stay a word, which holds wherever piegraph is."""
        shipped = {name for name, file in self.files().items() if file in SHIPPED_PRIORS.values()}
        return {name: place for name, place in super().placed(base).items() if name not in shipped}

    def seeds_of(self, label: str) -> tuple[int, ...]:
        """The seeds that a model is trained from."""
        return self.model_seeds.get(trained_label(label) or label, self.seeds)

    def of(self, label: str) -> FittedParams:
        """The settings of one model. Raises `UsageError` for a variant that is not declared or does not fit the model."""
        name, variant, _ = split_label(label)
        settings: FittedParams = getattr(self, name.replace("-", "_"))
        if not variant:
            return settings
        key, variants = f"{name}:{variant}", BUILT_IN | self.variants
        if key not in variants:
            raise UsageError(f"no variant {key}", "train.variants", f'a section [train.variants."{key}"] in the recipe')
        return validated(type(settings), settings.model_dump() | variants[key], f"train.variants.{key}", "recipe", "")


LEARNED: dict[str, type[FittedParams]] = {
    name.replace("_", "-"): type(field.default)
    for name, field in TrainParams.model_fields.items()
    if isinstance(field.default, FittedParams)
}
"""What can be trained, by name, with its settings."""

BY_GRADIENT: dict[str, type[LearningParams]] = {n: of for n, of in LEARNED.items() if issubclass(of, LearningParams)}
"""Those of them that learn step by step."""


class ModelParams(Params):
    """Everything that one trained model depends on."""

    label: str = Field(description="model; after : a variant, after @ the number of training sequences")
    seed: int = Field(ge=0, description="seed of weights, batches and choice of sequences")
    settings: SerializeAsAny[FittedParams] = Field(description="settings of the model")
    checkpoint_every: int = Field(500, ge=1, description="steps between checkpoints")
    tensorboard: bool = Field(False, description="write TensorBoard events to RUN/tensorboard")

    def content(self) -> dict[str, Any]:
        """As for all settings, with the model's revision, from the second on.

        How often the state is kept and whether events are written are left at their defaults.
        """
        unused = {n: type(self).model_fields[n].default for n in ("checkpoint_every", "tensorboard")}
        revised = {"revision": self.settings.revision} if self.settings.revision > 1 else {}
        return super().content() | unused | {"settings": self.settings.content()} | revised


class PredictionParams(GuidanceParams):
    """What a prediction by name needs: the springs' reach beside the guidance."""

    spring_radius: float = Field(0.05, gt=0, description="particles closer than this are joined by a spring [m]")
