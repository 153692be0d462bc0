"""What a call of `train` means: settings of one model, its seeds beside those it has, and the run's other models left alone."""

from pathlib import Path

import pytest

from piegraph_cli.errors import UsageError
from piegraph_cli.stages import STAGES, open_run, train
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run

STAGE = STAGES["train"]


def called(folder: Path, section: dict | None = None, **given):
    """The settings that change, and the units that are worked on."""
    recipe = Recipe(STAGES, {"simulate": {}} | ({} if section is None else {"train": section}))
    values, units = train._apply(Run(folder, recipe), given)
    recipe.with_values(STAGE, values, "test", folder)
    return values, units


def test_without_a_model_settings_and_seeds_are_those_of_all(tmp_path):
    assert called(tmp_path) == ({}, ())
    assert called(tmp_path, seed="3,4") == ({"seeds": (3, 4)}, ())
    assert called(tmp_path, checkpoint_every=7, tensorboard=True) == ({"checkpoint_every": 7, "tensorboard": True}, ())
    assert called(tmp_path, steps=9) == ({"piegraph": {"steps": 9}}, ())
    assert called(tmp_path, {"piegraph": {"hidden": 5, "steps": 1}}, steps=9)[0] == {
        "piegraph": {"hidden": 5, "steps": 9}
    }


@pytest.mark.parametrize(
    ("model", "label", "table"),
    [
        ("gnn", "gnn", "gnn"),
        ("gnn@20", "gnn@20", "gnn"),
        ("gnn:wide@20", "gnn:wide@20", "gnn"),
        ("egnn-g", "egnn-g", "egnn-g"),
        ("piegraph-ng@3", "piegraph@3", "piegraph"),
    ],
)
def test_a_model_is_what_is_trained_for_it_and_its_settings_have_its_name(tmp_path, model, label, table):
    section = {"models": ["piegraph"], "variants": {"gnn:wide": {"hidden": 64}}}
    values, units = called(tmp_path, section, model=model, steps=4)
    assert values[table] == {"steps": 4}
    assert values["models"] == list(dict.fromkeys(["piegraph", label]))
    assert units == (f"{label}.seed0",)


def test_a_models_seeds_come_beside_those_it_has(tmp_path):
    section = {"models": ["piegraph", "gnn"], "seeds": [1, 2], "model_seeds": {"gnn": [5]}}
    values, units = called(tmp_path, section, model="gnn", seed="7,5")
    assert (values["model_seeds"], units) == ({"gnn": (5, 7)}, ("gnn.seed7", "gnn.seed5"))
    values, units = called(tmp_path, section, model="piegraph", seed="3")
    assert values["model_seeds"] == {"gnn": (5,), "piegraph": (1, 2, 3)}
    assert (values["models"], units) == (["piegraph", "gnn"], ("piegraph.seed3",))
    values, units = called(tmp_path, section, model="pgnd", seed="3")
    assert values["model_seeds"]["pgnd"] == (3,), "a model that is new has those of the call alone"
    assert values["models"] == ["piegraph", "gnn", "pgnd"]
    values, units = called(tmp_path, section, model="gnn")
    assert ("model_seeds" not in values, units) == (True, ("gnn.seed5",))
    assert called(tmp_path, section, model="pgnd")[1] == ("pgnd.seed1", "pgnd.seed2")


def test_the_default_model_counts_where_the_recipe_names_it_or_it_was_trained(tmp_path):
    assert called(tmp_path, model="gnn")[0]["models"] == ["gnn"]
    assert called(tmp_path, {}, model="gnn")[0]["models"] == ["gnn"]
    assert called(tmp_path, {"models": ["piegraph"]}, model="gnn")[0]["models"] == ["piegraph", "gnn"]
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "piegraph.seed4.h5").write_bytes(b"")
    values, _ = called(tmp_path, model="gnn", seed="0")
    assert (values["models"], values["model_seeds"]) == (["piegraph", "gnn"], {"gnn": (0,)})


def test_seeds_that_are_none_are_refused(tmp_path):
    for wrong in ("a", "-1", "1.5"):
        with pytest.raises(UsageError, match="seeds"):
            called(tmp_path, seed=wrong)


def test_a_model_that_is_not_of_the_run_is_made_by_a_call_of_its_own(tmp_path):
    run = open_run(tmp_path, Recipe(STAGES, {"simulate": {}, "train": {"models": ["gnn"]}}))
    assert train._command(run, "gnn.seed0") == f"piegraph run --run {tmp_path} --until train"
    assert train._command(run, "pgnd@20.seed3") == f"piegraph train --run {tmp_path} --model pgnd@20 --seed 3"


def test_options_say_whose_they_are_with_which_default():
    options = train._options()
    assert list(options)[:2] == ["model", "seed"]
    assert {"checkpoint_every", "tensorboard"} <= set(options)
    assert not {"models", "seeds", "model_seeds", "variants", "piegraph"} & set(options)
    steps = options["steps"]
    assert (steps.kind, steps.default) == (int, "")
    assert steps.meaning == (
        "training steps of the first cycle (piegraph, egnn-g, gnn, gnn-aug [default: 2600]; pgnd, gbnd [default: 1500])"
    )
    assert options["gripper"].meaning.endswith("(pgnd [default: 0.04])")
    assert "no effect on egnn-g" in options["mirror"].meaning
