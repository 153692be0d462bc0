"""How a prior is trained."""

from typing import Literal

from pydantic import Field

from piegraph_cli.params import Params

Family = Literal["blocks", "ropes"]
"""Kinds of object that a prior is for."""


class PretrainParams(Params):
    """How a prior is trained."""

    family: Family = Field("blocks", description="kind of object that it is for")
    seed: int = Field(0, ge=0, description="seed of weights, objects and strokes")
    steps: int = Field(16_000, ge=1, description="training steps")
    batch: int = Field(16, ge=1, le=1024, description="strokes per step")
    learning_rate: float = Field(3e-3, gt=0, description="learning rate at the start of the cosine")
    clip: float = Field(1.0, gt=0, description="largest gradient norm")
    neighbors: int = Field(6, ge=1, description="neighbours of a particle in the graph")
    hidden: int = Field(64, ge=1, description="width of the network")
    layers: int = Field(4, ge=1, description="message-passing layers")
