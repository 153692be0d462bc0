"""A model as one object: what was learned of one kind of object, by name, with the settings to predict and plan with it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from piegraph_cli.dynamics.models import Trained, make_predict
from piegraph_cli.dynamics.stroke import Predict, Strokes
from piegraph_cli.errors import DataError
from piegraph_cli.params import validated
from piegraph_cli.planning.expected import require_order
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.question import PARTICLES, Answer, answer, finite


@dataclass(frozen=True)
class Model:
    """Predicts particles after strokes, and plans strokes to a goal. World frame, metres, radians, z up."""

    label: str
    """As in `train.models` and `evaluate.models`: `piegraph`, `pgnd@20`, `static`."""
    trained: Trained | None
    """None where nothing is learned, as for `static` and `sms-no`."""
    settings: PlanParams = field(default_factory=PlanParams)
    """In force where a call gives no others."""
    device: str = "cpu"
    """Where strokes are searched: `cpu` or `cuda`."""

    @property
    def particles(self) -> int:
        """How many particles an object has that it was trained on."""
        return self.trained.particles if self.trained else PARTICLES

    def of_object(self, rest: Any) -> Predict:
        """The prediction for one object at rest [N, 3] (m), on tensors: (positions [B, N, 3], strokes [B]) -> [B, N, 3]."""
        return make_predict(self.label, self.trained, torch.as_tensor(finite(rest, "rest")), self.settings)

    def predict(self, positions: Any, strokes: Strokes, *, rest: Any = None) -> np.ndarray:
        """Particles [B, N, 3] float32 (m) after one stroke each, from positions [B, N, 3] or, for all strokes, [N, 3] (m).

        `rest` [N, 3] (m) is the object's rest shape, in the same order of particles; by default the first positions. Raises
        `DataError` for values that are not finite, strokes without a heading, and shapes that do not belong together.
        """
        now = np.asarray(positions, np.float32)
        now = np.repeat(now[None], len(strokes), 0) if now.ndim == 2 else now
        if now.ndim != 3 or len(now) != len(strokes) or len(now) == 0:
            raise DataError(
                f"positions {list(now.shape)} for {len(strokes)} strokes", "predict", "give [B, N, 3] or [N, 3]"
            )
        if now.shape[1] < 2:
            raise DataError("one particle is no object", "positions", "give all particles of it")
        finite(now.reshape(-1, now.shape[-1]), "positions")
        if rest is not None:
            require_order(now[0], finite(rest, "rest"), "rest")
        predict = self.of_object(now[0] if rest is None else rest)
        return predict(torch.as_tensor(now), strokes.to(torch.float32)).numpy()

    def plan(
        self,
        state: Any,
        *,
        goal: Any = None,
        goal_pose: Any = None,
        goal_at: Any = None,
        rest: Any = None,
        corresponds: bool = False,
        **settings: Any,
    ) -> Answer:
        """The next strokes for an object whose cloud or particles are `state` [P, 3] (m), P at least `particles`.

        The goal is a cloud [G, 3] (m), which with the state is the object's particles in one order where it `corresponds`, a
        motion of the object from where it is now (DX, DY (m), DYAW (rad)), or a pose in the world (X, Y (m), YAW (rad)):
        where the middle of the trained rest shape, `trained.rest`, shall be, and how far it is turned from how that lies.
        With `rest` [N, 3] (m), its rest shape, the state are its particles in the same order, as a tracker follows them.
        State and goal lie in the world of the table that the settings name; what is planned has the table at z = 0.
        Settings are those of `piegraph plan`. No strokes where the goal is reached already. Raises `UsageError` for settings,
        and `DataError` for states and goals, that cannot be used.
        """
        values = (
            self.settings.model_dump() | {"model": self.label, "goal_pose": goal_pose, "goal_at": goal_at} | settings
        )
        params = validated(PlanParams, values, "plan", "Model.plan", "piegraph plan --help")
        return answer(self.trained, params, state, goal, rest=rest, corresponds=corresponds, device=self.device)
