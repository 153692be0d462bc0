"""Episodes in which the object is known by looks alone: through cameras, before the first stroke and after each.

A look is `perception.look`, as a robot program calls it. What a simulator holds is read for one thing: to write down, beside
what was seen, how far the object truly is from its goal.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from piegraph_cli.dynamics.models import Trained
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.environments.base import TIP_HEIGHT
from piegraph_cli.environments.sight import Sight
from piegraph_cli.errors import DataError
from piegraph_cli.perception.look import Look, LookSettings, look
from piegraph_cli.planning.episode import Episode, draw_task, tool_of, within
from piegraph_cli.planning.expected import require_goal
from piegraph_cli.planning.experience import Tried
from piegraph_cli.planning.goals import Goal
from piegraph_cli.planning.mpc import run_episode
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import Tool, make_planner, metric
from piegraph_cli.planning.question import PARTICLES, wanted
from piegraph_cli.planning.search import Plan
from piegraph_cli.planning.tracked import Tracked
from piegraph_cli.recording.film import Scene

LOOKS = 3
"""Looks in a row that may be bad before an episode stops: noise and what passes by are gone in the next one."""
LEAP = 0.06
"""Metres that an object may move further than the tool went: what is seen farther away is another thing."""


class Unseen(DataError):
    """The object cannot be seen: nobody knows where it is."""


def see(
    shoot: Callable[[], Scene], settings: LookSettings, said: list[str], near: "Near | None" = None
) -> tuple[Look, Scene]:
    """The first of `LOOKS` looks that can be trusted, and its images; what was wrong with others is appended to `said`.

    Raises `Unseen` with the reasons where none can be, or where the cameras deliver nothing.
    """
    for again in range(LOOKS):
        try:
            scene = shoot()
            found = look(*scene, settings)
            found.require()
            if near is not None:
                near.require(found.cloud)
            return found, scene
        except DataError as error:
            if again == LOOKS - 1:
                raise Unseen(f"{error.message} (as in {LOOKS} looks in a row)", error.where, error.hint) from None
            said.append(f"{error.message}; looked again")
    raise AssertionError


@dataclass(frozen=True)
class Near:
    """Where an object can be after a stroke."""

    cloud: np.ndarray
    """[P, 3] metres: what was seen before it."""
    length: float
    """Of the stroke, metres."""

    def require(self, cloud: np.ndarray) -> None:
        """Raise `DataError` where a cloud [Q, 3] (m) cannot be the object."""
        apart = float(np.linalg.norm(cloud[:, :2].mean(0) - self.cloud[:, :2].mean(0)))
        if apart <= self.length + LEAP:
            return
        x, y = cloud[:, :2].mean(0)
        raise DataError(
            f"what is seen at x, y = ({x:+.2f}, {y:+.2f}) m cannot be the object: it lay {apart * 100:.0f} cm away, and the "
            f"tool went {self.length * 100:.0f} cm",
            "look",
            "look what lies there, and whether the object is still on the table",
        )


def play_seen(
    environment,
    trained: Trained | None,
    params: PlanParams,
    given: np.ndarray | None = None,
    *,
    start: int,
    goal: int,
    device: str = "cpu",
) -> Episode:
    """As `episode.play`, through cameras: every state and, where it is not `given` [G, 3] (m), the goal are clouds.

    Raises `DataError` where no look at the start or at the goal can be trusted, and for a goal that cannot be this object's.
    """
    asked = given is not None or params.goal_pose is not None or params.goal_at is not None
    true, drawn = draw_task(environment, params, start, goal, None if asked else environment.goal_state)
    sight = Sight(environment, params.sight, [params.seed, 5, start, goal])
    settings = LookSettings(
        particles=trained.particles if trained else PARTICLES, sizes=trained.sizes if trained else None
    )
    said: list[str] = []
    there = given
    if drawn is not None:
        there = see(lambda: sight.shoot(drawn.shape), settings, said)[0].cloud
    first, scene = see(sight.shoot, settings, said)
    if there is None:
        there = wanted(trained, params, first.cloud, first.particles, None).points
    require_goal(there, first.cloud, settings.particles, settings.sizes)
    loop = _Loop(environment, sight, settings, within(params, environment.walls), trained, there, said, device)
    loop.seed, loop.tool = [params.seed, 2, start, goal], tool_of(environment)
    if params.keep == "track":
        loop.tracked = Tracked(first, scene, settings, TIP_HEIGHT)
    return loop.run(first, [true], None if drawn is None else drawn.copies)


class _Loop:
    """Plans, strokes and looks in turn."""

    def __init__(
        self,
        environment,
        sight: Sight,
        settings: LookSettings,
        params: PlanParams,
        trained: Trained | None,
        there: np.ndarray,
        said: list[str],
        device: str,
    ):
        self.environment, self.sight, self.settings, self.params = environment, sight, settings, params
        self.trained, self.there, self.said, self.device = trained, there, said, device
        self.tool, self.seed = Tool(), [0]
        self.tracked: Tracked | None = None
        self.unseen: Unseen | None = None

    def run(self, first: Look, true: list[np.ndarray], copies: np.ndarray | None) -> Episode:
        """The episode from a first look on; `true` gathers the states as they were, which nothing here reads."""
        self.true = true
        self._take(first, first.particles)
        start, kind = self.positions, metric(self.params, self.goal)
        limits = {name: getattr(self.params, name) for name in ("strokes", "success", "look_every", "stop")}
        begin = float(self.cost(torch.as_tensor(start)[None])[0])
        steps, ending = run_episode(start, self._plan, self._act, self.cost, **limits)
        seen = [step.distance for step in steps if np.isfinite(step.distance)]
        if self.unseen is not None:
            ending, why = "the look is bad", [f"{self.unseen.message}\n  try: {self.unseen.hint}"]
        else:
            why = []
        found = Episode(start, self.there, steps, begin, seen[-1] if seen else begin, kind, ending)
        return replace(found, true=tuple(self.true), copies=copies, said=(*self.said, *why))

    def cost(self, positions: torch.Tensor) -> torch.Tensor:
        """The distance of positions [B, N, 3] (m) from the goal, by the last look: [B]; NaN of those that nobody has seen."""
        return self._cost(positions) if torch.isfinite(positions).all() else positions[:, 0, 0] * torch.nan

    def _take(self, seen: Look, particles: np.ndarray) -> None:
        """Go on from a look: the goal's places, the cost and the planner of these particles [N, 3] (m)."""
        self.seen, self.positions = seen, particles.astype(np.float32)
        self.goal = Goal.of_cloud(self.there, seen.cloud, self.positions)
        rest = self.positions if self.tracked is None else self.tracked.rest
        seed = [*self.seed, len(self.true)]
        self._cost, self._search = make_planner(
            self.trained, rest, self.goal, self.params, self.tool, seed, self.device
        )

    def _plan(self, positions: torch.Tensor, tried: Sequence[Tried]) -> Plan | None:
        self.expected = self._search(positions, tried)
        return self.expected

    def _act(self, stroke: Strokes) -> tuple[np.ndarray, bool]:
        """Carry a stroke out and look: the particles [N, 3] (m) after it, and whether it was blocked."""
        before, length = self.positions, float(stroke.along.norm())
        after, _, _, _, info = self.environment.step(stroke.action())
        self.true.append(after)
        if self.tracked is not None:
            self.tracked.follow(self.sight, info, int(stroke.mode))
        tip = info["pusher"][-1] * [1, 1, 0] + [0, 0, self.params.approach_height] if self.params.sight.arm else None
        near = Near(self.seen.cloud, length)
        try:
            found, scene = see(lambda: self.sight.shoot(tip=tip), self.settings, self.said, near)
        except Unseen as unseen:
            self.unseen = unseen
            return np.full_like(before, np.nan), bool(info["blocked"])
        if self.tracked is not None:
            self._take(found, self.tracked.settle(found, scene))
        else:
            assert self.expected is not None
            self._take(found, alike(found.particles, before, self.expected.predicted[0].numpy()))
        return self.positions, info["blocked"]


def alike(particles: np.ndarray, *others: np.ndarray) -> np.ndarray:
    """Particles [N, 3] (m) in the order of the nearest one of other states [N, 3] (m): fresh ones have none."""
    best: tuple[float, np.ndarray] | None = None
    for other in others:
        apart = np.linalg.norm(other[:, None] - particles[None], axis=-1)
        order = linear_sum_assignment(apart)[1]
        mean = float(apart[np.arange(len(order)), order].mean())
        if best is None or mean < best[0]:
            best = mean, order
    assert best is not None
    return particles[best[1]]
