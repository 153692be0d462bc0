"""Springs alone, fitted: pushes and picks are found again by the same fit, and what is told of fits that are none."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from piegraph_cli.dynamics import sms, spring_fit
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.models import Trained, make_foresee
from piegraph_cli.dynamics.params import PredictionParams, SMSParams
from piegraph_cli.dynamics.spring_fit import SMS, fitted, numbers_of, springs_of
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.params import PICK, PUSH
from piegraph_cli.stages.fitted import fit_springs
from tests.dynamics.test_ropes import NUMBERS, recorded

SPAN = 0.215
CARRIED = np.array([0.2, 4.2, 8e-5, 0.017, 0.4])
HELD = 0.045


def sheet() -> np.ndarray:
    x, y = np.meshgrid(np.arange(5) * 0.03, np.arange(4) * 0.03)
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.003)])


def carried(count: int, seed: int = 0, held: float = HELD) -> Sequences:
    """Picks of a sheet whose springs only pull, each from where it lay flat."""
    rest, rng = sheet(), np.random.default_rng(seed)
    start = rest[rng.integers(0, len(rest), count), :2]
    angle = rng.uniform(0, 2 * np.pi, count)
    end = start + 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
    before = np.repeat(rest[None], count, 0)
    graph = springs_of(rest, SPAN)
    strokes = Strokes.of(start.astype(np.float32), end.astype(np.float32), PICK)
    params = sms.push_params(graph, torch.as_tensor(CARRIED), True)
    after = sms.moved(torch.as_tensor(before, dtype=torch.float32), strokes, graph, params, hold=held).numpy()
    positions = np.stack([before, after], 1).reshape(-1, *rest.shape).astype(np.float32)
    hand = np.stack([start, end], 1).reshape(-1, 2).astype(np.float32)
    none = np.zeros((0, 2), np.int64)
    owner = np.arange(count) // 4
    rests = np.repeat(rest[None], owner[-1] + 1, 0).astype(np.float32)
    numbers = np.arange(2 * count).reshape(-1, 2)
    return Sequences(positions, hand, numbers, np.full(count, PICK, np.uint8), owner, rests, none, none[:, 0])


def left(springs: SMS, data: Sequences) -> float:
    """Mean particle error of its predictions as a share of the motion."""
    before, after = (torch.as_tensor(data.positions[k]) for k in data.strokes.T)
    found = springs.predict(data.rest[0])(before, data.whole())
    return float((found - after).norm(dim=-1).mean() / (before - after).norm(dim=-1).mean())


@pytest.mark.parametrize("picks", [False, True])
def test_one_fit_finds_the_springs_of_pushes_and_of_picks(picks):
    data, others = (carried(16, seed) if picks else recorded(NUMBERS, SPAN, 10, seed) for seed in (0, 1))
    springs = SMS(SMSParams())
    made = fit_springs(springs, data)
    assert left(springs, others) < 0.15
    assert made.warnings == []
    assert bool(springs.tension_only) == picks
    assert ("that only pull" in made.quality, "pusher" in made.quality) == (picks, not picks)
    again = SMS(SMSParams())
    again.load_state_dict({n.removeprefix("weights/"): torch.as_tensor(v) for n, v in made.arrays.items() if "/" in n})
    assert left(again, others) == left(springs, others)


def unsure(springs: SMS, data: Sequences) -> float:
    """Mean second sign of its predictions (m)."""
    trained = Trained(springs, springs.params, data.pace, (PUSH,), data.positions.shape[1])
    foresee = make_foresee("sms-o", trained, torch.as_tensor(data.rest[0]), PredictionParams())
    before = torch.as_tensor(data.positions[data.strokes[:, 0]])
    after, signs = foresee(before, data.whole())
    assert torch.equal(after, springs.predict(data.rest[0])(before, data.whole()))
    return float(signs[:, 1].mean())


def test_springs_tell_how_far_strokes_leave_them_open():
    """Few strokes leave more springs possible than many, and a model of before says nothing."""
    others = recorded(NUMBERS, SPAN, 10, 1)
    few, many = SMS(SMSParams()), SMS(SMSParams())
    few.fit(recorded(NUMBERS, SPAN, 2))
    many.fit(recorded(NUMBERS, SPAN, 16))
    assert unsure(few, others) > 2 * unsure(many, others) > 0
    of_before = SMS(SMSParams())
    of_before.load_state_dict({n: v for n, v in few.state_dict().items() if n != "others"})
    assert unsure(of_before, others) == 0
    assert left(of_before, others) == left(few, others)


def test_what_a_pick_holds_is_told_by_strokes_and_stays_as_it_is_without_picks():
    near, far = (fitted(carried(12, held=held)).numbers[5] for held in (0.02, 0.045))
    assert near < 0.03 < far < 0.06
    assert fitted(recorded(NUMBERS, SPAN, 4)).numbers[5] == sms.HOLD


def test_particles_that_were_not_seen_do_not_count():
    data = recorded(NUMBERS, SPAN, 6)
    hidden = np.zeros(data.positions.shape[:2], bool)
    hidden[:, ::2] = True
    spoilt = data.positions.copy()
    spoilt[1::2][hidden[1::2]] += [0.3, 0.3, 0]
    assert fitted(replace(data, positions=spoilt, seen=~hidden)).error < 0.003
    assert fitted(replace(data, positions=spoilt)).error > 0.02


def test_strokes_that_no_springs_explain_are_told():
    data = recorded(NUMBERS, SPAN, 6)
    made = fit_springs(SMS(SMSParams()), replace(data, hand=data.hand + np.float32([0, 0.3])))
    assert "cm that particles move: no object that was pushed or carried fits" in made.warnings[0]
    assert made.arrays["train_loss"][0] > 0.6 * made.arrays["static_loss"]


def test_only_so_many_strokes_are_fitted_to(monkeypatch):
    data = carried(32)
    monkeypatch.setattr(spring_fit, "MOST", 8)
    strokes = spring_fit._Strokes(data)
    assert strokes.owners.tolist() == [0, 7]
    assert strokes.errors(np.full((3, 7), 0.1)).shape == (3, 8)


def test_numbers_of_a_candidate():
    middle = numbers_of(np.array([[0.5, 1.0, 0, 0, 0, 0, 1.0], [0.5, 0.0, 0, 0, 0, 0, 0]]))
    np.testing.assert_allclose(middle[0], [sms.STABLE, 4.2, 2.5e-5, 0.017, 0.4, sms.HOLD * np.exp(0.5)])
    assert middle[1, 0] == pytest.approx(0.05)
    assert PUSH not in carried(4).mode
