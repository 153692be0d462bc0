"""Sequences of two objects, in two units or there twice are said; those of one object that moves and bends are not."""

import numpy as np

from piegraph_cli.dynamics.alike import find_unlike

RNG = np.random.default_rng(0)


def block(size=1.0, sequences=3, seed=0):
    """Tracks of a block of 8 x 5 particles that is moved and turned."""
    x, y = np.meshgrid(np.arange(8) * 0.02, np.arange(5) * 0.02)
    rest = np.stack([x.ravel(), y.ravel(), np.full(40, 0.01)], 1) * size
    rng, made = np.random.default_rng(seed), {}
    for k in range(sequences):
        frames = []
        for angle in np.linspace(0, rng.uniform(0.2, 1), 6):
            turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
            frames.append(rest @ turn.T + [*rng.uniform(-0.1, 0.1, 2), 0] + rng.normal(0, 0.001, rest.shape))
        made[f"{size:g} {k}"] = {"positions": np.array(frames)}
    return made


def rope(bend):
    """Tracks of a rope that is bent more and more."""
    along, frames = np.linspace(0, 0.4, 40), []
    for curve in np.linspace(0.01, bend, 6):
        angle = along * curve / 0.4
        frames.append(np.stack([np.cumsum(np.cos(angle)), np.cumsum(np.sin(angle)), np.ones(40)], 1) * 0.4 / 39)
    return {"positions": np.array(frames)}


def test_one_object_is_silent():
    assert find_unlike(block()) == []
    assert find_unlike({"a": rope(3.0), "b": {"positions": rope(3.0)["positions"][::-1]}}) == []
    assert find_unlike({"a": {"positions": block()["1 0"]["positions"]}}) == []


def test_two_objects_or_units_are_said_with_their_sequences():
    (said,) = find_unlike(block() | block(1.5))
    assert "particles lie" in said
    assert "in 1.5" in said
    (said,) = find_unlike(block() | block(2.54, 1))
    assert "sequences show objects of other sizes" in said
    longer = {name: {"positions": one["positions"] * [1.3, 1.0, 1.0]} for name, one in block(seed=1).items()}
    longer = {f"longer {name}": {"positions": one["positions"][:1]} for name, one in longer.items()}
    (said,) = find_unlike(block() | longer)
    assert "the object is" in said


def test_a_sequence_that_is_there_twice_is_said():
    tracks = block()
    tracks["copy"] = {"positions": tracks["1 1"]["positions"].copy()}
    (said,) = find_unlike(tracks)
    assert "copy is 1 1" in said
