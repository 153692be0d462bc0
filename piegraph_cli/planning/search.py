"""Searching the best strokes among proposals: the cross-entropy method and MPPI."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from piegraph_cli.dynamics.reliability import Calibration
from piegraph_cli.dynamics.stroke import Foresee, Strokes
from piegraph_cli.kernels.recorded import Recorded
from piegraph_cli.planning.costs import Cost
from piegraph_cli.planning.experience import Tried, shown
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.proposals import NUMBERS, StrokeSpace

INFEASIBLE = 10.0
"""Metres added to the cost of a stroke that misses or leaves the workspace: more than any real distance."""


@dataclass(frozen=True)
class Candidates:
    """What a search looked at, in I iterations of B candidates; NaN and weight 0 in those that convergence spared."""

    strokes: Strokes
    """[I, B, H]."""
    costs: torch.Tensor
    """[I, B] metres, as they were ranked: errors that are expected or were shown count; `INFEASIBLE` added per stroke that
    cannot be carried out."""
    weights: torch.Tensor
    """[I, B] with which each shaped the next iteration: equal for the elites of CEM, 0 for all others."""


@dataclass(frozen=True)
class Plan:
    """The best candidate: strokes [H], predicted states [H, N, 3] (m), their mean cost (m); and all that were looked at."""

    strokes: Strokes
    predicted: torch.Tensor
    cost: float
    candidates: Candidates
    errors: torch.Tensor
    """[H] metres to expect between each predicted state and the real one; NaN where nothing is known of them."""

    def later(self, k: int, cost: Cost) -> "Plan":
        """What is left of it after `k` strokes, with the cost of the state that the next one leads to."""
        left = float(cost(self.predicted[k][None])[0])
        return replace(self, strokes=self.strokes[k:], predicted=self.predicted[k:], cost=left, errors=self.errors[k:])


class Search:
    """Finds the best of `samples` x `cem_iterations` candidate stroke sequences for one object and goal.

    The first iteration is uniform. Each later one is drawn around the weighted candidates of the one before, and keeps the
    best so far: CEM weighs the elites equally and fits the deviation, MPPI weighs all by exp(-cost / temperature) and
    keeps the deviation. CEM ends early when its elites are as good as the best within `converged` (m). Sequences that begin
    with a push and with a pick are weighed each among themselves, and half of the next ones are of each: most picks at
    random harm where a push changes nothing, and all would be pushes before picks are any good.
    It works where `generator` is, as `foresee`, `cost` and `space` must. `record` has a GPU replay the iterations, see
    `kernels.recorded`; that needs one mode, and a `foresee` and `cost` that never wait for their results.
    Source: paper, III-E (CEM); MPPI as in the paper's baseline PGND.
    """

    def __init__(
        self,
        foresee: Foresee,
        cost: Cost,
        space: StrokeSpace,
        params: PlanParams,
        generator: torch.Generator,
        record: bool = False,
        calibration: Calibration | None = None,
    ):
        self.foresee, self.cost, self.space, self.params, self.generator = foresee, cost, space, params, generator
        self.calibration = calibration
        self.look = Recorded(self._look, generator, record)
        self.draw = Recorded(self._draw, generator, record)
        self.state = torch.empty(0, 3)
        self.tried: Sequence[Tried] = ()

    def __call__(self, state: torch.Tensor, tried: Sequence[Tried] = ()) -> Plan | None:
        """A plan from state [N, 3] (m), on the CPU; None if no candidate is feasible. `tried`: strokes of the same episode."""
        self._begin(state)
        self.tried = tried if self.params.remember else ()
        look = self._look if self.tried else self.look  # what was tried is in no recording
        seen = []
        for _ in range(self.params.cem_iterations):
            look()
            strokes, costs, weights = self.seen
            seen.append((strokes.clone(), costs.clone(), weights.clone()))
            if self._agreed():
                break
            self.draw()
        # copies: the next plan writes over what is kept here
        ranked, predicted, _, cost, errors = (value[0].clone().cpu() for value in self.best)
        if float(ranked) >= INFEASIBLE:
            return None
        candidates = _candidates(seen, self.params.cem_iterations)
        leader = int(candidates.costs.nan_to_num(nan=torch.inf).argmin())
        strokes = candidates.strokes[leader // self.params.samples, leader % self.params.samples]
        errors = torch.fmax(errors, shown(state, strokes.ends[:1], tried))
        return Plan(strokes, predicted, float(cost), candidates, errors)

    def _begin(self, state: torch.Tensor) -> None:
        """The first proposals. What is recorded goes on with the same tensors."""
        samples, horizon, device = self.params.samples, self.params.horizon, self.generator.device
        proposals = self.space.sample((samples, horizon), self.generator)
        if self.state.shape != state.shape:
            self.state, self.proposals = state.to(device, copy=True), proposals
            shapes = ((), (horizon, *state.shape), (horizon, NUMBERS), (), (horizon,))
            self.best = [torch.empty(1, *shape, device=device) for shape in shapes]
        self.state.copy_(state)
        self.proposals.copy_(proposals)
        self.best[0].fill_(torch.inf)

    def _look(self) -> None:
        """Predict the proposals, weigh them, and keep what is known of the best so far."""
        strokes, predicted, costs, signs = rollout(self.state, self.proposals, self.foresee, self.cost, self.space)
        errors, ranked = self._errors(signs), costs
        if self.params.caution:
            ranked = ranked + self.params.caution * errors.mean(1).nan_to_num()
        if self.tried:
            ranked = ranked + shown(self.state, strokes.ends[:, 0], self.tried)
        leader = ranked.argmin()[None]
        better = ranked[leader] < self.best[0]
        for kept, found in zip(self.best, (ranked, predicted, self.proposals, costs, errors), strict=True):
            torch.where(better.view(-1, *[1] * (found.dim() - 1)), found[leader], kept, out=kept)
        self.seen = strokes, ranked, self._weights(ranked)

    def _errors(self, signs: torch.Tensor) -> torch.Tensor:
        """The errors [B, H] (m) to expect of candidates with signs [B, H, 2] (m); NaN without a calibration."""
        if self.calibration is None:
            return torch.full_like(signs[..., 0], torch.nan)
        return self.calibration.expected(signs, torch.arange(1, signs.shape[1] + 1, device=signs.device))

    def _agreed(self) -> bool:
        """Whether the elites are as good as the best."""
        if self.params.planner != "cem" or self.params.converged == 0:
            return False
        _, costs, weights = self.seen
        if len(self.space.modes) == 1:
            spread = torch.where(weights > 0, costs, -torch.inf).amax().double() - self.best[0][0].double()
        else:
            spread = torch.stack([_spread(costs, weights, kind) for kind in self._kinds()]).amax().double()
        lowest, apart = torch.stack([self.best[0][0].double(), spread]).tolist()
        return lowest < INFEASIBLE and apart < self.params.converged

    def _kinds(self) -> list[torch.Tensor]:
        """Which candidates [B] begin with a stroke of each mode."""
        return [self.proposals[:, 0, 0] == mode for mode in self.space.modes]

    def _weights(self, costs: torch.Tensor) -> torch.Tensor:
        """Weights [B] of the candidates, summing to 1: those of each mode to one half, if any of it can be carried out."""
        if len(self.space.modes) == 1:
            return _weights(costs, self.params)
        weights = torch.zeros_like(costs)
        for kind in self._kinds():
            if (costs[kind] < INFEASIBLE).any():
                weights[kind] = _weights(costs[kind], self.params)
        return weights / weights.sum() if weights.any() else _weights(costs, self.params)

    def _draw(self) -> None:
        """The next proposals."""
        params = self.params
        noise = params.noise if params.planner == "mppi" else None
        fresh = self.space.refit(self.proposals, self.seen[2], noise, params.samples - 1, self.generator)
        self.proposals.copy_(torch.cat([self.best[2], fresh]))


def _candidates(seen: list[tuple[Strokes, torch.Tensor, torch.Tensor]], iterations: int) -> Candidates:
    """Of strokes [B, H], costs and weights [B] of each iteration that there was, on the CPU."""
    strokes, costs, _ = seen[0]
    nowhere = torch.full_like(strokes.start, torch.nan)
    spared = Strokes(nowhere, nowhere, torch.zeros_like(strokes.mode), torch.zeros_like(strokes.held))
    never = iterations - len(seen)
    seen = seen + [(spared, torch.full_like(costs, torch.nan), torch.zeros_like(costs))] * never
    looked, found, weights = zip(*seen, strict=True)
    return Candidates(Strokes.stack(looked).to("cpu"), torch.stack(found).cpu(), torch.stack(weights).cpu())


def _spread(costs: torch.Tensor, weights: torch.Tensor, kind: torch.Tensor) -> torch.Tensor:
    """How far the worst elite of a kind [B] is behind the best (m)."""
    elites = costs[kind & (weights > 0)]
    return elites.amax() - elites.amin() if len(elites) else costs.new_zeros(())


def _weights(costs: torch.Tensor, params: PlanParams) -> torch.Tensor:
    """Weights [B] of candidates with costs [B], summing to 1."""
    if params.planner == "mppi":
        return torch.softmax(-costs / params.temperature, 0)
    weights = torch.zeros_like(costs)
    elites = costs.argsort()[: max(2, round(params.elites * len(costs)))]
    return weights.index_fill_(0, elites, 1 / len(elites))


def rollout(
    state: torch.Tensor, proposals: torch.Tensor, foresee: Foresee, cost: Cost, space: StrokeSpace
) -> tuple[Strokes, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Strokes [B, H], predicted states [B, H, N, 3], costs [B], signs [B, H, 2] of proposals [B, H, 5] from state [N, 3].

    The cost is the mean over the states, not that of the last alone: a first stroke that wanders would cost nothing. Signs
    of errors (see `dynamics.reliability`) are summed from stroke to stroke.
    """
    positions = state.expand(len(proposals), -1, -1)
    total = torch.zeros(len(proposals), device=proposals.device)
    strokes, predicted, signs = [], [], []
    for step in proposals.unbind(1):
        stroke, feasible = space.strokes(positions, step)
        positions, sign = foresee(positions, stroke)
        total = total + cost(positions) / proposals.shape[1] + INFEASIBLE * (~feasible)
        strokes.append(stroke)
        predicted.append(positions)
        signs.append(sign)
    return Strokes.stack(strokes, 1), torch.stack(predicted, 1), total, torch.stack(signs, 1).cumsum(1)
