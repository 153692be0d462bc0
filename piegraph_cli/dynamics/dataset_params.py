"""Settings of `dataset`; `params` has them beside all others."""

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from piegraph_cli.params import Params, split_commas

Names = Annotated[tuple[str, ...], BeforeValidator(split_commas)]
"""Sequences by name."""


class DatasetParams(Params):
    """Settings of `dataset`."""

    train: int = Field(10, ge=1, description="sequences to train on")
    validation: int = Field(0, ge=0, description="sequences to choose the checkpoint on (0: the last one is kept)")
    min_gap: int = Field(2, ge=1, description="fewest frames between the two frames of a training pair")
    min_stroke: float = Field(0.01, ge=0.001, description="shortest stroke that is kept [m]")
    max_bend: float = Field(0.025, gt=0, description="a push that strays further from a straight line is cut there [m]")
    min_seen: float = Field(0.5, ge=0, le=1, description="frames in which less of the object is seen are no examples")
    max_doubt: float = Field(
        0.03, gt=0, description="frames whose tracks are expected to be further off are no examples [m]"
    )
    seed: int = Field(0, ge=0, description="seed of the split")
    train_names: Names = Field((), description="sequences to train on, by name, in place of numbers")
    validation_names: Names = Field((), description="sequences to choose the checkpoint on, by name")
    test_names: Names = Field((), description="sequences to test on, by name (default: all that are in no other part)")
    split: Path | None = Field(None, description="file of the split: a line NAME,train|validation|test per sequence")

    @model_validator(mode="after")
    def _check_names(self) -> "DatasetParams":
        named = [*self.train_names, *self.validation_names, *self.test_names]
        if self.split is not None and named:
            raise ValueError("the split is given by a file and by names: give one of them")
        twice = sorted({name for name in named if named.count(name) > 1})
        if twice:
            raise ValueError(f"sequence {twice[0]} is in more than one part of the split")
        return self
