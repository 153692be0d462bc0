"""The training loop as an object that can be stopped, stored as arrays and taken up again bit for bit."""

import math
from collections.abc import Mapping

import numpy as np
import torch

from piegraph_cli.dynamics.egnn import EGNN, Rest
from piegraph_cli.dynamics.losses import dynamics_loss
from piegraph_cli.errors import DataError
from piegraph_cli.params import TrainParams


def make_network(params: TrainParams, picks: bool) -> EGNN:
    """A network with fresh weights, drawn from the seed; `picks` where the data has picks."""
    torch.manual_seed(params.seed)
    return EGNN(params.neighbors, params.hidden, params.layers, params.action_head, picks)


class Pairs:
    """Training pairs: start and end positions [P, N, 3] (m), strokes [P, 7], whose object each is, and what picks hold."""

    def __init__(
        self,
        start: np.ndarray,
        end: np.ndarray,
        strokes: np.ndarray,
        rest: np.ndarray,
        owner: np.ndarray,
        grasp: np.ndarray,
        neighbors: int,
        device: str = "cpu",
    ):
        """`rest` [S, N, 3] (m): objects at rest; `owner` [P]: the object of each pair; `grasp` [P]: its grasped particle."""
        self.start, self.end, self.strokes, at_rest = (
            torch.as_tensor(np.asarray(a, np.float32), device=device) for a in (start, end, strokes, rest)
        )
        self.rest = Rest.of(at_rest, neighbors)
        self.owner, self.grasp = (torch.as_tensor(np.asarray(a, np.int64), device=device) for a in (owner, grasp))

    @property
    def picks(self) -> bool:
        """Whether any stroke is a pick."""
        return bool(self.strokes[:, 4].any())

    def loss(
        self, network: EGNN, chosen: torch.Tensor, shape_weight: float, mirrored: torch.Tensor | None = None
    ) -> torch.Tensor:
        """`dynamics_loss` (dm^2) of the network on the chosen pairs [B], those in `mirrored` [B] reflected in y."""
        rest = self.rest[self.owner[chosen]]
        start, end, strokes = self.start[chosen], self.end[chosen], self.strokes[chosen]
        if mirrored is not None:
            sign = 1 - 2 * mirrored.to(start)[:, None, None]
            start, end = (torch.cat([p[..., :1], p[..., 1:2] * sign, p[..., 2:]], -1) for p in (start, end))
            strokes = strokes.clone()
            strokes[:, 1:4:2] *= sign[:, 0]
        return dynamics_loss(network(start, strokes, rest, self.grasp[chosen]), end, rest.neighbors, shape_weight)

    def __len__(self) -> int:
        return len(self.start)


class Trainer:
    """AdamW with a cosine over `params.steps`; step t draws its batch from (seed, t) alone, so resuming changes nothing."""

    def __init__(self, pairs: Pairs, validation: Pairs | None, params: TrainParams, device: str = "cpu"):
        if len(pairs) == 0:
            raise DataError("no training pairs", hint="record longer strokes, or lower dataset.min_gap")
        self.pairs, self.validation, self.params = pairs, validation, params
        self.network = make_network(params, pairs.picks).to(device)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=params.learning_rate, weight_decay=params.weight_decay, fused=True
        )
        self.done = 0
        self.best: dict[str, torch.Tensor] = {}
        self.best_loss = math.inf
        self.history: list[tuple[int, float, float]] = []
        self.recent = [0.0, 0.0]

    def step(self) -> None:
        """One step on a random batch. Raises `DataError` when training has diverged."""
        params, pairs = self.params, self.pairs
        rng = np.random.default_rng([params.seed, self.done])
        batch = torch.as_tensor(rng.integers(0, len(pairs), params.batch), device=pairs.start.device)
        mirrored = torch.as_tensor(rng.random(params.batch) < 0.5, device=batch.device) if params.mirror else None
        for group in self.optimizer.param_groups:
            group["lr"] = params.learning_rate * 0.5 * (1 + math.cos(math.pi * self.done / params.steps))
        loss = pairs.loss(self.network, batch, params.shape_weight, mirrored)
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), params.clip)
        self.optimizer.step()
        self.done += 1
        value = loss.item()
        if not math.isfinite(value):
            raise DataError(f"training diverged at step {self.done}", hint="lower train.learning_rate")
        self.recent = [self.recent[0] + value, self.recent[1] + 1]

    @torch.no_grad()
    def record(self) -> tuple[int, float, float]:
        """Note the step, the mean training loss since the last record, and the validation loss (NaN without one).

        Keeps these weights if they are the best on validation, or where there is no validation.
        """
        loss = math.nan
        if self.validation is not None and len(self.validation):
            chunks = torch.arange(len(self.validation), device=self.validation.start.device).split(256)
            losses = [self.validation.loss(self.network, c, self.params.shape_weight).item() * len(c) for c in chunks]
            loss = sum(losses) / len(self.validation)
        if not loss >= self.best_loss:
            self.best_loss = loss if math.isfinite(loss) else math.inf
            self.best = {name: value.detach().clone() for name, value in self.network.state_dict().items()}
        self.history.append((self.done, self.recent[0] / max(self.recent[1], 1), loss))
        self.recent = [0.0, 0.0]
        return self.history[-1]

    def state(self) -> dict[str, np.ndarray]:
        """Everything `load` needs, as arrays."""
        arrays = {f"network.{k}": v for k, v in self.network.state_dict().items()}
        arrays |= {f"best.{k}": v for k, v in self.best.items()}
        for index, slot in self.optimizer.state_dict()["state"].items():
            arrays |= {f"adam.{index}.{k}": v for k, v in slot.items()}
        plain = {name: value.detach().cpu().numpy() for name, value in arrays.items()}
        plain["history"] = np.array(self.history, np.float64).reshape(-1, 3)
        plain["recent"] = np.array(self.recent)
        return plain | {"done": np.array(self.done), "best_loss": np.array(self.best_loss)}

    def load(self, state: Mapping[str, np.ndarray]) -> None:
        """Take up the state that `state` gave."""
        tensors = {name: torch.as_tensor(value) for name, value in state.items()}

        def part(prefix: str) -> dict[str, torch.Tensor]:
            return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}

        self.network.load_state_dict(part("network."))
        self.best = {k: v.clone() for k, v in part("best.").items()}
        slots: dict[int, dict[str, torch.Tensor]] = {}
        for name, value in part("adam.").items():
            index, slot = name.split(".")
            slots.setdefault(int(index), {})[slot] = value
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": slots, "param_groups": groups})
        self.recent = state["recent"].tolist()
        self.done, self.best_loss = int(state["done"]), float(state["best_loss"])
        self.history = [(int(step), train, validation) for step, train, validation in state["history"].tolist()]
