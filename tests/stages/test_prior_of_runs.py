"""`piegraph pretrain` and `train --from`: what a prior's file says, files that are refused, keys, no test in its simulator."""

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from piegraph_cli.commands.program import app
from piegraph_cli.dynamics.family.params import PretrainParams
from piegraph_cli.dynamics.params import PRIOR, SHIPPED_PRIORS, EGNNParams
from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.stages import STAGES, evaluate
from piegraph_cli.stages.prior import PRETRAIN, adopted, pretrain, read_prior
from piegraph_cli.workspace.artifact import read_artifact, write_artifact
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run
from tests.stages.chain import artifact

SMALL = PretrainParams(hidden=8, layers=1, steps=2)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    out = tmp_path_factory.mktemp("prior") / "small.h5"
    assert pretrain(SMALL, out, None, lambda items: items) is not None
    return out


def rewritten(small, out, version=PRETRAIN.version, features=None):
    made = read_artifact(small, "prior")
    arrays = dict(made.arrays)
    if features:
        arrays["weights/network.embed.weight"] = np.zeros((8, features), np.float32)
    rest = {"key": made.key, "params": made.params, "inputs": {}, "stage": "pretrain", "stage_version": version}
    write_artifact(out, "prior", arrays, **rest)
    return out


@pytest.mark.parametrize(
    ("family", "simulator", "what"),
    [("blocks", "analytic quasi-static pushing", "outlines"), ("ropes", "springs of this project", "length [m]")],
)
def test_a_prior_says_what_it_has_seen(family, simulator, what):
    about = read_artifact(SHIPPED_PRIORS[family], "prior").params
    assert about["simulators"] == [simulator]
    assert {"seed", "family", "steps"} <= about["settings"].keys()
    assert about["settings"]["family"] == family == read_prior(SHIPPED_PRIORS[family])[0].family
    assert about["strokes"] > 100_000
    assert about["cpu_minutes"] > 0
    assert what in about["seen"]
    assert SHIPPED_PRIORS[family].stat().st_size < 2_000_000


def test_priors_that_are_shipped_have_networks_of_one_size():
    sizes = {tuple(v.shape for v in read_prior(file)[0].state_dict().values()) for file in SHIPPED_PRIORS.values()}
    assert len(sizes) == 1
    assert adopted(EGNNParams(prior=PRIOR)).neighbors == read_prior(SHIPPED_PRIORS["ropes"])[0].network.neighbors


def test_what_is_no_prior_is_refused(small, tmp_path):
    read_prior(small)
    with pytest.raises(DataError, match="a prior of version 99, this is version"):
        read_prior(rewritten(small, tmp_path / "old.h5", version=99))
    with pytest.raises(DataError, match="takes 9 features of a particle, there are 10"):
        read_prior(rewritten(small, tmp_path / "features.h5", features=9))
    text = tmp_path / "text.h5"
    text.write_text("no HDF5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file.attrs["artifact"] = "checkpoint"
    for wrong in (text, tmp_path / "other.h5", tmp_path / "gone.h5"):
        with pytest.raises(DataError, match="no prior that can be used"):
            read_prior(wrong)


def test_the_networks_size_is_the_priors_whatever_else_is_set(small):
    first, second = (adopted(EGNNParams(prior=small, hidden=h, steps=9, action_head=False)) for h in (16, 32))
    assert first == second
    assert (first.hidden, first.layers, first.neighbors, first.action_head) == (8, 1, 6, True)
    assert adopted(EGNNParams(hidden=5)) == EGNNParams(hidden=5)


def test_the_key_has_the_priors_content_and_not_its_place(small, tmp_path):
    def key(prior) -> str:
        recipe = Recipe(STAGES, {"simulate": {}, "train": {"piegraph": {"prior": str(prior)}}})
        return Run(tmp_path / "run", recipe).key(STAGES["train"], "piegraph.seed0")

    copy = tmp_path / "elsewhere" / small.name
    copy.parent.mkdir()
    copy.write_bytes(small.read_bytes())
    assert key(copy) == key(small)
    other = tmp_path / "other.h5"
    pretrain(SMALL.model_copy(update={"seed": 1}), other, None, lambda items: items)
    assert key(other) != key(small)
    assert key("prior") not in (key(small), key(other))


def test_no_model_is_tested_in_the_simulator_of_its_prior(tmp_path):
    run = Run(tmp_path, Recipe(STAGES, {"simulate": {"environment": "tblock"}}))
    for simulator, refused in (("Pymunk", True), ("MuJoCo", False), ("analytic quasi-static pushing", False)):
        model = artifact({"prior_simulator": np.array([simulator.encode()])})
        if refused:
            with pytest.raises(DataError, match="learned from Pymunk, which it is tested on"):
                evaluate._check_apart({"model": model}, run)
        else:
            evaluate._check_apart({"model": model}, run)


def test_no_trial_is_played_in_the_simulator_of_a_prior(tmp_path, monkeypatch):
    from piegraph_cli.planning.params import PlanParams, TrialParams
    from piegraph_cli.stages import trials

    (tmp_path / "model.h5").write_bytes(b"")
    monkeypatch.setattr(trials, "_read_once", lambda *_: artifact({"prior_simulator": np.array([b"MuJoCo"])}))
    settings = {"goal": 0, "seed": 0, "network": tmp_path / "model.h5"}
    with pytest.raises(DataError, match="learned from MuJoCo, which it is tested on"):
        trials._read_model(TrialParams(plan=PlanParams(env="toy"), **settings))
    assert trials._read_model(TrialParams(plan=PlanParams(env="tblock"), **settings))


def test_of_no_strokes_only_what_begins_with_a_prior_learns(tmp_path):
    from piegraph_cli.dynamics.params import ModelParams
    from piegraph_cli.stages.train import run

    with pytest.raises(UsageError, match="no strokes to learn from"):
        run({"dataset": None}, ModelParams(label="piegraph@0", seed=0, settings=EGNNParams()), None)


def test_the_command_leaves_other_files_alone(tmp_path):
    out = tmp_path / "notes.txt"
    out.write_text("mine")
    with pytest.raises(UsageError, match="no prior"):
        CliRunner().invoke(app, ["pretrain", "--out", str(out)], catch_exceptions=False)
    assert out.read_text() == "mine"
