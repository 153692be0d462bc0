"""Colours of models: one for each name, apart from each other and from both grounds, shades for variants."""

from itertools import combinations
from typing import get_args

import numpy as np
import pytest

from piegraph_cli.dynamics.params import ModelName
from piegraph_cli.evaluation.colors import MODELS, model_color, model_marker

LABELS = [*get_args(ModelName), "greedy"]
SHADES = [f"{name}{more}" for name in LABELS for more in ("", ":fine", ":coarse", "@1", "@10", "@40", ":fine@20")]
STRANGE = [
    "",
    "@",
    "my-model",
    "piegraph@",
    "piegraph@many",
    "piegraph:a:b",
    "Größe <b>",
    "x" * 1000,
    "piegraph@" + "9" * 99,
]

# what people see who lack one kind of cones. Source: Machado, Oliveira, Fernandes 2009, severity 1
SEEN = {
    "all": np.eye(3),
    "no red": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "no green": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "no blue": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}


def linear(color: str) -> np.ndarray:
    assert len(color) == 7
    assert color[0] == "#"
    coded = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    cones = np.array([[0.412, 0.536, 0.051], [0.212, 0.681, 0.107], [0.088, 0.282, 0.630]]) @ np.clip(rgb, 0, 1)
    to_lab = np.array([[0.210, 0.794, -0.004], [1.978, -2.429, 0.451], [0.026, 0.783, -0.809]])
    return 100 * to_lab @ np.cbrt(cones)


def test_every_model_has_a_colour():
    assert set(LABELS) == set(MODELS)
    assert len({(model_color(label), model_marker(label)) for label in LABELS}) == len(LABELS)
    assert len({model_marker(label) for label in LABELS}) == len(LABELS)


@pytest.mark.parametrize("sight", SEEN)
def test_models_are_told_apart(sight):
    seen = {label: lab(np.array(SEEN[sight]) @ linear(model_color(label))) for label in LABELS}
    nearest = min(np.linalg.norm(seen[a] - seen[b]) for a, b in combinations(LABELS, 2))
    assert nearest > (10 if sight == "all" else 5)


@pytest.mark.parametrize("label", SHADES + STRANGE)
def test_colours_stand_out_from_white_and_from_black(label):
    light = float(linear(model_color(label)) @ [0.2126, 0.7152, 0.0722])
    assert 1.05 / (light + 0.05) > 2.4
    assert (light + 0.05) / (0.008 + 0.05) > 2.4
    assert model_color(label) == model_color(label)


def test_variants_are_shades_of_their_model():
    for name in LABELS:
        own = lab(linear(model_color(name)))
        for more in (":fine", "@10", ":fine@10"):
            assert model_color(name + more) != model_color(name)
            shade = lab(linear(model_color(name + more)))
            assert np.linalg.norm(shade - own) < 25
        assert len({model_color(f"{name}@{n}") for n in (5, 10, 20, 40)}) == 4
