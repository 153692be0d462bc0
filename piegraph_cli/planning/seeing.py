"""Episodes in which the object is known by looks alone: through cameras, before the first stroke and after each.

A look is `perception.look`, as a robot program calls it. What a simulator holds is read for one thing: to write down, beside
what was seen, how far the object truly is from its goal.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from piegraph_cli.dynamics.models import Trained
from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.environments.base import TIP_HEIGHT
from piegraph_cli.environments.sight import Sight
from piegraph_cli.errors import UsageError
from piegraph_cli.params import PUSH
from piegraph_cli.perception.judgement import JUDGED
from piegraph_cli.perception.look import Look, LookSettings
from piegraph_cli.physics.sheet_mesh import is_sheet
from piegraph_cli.planning.costs import make_cost
from piegraph_cli.planning.episode import Episode, draw_task, tool_of, within
from piegraph_cli.planning.expected import require_goal
from piegraph_cli.planning.experience import Tried
from piegraph_cli.planning.eyes import Eyes, Near, Unseen
from piegraph_cli.planning.goals import GOAL_POINTS, Goal, thinned
from piegraph_cli.planning.mpc import run_episode
from piegraph_cli.planning.params import PlanParams
from piegraph_cli.planning.planner import Tool, make_planner, metric
from piegraph_cli.planning.question import PARTICLES, wanted
from piegraph_cli.planning.search import Plan
from piegraph_cli.planning.thin import line_of, places_along
from piegraph_cli.planning.tracked import Tracked
from piegraph_cli.recording.film import Scene
from piegraph_cli.recording.params import CheckName, ReadParams

SURE = 0.9
"""Of the distance that counts as success: what is seen below so much of it is truly there, for looks are a little off."""
CLOUDS = 500
"""Points of each of two clouds that are compared."""
ARM_GAP = 0.01
"""Metres below the tool where it waits from which on what is seen is taken for the arm."""


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
    eyes = Eyes(_settings(params, trained))
    there = given if drawn is None else eyes.see(lambda: sight.shoot(drawn.shape))[0].cloud
    first, scene = eyes.see(sight.shoot)
    if there is None:
        there = wanted(trained, params, first.cloud, first.particles, None).points
    require_goal(there, first.cloud, eyes.settings.particles, eyes.settings.sizes, scene.cameras)
    loop = _Loop(environment, sight, eyes, within(params, environment.walls), trained, there, device)
    loop.seed, loop.tool = [params.seed, 2, start, goal], tool_of(environment)
    if params.keep == "track" or (params.keep == "auto" and is_sheet(first.cloud)):
        loop.track(first, scene)
    return loop.run(first, true, None if drawn is None else drawn.copies)


def _settings(params: PlanParams, trained: Trained | None) -> LookSettings:
    """With what to look: where the arm stays in view, nothing counts that is as high as it is.

    Raises `UsageError` for checks that there are not.
    """
    known = (*get_args(CheckName), *JUDGED)
    if unknown := sorted({*params.accept} - {*known}):
        raise UsageError(f"no check is called {unknown[0]}", "plan.accept", f"one of {', '.join(known)}")
    box = list(ReadParams().workspace)
    if params.sight.arm:
        box[5] = params.approach_height - ARM_GAP
    sizes, count = (trained.sizes, trained.particles) if trained else (None, PARTICLES)
    return LookSettings(ReadParams(workspace=box), particles=count, sizes=sizes, accept=params.accept)


class _Loop:
    """Plans, strokes and looks in turn."""

    def __init__(
        self,
        environment,
        sight: Sight,
        eyes: Eyes,
        params: PlanParams,
        trained: Trained | None,
        there: np.ndarray,
        device: str,
    ):
        self.environment, self.sight, self.eyes, self.params = environment, sight, eyes, params
        self.trained, self.there, self.device = trained, thinned(there, GOAL_POINTS), device
        self.line = line_of(self.there)
        self.tool, self.seed = Tool(), [0]
        self.tracked: Tracked | None = None
        self.whole: Goal | None = None
        self.unseen: Unseen | None = None

    def track(self, first: Look, scene: Scene) -> None:
        """Keep the particles of a first look, which know from then on where in the goal they belong, however they lie."""
        self.tracked = Tracked(first, scene, self.eyes.settings)
        self.whole = Goal.of_cloud(self.there, first.cloud, self.tracked.rest, self._rigid)

    def run(self, first: Look, true: np.ndarray, copies: np.ndarray | None) -> Episode:
        """The episode from a first look on; states as they were, `true` [N, 3] (m) the first, are kept and not read."""
        self.true = [true]
        self._take(first, first.particles)
        start, kind = self.positions, metric(self.params, self.goal)
        limits = {name: getattr(self.params, name) for name in ("strokes", "success", "look_every", "stop")}
        limits["success"] *= SURE
        begin = float(self.cost(torch.as_tensor(start)[None])[0])
        steps, ending = run_episode(start, self._plan, self._act, self.cost, **limits)
        seen = [step.distance for step in steps if np.isfinite(step.distance)]
        if self.unseen is not None:
            ending, why = "the look is bad", [f"{self.unseen.message}\n  try: {self.unseen.hint}"]
        else:
            why = []
        found = Episode(start, self.there, steps, begin, seen[-1] if seen else begin, kind, ending)
        return replace(found, true=tuple(self.true), copies=copies, said=(*self.eyes.said, *why))

    def cost(self, positions: torch.Tensor) -> torch.Tensor:
        """The distance of positions [B, N, 3] (m) from the goal, by the last look: [B]; NaN of those that nobody has seen.

        Of what was looked at, its clouds' too: a fold hides from particles that were chosen in it.
        """
        if not torch.isfinite(positions).all():
            return positions[:, 0, 0] * torch.nan
        found = self._cost(positions)
        if self.apart is None or not np.array_equal(positions.numpy(), self.positions[None]):
            return found
        return torch.full_like(found, self.apart) if self.goal.particles is None else found.clamp_min(self.apart)

    def _take(self, seen: Look, particles: np.ndarray) -> None:
        """Go on from a look: the goal's places, the cost and the planner of these particles [N, 3] (m)."""
        self.seen, self.positions = seen, particles.astype(np.float32)
        self.apart = self._clouds_apart()
        self.goal, params = self._goal(), self.params
        if params.cost == "distance" and self.goal.particles is None:  # bent otherwise than the goal, for now
            params = params.model_copy(update={"cost": "auto"})
        rest = self.positions if self.tracked is None else self.tracked.rest
        seed = [*self.seed, len(self.true)]
        self._cost, self._search = make_planner(self.trained, rest, self.goal, params, self.tool, seed, self.device)

    def _goal(self) -> Goal:
        """Where the particles belong: of a thin thing as far along it as now; else where its own shape lies in the goal."""
        if self.params.cost not in ("auto", "distance"):
            return Goal(self.there)
        places = places_along(self.line, self.seen.cloud, self.positions)
        if places is not None:
            return Goal(self.there, places)
        goal = self.whole
        if goal is None or goal.particles is None:
            goal = Goal.of_cloud(self.there, self.seen.cloud, self.positions, self._rigid)
        limit = SURE * self.params.success
        if goal.particles is None or self.apart is None or self.apart < limit:
            return goal
        off = float(np.linalg.norm(goal.particles - self.positions, axis=-1).mean(-1).min())
        return Goal(self.there) if off < limit else goal  # in its place, and not in its shape: folded

    @property
    def _rigid(self) -> bool:
        """Whether the object is known never to bend."""
        sizes = self.eyes.settings.sizes
        return sizes is not None and not sizes.bends

    def _clouds_apart(self) -> float | None:
        """Earth mover's distance (m) of the cloud seen last and the goal's. None where other costs are asked for, of what
        never bends, and of one camera, which sees other parts of an object here than there.
        """
        if self.params.cost not in ("auto", "distance") or self._rigid or len(self.sight.told) == 1:
            return None
        count = min(CLOUDS, len(self.seen.cloud), len(self.there))
        now, there = (torch.as_tensor(thinned(cloud, count)).float() for cloud in (self.seen.cloud, self.there))
        return float(make_cost("emd", there, count)(now[None])[0])

    def _plan(self, positions: torch.Tensor, tried: Sequence[Tried]) -> Plan | None:
        self.expected = self._search(positions, tried)
        return self.expected

    def _act(self, stroke: Strokes) -> tuple[np.ndarray, bool]:
        """Carry a stroke out and look: the particles [N, 3] (m) after it, and whether it was blocked."""
        before, length = self.positions, float(stroke.along.norm())
        after, _, _, _, info = self.environment.step(stroke.action())
        self.true.append(after)
        if self.tracked is not None:
            hand, mode = np.asarray(info["pusher"], float), int(stroke.mode)
            lower = np.array([0, 0, TIP_HEIGHT if mode == PUSH else 0.0])
            self.tracked.follow(hand, mode, lambda k: self.sight.shoot(info["shapes"][k], hand[k] - lower))
        tip = info["pusher"][-1] * [1, 1, 0] + [0, 0, self.params.approach_height] if self.params.sight.arm else None
        near = Near(self.seen.cloud, length)
        try:
            found, scene = self.eyes.see(lambda: self.sight.shoot(tip=tip), near)
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
