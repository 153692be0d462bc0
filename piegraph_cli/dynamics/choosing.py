"""Which model a recording of few strokes speaks for: each learns from some of its sequences, and the others tell how well."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from piegraph_cli.dynamics.egnn import EGNN, Rest
from piegraph_cli.dynamics.examples import Pairs, Sequences
from piegraph_cli.dynamics.losses import mean_seen
from piegraph_cli.dynamics.models import make_network
from piegraph_cli.dynamics.params import EGNNParams, RigidParams
from piegraph_cli.dynamics.prior import Prior
from piegraph_cli.dynamics.rigid_body import carry
from piegraph_cli.dynamics.rigid_residual import RigidResidual
from piegraph_cli.dynamics.training import Trainer
from piegraph_cli.dynamics.tuning import KINDS, family_of, some, start_tuning
from piegraph_cli.errors import DataError

PARTS = 3
"""Parts of the sequences that are left out in turn."""
FEWEST, MOST = 10, 60
"""Strokes between which models are compared: fewer tell nothing, and of more the network learns without a prior."""
STEPS = 800
"""Of a network that begins with nothing, at most; a prior says its own."""
SURE = 1.96
"""Standard errors of a mean difference that make it sure."""
WITH, WITHOUT, BODY, STATIC = "piegraph:prior", "piegraph", "rigid-gp", "static"
"""Models that are compared, of rigid bodies the one that learns beyond the law only where that helps."""

Ends = Callable[[Sequences], Tensor]
"""Particles [S, N, 3] (m) after the strokes of sequences, as a model predicts them."""


@dataclass(frozen=True)
class Compared:
    """How far off models are on strokes that were left out."""

    errors: dict[str, np.ndarray]
    """[S] metres, by model; `static` is nothing moving."""
    owner: np.ndarray
    """[S] the sequence of each stroke."""

    @property
    def best(self) -> str:
        """The model with the least mean error."""
        return min(self.errors, key=lambda label: float(self.errors[label].mean()))

    def surely(self, label: str, other: str) -> bool:
        """Whether a model is better than another by more than chance, by sequences."""
        gain = self.errors[other] - self.errors[label]
        means = np.array([gain[self.owner == q].mean() for q in np.unique(self.owner)])
        return bool(means.mean() > SURE * means.std(ddof=1) / np.sqrt(len(means)))


def comparable(data: Sequences) -> str | None:
    """The family of priors that a recording's models are compared within; None where there is nothing to compare."""
    if not FEWEST <= len(data.strokes) <= MOST or len(np.unique(data.owner)) < PARTS:
        return None
    try:
        return family_of(data)
    except DataError:
        return None


def compared(
    data: Sequences,
    prior: Prior,
    tuned: EGNNParams,
    plain: EGNNParams,
    seed: int,
    counted: Callable[[list[tuple[int, str]]], Iterable[tuple[int, str]]],
) -> Compared | None:
    """Models on the strokes of sequences that they have not learned from; None where one of the fits is none.

    `prior` and how it learns, `tuned`; `plain`: how the network learns that begins with nothing; `counted` shows how far
    it is.
    """
    names = np.unique(data.owner)
    part = np.random.default_rng(seed).permutation(len(names)) % PARTS
    of = part[np.searchsorted(names, data.owner)]
    learners = _learners(prior, tuned, plain, seed)
    errors = {label: np.empty(len(data.strokes)) for label in (*learners, STATIC)}
    for k, label in counted([(k, label) for k in range(PARTS) for label in errors]):
        left = of == k
        test = some(data, left)
        try:
            found = learners[label](some(data, ~left))(test) if label in learners else _before(test)
        except DataError:
            return None
        errors[label][left] = _off(found, test)
    return Compared(errors, data.owner)


def _learners(prior: Prior, tuned: EGNNParams, plain: EGNNParams, seed: int) -> dict[str, Callable[[Sequences], Ends]]:
    """What learns from sequences, by label."""
    kind = KINDS[prior.family]

    def with_prior(data: Sequences) -> Ends:
        settings = tuned.model_copy(update={"steps": kind.compared})
        own = kind.own(data, settings.neighbors, seed)
        return _trained(start_tuning(prior, own, data, None, settings, seed))

    def without(data: Sequences) -> Ends:
        settings = plain.model_copy(update={"steps": min(plain.steps, STEPS)})
        pairs = Pairs.of(data, settings.neighbors, shape_weight=settings.shape_weight)
        return _trained(Trainer(make_network(WITHOUT, settings, False, seed), pairs, None, settings, seed))

    networks: dict[str, Callable[[Sequences], Ends]] = {WITH: with_prior, WITHOUT: without}
    return {BODY: _pushed, **networks} if prior.family == "blocks" else networks


def _trained(trainer: Trainer) -> Ends:
    for _ in range(trainer.params.steps):
        trainer.step()
    network: nn.Module = trainer.network
    assert isinstance(network, EGNN)

    @torch.no_grad()
    def ends(test: Sequences) -> Tensor:
        rest = Rest.of(torch.as_tensor(test.rest), network.neighbors)
        grasp = torch.as_tensor(test.grasped())
        return network(_before(test), test.whole(), rest[torch.as_tensor(test.owner)], grasp)

    return ends


def _pushed(data: Sequences) -> Ends:
    body = RigidResidual(RigidParams())
    body.fit(data)

    def ends(test: Sequences) -> Tensor:
        poses, along, before, _ = body.scene(test)
        found = _before(test).clone()
        found[..., :2] = carry(before, poses, body.moved(poses, along))
        return found

    return ends


def _before(data: Sequences) -> Tensor:
    return torch.as_tensor(data.positions[data.strokes[:, 0]])


def _off(found: Tensor, data: Sequences) -> np.ndarray:
    """Mean distance [S] (m) of the particles that are seen from where the strokes left them."""
    first, last = data.strokes.T
    seen = None if data.seen is None else torch.as_tensor(data.seen[first] & data.seen[last])
    return mean_seen((found - torch.as_tensor(data.positions[last])).norm(dim=-1), seen).double().numpy()
