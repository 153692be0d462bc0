"""The training loop as an object that can be stopped, stored as arrays and taken up again bit for bit."""

import math
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
import torch
from torch import nn

from piegraph_cli.dynamics.params import LearningParams
from piegraph_cli.errors import DataError

HELD_OUT = 256
"""Validation examples looked at: as many of all, evenly spread."""

CHUNK = 64
"""Examples in one validation batch."""

FALLS = 0.03
"""A cycle that lowers the best validation loss by less than this share is the last one."""


class Examples(Protocol):
    """What a network learns from."""

    def __len__(self) -> int: ...

    def loss(self, network: nn.Module, chosen: torch.Tensor, rng: np.random.Generator | None = None, /) -> torch.Tensor:
        """The loss on the chosen examples [B]; with `rng` they are varied at random, as training wants it."""

    def static_loss(self, network: nn.Module, chosen: torch.Tensor, /) -> torch.Tensor:
        """The same if nothing moves."""


class Trainer:
    """AdamW, whose rate falls along a cosine; step t draws its batch from (seed, t) alone, so resuming changes nothing.

    The first cosine takes `params.steps`. Where there are examples to validate on, another one as long as all before it
    begins as long as the last one lowered the best validation loss by 3 %, up to `params.cycles`.
    Source: cycles that start anew, each twice as long, Loshchilov and Hutter, "SGDR", 2017.
    """

    def __init__(
        self,
        network: nn.Module,
        examples: Examples,
        validation: Examples | None,
        params: LearningParams,
        seed: int,
        device: str = "cpu",
    ):
        if len(examples) == 0:
            raise DataError("nothing to train on", hint="record longer strokes, or lower dataset.min_gap")
        self.examples, self.validation, self.params, self.seed = examples, validation, params, seed
        self.device = device
        self.network = network.to(device)
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=params.learning_rate, weight_decay=params.weight_decay, fused=True
        )
        self.done = 0
        self.best: dict[str, torch.Tensor] = {}
        self.best_loss = math.inf
        self.history: list[tuple[int, float, float]] = []
        self.recent = [0.0, 0.0]

    @property
    def cycle(self) -> tuple[int, int]:
        """The first step of the cycle that the next step is in, and the first of the one after it."""
        begin, end = 0, self.params.steps
        while self.done >= end:
            begin, end = end, 2 * end
        return begin, end

    @property
    def finished(self) -> bool:
        """Whether nothing more is gained: only ever where a cycle ends, after `record`."""
        (begin, end), first = self.cycle, self.params.steps
        if self.done != begin or not self.done:
            return False
        if self.validation is None or not len(self.validation) or end > first * 2 ** (self.params.cycles - 1):
            return True
        before = min((v for step, _, v in self.history if step <= begin // 2 and math.isfinite(v)), default=math.inf)
        return begin > first and not self.best_loss < (1 - FALLS) * before

    def step(self) -> None:
        """One step on a random batch. Raises `DataError` when training has diverged."""
        params, (begin, end) = self.params, self.cycle
        rng = np.random.default_rng([self.seed, self.done])
        batch = torch.as_tensor(rng.integers(0, len(self.examples), params.batch), device=self.device)
        for group in self.optimizer.param_groups:
            group["lr"] = params.learning_rate * 0.5 * (1 + math.cos(math.pi * (self.done - begin) / (end - begin)))
        loss = self.examples.loss(self.network, batch, rng)
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), params.clip)
        self.optimizer.step()
        self.done += 1
        value = loss.item()
        if not math.isfinite(value):
            raise DataError(f"training diverged at step {self.done}", hint="lower its learning_rate")
        self.recent = [self.recent[0] + value, self.recent[1] + 1]

    @torch.no_grad()
    def record(self) -> tuple[int, float, float]:
        """Note the step, the mean training loss since the last record, and the validation loss (NaN without one).

        Keeps these weights if they are the best on validation, or where there is no validation.
        """
        loss = math.nan
        if self.validation is not None and len(self.validation):
            loss = self._mean(self.validation, self.validation.loss)
        if not loss >= self.best_loss:
            self.best_loss = loss if math.isfinite(loss) else math.inf
            self.best = {name: value.detach().clone() for name, value in self.network.state_dict().items()}
        self.history.append((self.done, self.recent[0] / max(self.recent[1], 1), loss))
        self.recent = [0.0, 0.0]
        return self.history[-1]

    @torch.no_grad()
    def static_loss(self) -> float:
        """What the loss is if nothing moves: on validation, or where there is none, on what it learns from."""
        examples = self.validation if self.validation is not None and len(self.validation) else self.examples
        return self._mean(examples, examples.static_loss)

    def _mean(self, examples: Examples, loss: Callable[[nn.Module, torch.Tensor], torch.Tensor]) -> float:
        count = min(len(examples), HELD_OUT)
        chosen = torch.linspace(0, len(examples) - 1, count, device=self.device).long()
        return sum(loss(self.network, c).item() * len(c) for c in chosen.split(CHUNK)) / count

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
