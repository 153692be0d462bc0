"""Settings as options of a command: which can be given in one word, as what, and with which default."""

from pathlib import Path
from typing import Literal, get_args, get_origin

import pytest
from pydantic import Field

from piegraph_cli.dynamics.params import TrainParams
from piegraph_cli.environments.params import SimulateParams
from piegraph_cli.params import Params
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.planning.params import PlanParams, TrialsParams
from piegraph_cli.stages import STAGES
from piegraph_cli.workspace.call import Option, options_of


@pytest.mark.parametrize(
    ("params", "name", "kind", "default"),
    [
        (PlanParams, "samples", int, "100"),
        (PlanParams, "converged", float, "0.0002"),
        (PlanParams, "state", Path, ""),
        (PlanParams, "goal", str, ""),
        (PlanParams, "goal_pose", str, ""),
        (PlanParams, "model", str, "piegraph"),
        (PlanParams, "modes", str, ""),
        (PlanParams, "workspace", str, "-0.45,0.45,-0.45,0.45,-0.02,0.35"),
        (PlanParams, "options", str, ""),
        (PlanParams, "tension_only", bool, "False"),
        (PlanParams, "seed", int, "0"),
        (TrialsParams, "thresholds", str, "0.02,0.03,0.05,0.1"),
        (TrialsParams, "trained", Path, ""),
        (TrainParams, "models", str, "piegraph"),
    ],
)
def test_kinds_and_defaults_of_options(params, name, kind, default):
    option = options_of(params)[name]
    assert (option.kind, option.default) == (kind, default)
    assert option.meaning == params.model_fields[name].description


def test_choices_stay_choices():
    planner, env = (options_of(PlanParams)[name] for name in ("planner", "env"))
    assert (get_origin(planner.kind), get_args(planner.kind)) == (Literal, ("cem", "mppi", "greedy"))
    assert (get_origin(env.kind), env.default) == (Literal, "")
    assert planner.default == "cem"


def test_none_may_come_first():
    class Odd(Params):
        count: None | int = Field(None, description="how many")  # noqa: RUF036

    assert options_of(Odd) == {"count": Option(int, "how many")}


def test_tables_are_no_options():
    assert "plan" not in options_of(TrialsParams)
    assert "prompts" not in options_of(SegmentParams)
    assert set(options_of(TrainParams)) == {"models", "seeds", "checkpoint_every", "tensorboard"}
    assert set(options_of(SimulateParams)) == set(SimulateParams.model_fields)


def test_what_people_set_first_are_options_of_the_stage():
    for stage in STAGES.values():
        options = stage.call.options() if stage.call.options else options_of(stage.params)
        assert set(stage.call.first) <= set(options), stage.name
        assert not stage.call.argument or stage.call.argument in options
        assert not stage.call.counts or stage.call.counts in options
