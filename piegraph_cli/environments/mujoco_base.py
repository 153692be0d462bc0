"""What the environments simulated by MuJoCo share: the table, the pusher, strokes in time, states, divergence.

An environment describes its object as one MuJoCo flex in MJCF, lying around the origin; its shape (`Motion.shapes`)
is the flex's vertices, the nodes, [V, 3] in metres, world frame.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from piegraph_cli.environments.base import FRAME_RATE, TIP_HEIGHT, Environment, Motion, check_state, stroke_frames
from piegraph_cli.errors import DataError, UsageError

_PUSHER_HALF_LENGTH = 0.08
"""Metres: through the table and above every object, so that nothing meets its round ends."""
_PUSHER_MASS = 0.05
"""Kilograms; with its servo the pusher lags by 5 ms behind where it is steered, half a millimetre at most."""
_PARKED = np.array([0.0, 0.0, 2.0])
_FASTEST = 1e3
"""Nothing moves this fast, in m/s or rad/s, unless the simulation has diverged."""
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_SPREAD = 0.08
_SETTLE_CHECK = 0.05
"""Seconds between two looks at whether the object has come to rest."""


def scene(
    flexcomp: str,
    friction: float,
    *,
    timestep: float = 0.005,
    solver: str = "Newton",
    iterations: int = 50,
    impratio: float = 1,
    more: str = "",
) -> str:
    """MJCF of an object on the table z = 0 beside the pusher.

    `flexcomp` is the object's element, its points around the origin; `friction` the Coulomb coefficient of table and
    pusher (MuJoCo takes the larger one of a pair: give the object the same); `impratio` how much harder friction is than
    the normal force (objects at rest creep less); `more` follows the world body.
    Friction cones are elliptic: with pyramids, where a stroke leaves a rope depends on its yaw by 4 mm.
    """
    axes = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    slides = "".join(f'<joint name="pusher_{n}" type="slide" axis="{axis}"/>' for n, axis in axes.items())
    motors = "".join(f'<position name="pusher_{n}" joint="pusher_{n}" kp="1e4" dampratio="1"/>' for n in axes)
    return f"""<mujoco>
  <option timestep="{timestep}" integrator="discrete" cone="elliptic" impratio="{impratio}" solver="{solver}"
    iterations="{iterations}">
    <flag autoreset="disable"/>
  </option>
  <size memory="64M"/>
  <worldbody>
    <geom name="table" type="plane" size="0 0 1" friction="{friction}"/>
    <body name="pusher" gravcomp="1">
      {slides}
      <geom name="pusher" type="capsule" size="{Environment.pusher_radius} {_PUSHER_HALF_LENGTH}" mass="{_PUSHER_MASS}"
        friction="{friction}" priority="1" solref="{timestep} 1"/>
    </body>
    {flexcomp}
  </worldbody>
  <actuator>{motors}</actuator>
  <contact><exclude body1="world" body2="pusher"/></contact>
  {more}
</mujoco>"""


class _Diverged(Exception):
    """Time must not go on: steps with absurd numbers take a hundred times as long."""


class MujocoEnvironment(Environment):
    """One deformable object on a table; the MJCF's one flex, whose nodes are its shape.

    A subclass sets `weights` and `triangles` and says how the surface follows from the nodes; for picks it adds a
    `_pick` made of `_advance`, `_follow` and `_settle`.
    """

    settle_speed = 0.005
    """The object is at rest when no part of it is faster, m/s."""
    settle_time = 2.0
    """Longest that it is waited for, seconds."""
    outline_radius: float
    """Metres around each node that together cover the object as seen from above."""
    weights: np.ndarray
    """[N, V] of the nodes in each particle."""

    def __init__(self, particles: int, mjcf: str):
        super().__init__(particles)
        try:
            self.model = mujoco.MjModel.from_xml_string(mjcf)
        except ValueError as error:
            raise UsageError(
                f"MuJoCo refuses these options: {error}", type(self).__name__, "values closer to the defaults"
            ) from None
        self.data = mujoco.MjData(self.model)
        self._before = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        self._steps_per_frame = round(1 / (FRAME_RATE * self.model.opt.timestep))
        model = self.model
        # bodies with three slide joints along the world's axes: the nodes themselves, or the corners of a coarse grid
        bodies = np.unique(model.flex_nodebodyid if model.flex_interp[0] else model.flex_vertbodyid)
        bodies = bodies[bodies > 0]  # corners of the grid that the object does not reach are left to the world
        joints = model.body_jntadr[bodies][:, None] + np.arange(3)
        self._rest = model.body_pos[bodies]
        self._qpos, self._qvel = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        pusher = model.body_jntadr[model.body("pusher").id] + np.arange(3)
        self._pusher_qpos, self._pusher_qvel = model.jnt_qposadr[pusher], model.jnt_dofadr[pusher]
        self._pusher_ctrl = np.array([model.actuator(f"pusher_{axis}").id for axis in "xyz"])

    @property
    def nodes(self) -> np.ndarray:
        """[V, 3] the nodes now, metres, world frame."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_flex(self.model, self.data)
        return self.data.flexvert_xpos.copy()

    def particles(self, shapes: np.ndarray | None = None) -> np.ndarray:
        """Particles of nodes [..., V, 3] (m; by default the current ones), float32 [..., N, 3] (m)."""
        return (self.weights @ (self.nodes if shapes is None else shapes)).astype(np.float32)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Lay the object down near the origin at random, or at `options["pose"]` (x, y in m, yaw in rad), until it rests.

        Raises DataError when it does not come to rest sanely.
        """
        super().reset(seed=seed)
        x, y = self.np_random.uniform(-_SPREAD, _SPREAD, 2)
        pose = np.array([x, y, self.np_random.uniform(-math.pi, math.pi)])
        pose = np.array((options or {}).get("pose", pose), np.float64)
        mujoco.mj_resetData(self.model, self.data)
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        turned = self._rest @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + [pose[0], pose[1], 0]
        self.data.qpos[self._qpos] = turned - self._rest
        self._place_pusher(_PARKED)
        with self._watch() as sane:
            self._settle()
        if not sane():
            raise DataError("the object does not come to rest", type(self).__name__, "softer options")
        return self.particles(), {"pose": pose}

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything MuJoCo integrates from, in its own order: `integration` [S]."""
        state = np.empty_like(self._before)
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return {"integration": state}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Return to a state of `get_state`, bit for bit. Raises DataError for one that is not finite or not its own."""
        check_state(state, ("integration",), type(self).__name__)
        values = np.array(state["integration"], np.float64)
        if values.shape != self._before.shape:
            raise DataError(
                f"a state of shape {values.shape}, but this environment's has {len(self._before)} numbers",
                type(self).__name__,
                "use what get_state gave",
            )
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, values, _STATE)

    def _outline(self) -> tuple[np.ndarray, float]:
        return self.nodes[:, :2], self.outline_radius

    def _push(self, start: np.ndarray, end: np.ndarray) -> Motion:
        frames = stroke_frames(float(np.linalg.norm(end - start)))
        ends = np.array([[*start, TIP_HEIGHT], [*end, TIP_HEIGHT]])
        path = smooth_path(ends[0], ends[1], frames * self._steps_per_frame)
        shapes = [self.nodes]
        with self._watch() as sane:
            self._place_pusher(ends[0])
            shapes += self._follow(path, self._steer_pusher)
            self._place_pusher(_PARKED)
            self._settle()
        shapes[-1] = self.nodes
        pusher = np.concatenate([ends[:1], path[self._steps_per_frame - 1 :: self._steps_per_frame]])
        return Motion(self._checked(shapes, sane()), pusher)

    def _place_pusher(self, position: np.ndarray) -> None:
        """Put the pusher's middle at a position [3] (m), at rest."""
        self.data.qpos[self._pusher_qpos] = position
        self.data.qvel[self._pusher_qvel] = 0
        self._steer_pusher(position)

    def _steer_pusher(self, position: np.ndarray) -> None:
        self.data.ctrl[self._pusher_ctrl] = position

    def _follow(self, path: np.ndarray, steer: Callable[[np.ndarray], None]) -> list[np.ndarray]:
        """Steer along a path [steps, 3], one point a time step, and return the nodes [V, 3] at 5 Hz, last one included.

        The number of steps is a multiple of `_steps_per_frame`.
        """
        shapes = []
        for count, point in enumerate(path, 1):
            steer(point)
            self._step()
            if count % self._steps_per_frame == 0:
                shapes.append(self.nodes)
        return shapes

    def _advance(self, seconds: float) -> None:
        """Let time pass with everything steered where it is."""
        for _ in range(round(seconds / self.model.opt.timestep)):
            self._step()

    def _step(self) -> None:
        """One time step. Raises _Diverged, which `_watch` takes note of.

        With the pusher in contact, MuJoCo 4.0's sparse Newton solver stalls far from the solution in 0.2 % of the steps;
        its dense one, at three times the cost, is there in five iterations. So those steps are made again, dense.
        """
        model, data = self.model, self.data
        newton = model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
        if newton:
            mujoco.mj_getState(model, data, self._before, _STATE)
        mujoco.mj_step(model, data)
        if newton and data.solver_niter[: max(1, data.nisland)].max() >= model.opt.iterations:
            mujoco.mj_setState(model, data, self._before, _STATE)
            model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
            mujoco.mj_step(model, data)
            model.opt.jacobian = mujoco.mjtJacobian.mjJAC_AUTO
        if not np.abs(data.qvel).max() < _FASTEST:
            raise _Diverged

    def _settle(self) -> None:
        """Wait until the object is at rest, at most `settle_time`, then take what speed is left."""
        for _ in range(round(self.settle_time / _SETTLE_CHECK)):
            self._advance(_SETTLE_CHECK)
            if np.linalg.norm(self.data.qvel[self._qvel], axis=1).max() < self.settle_speed:
                break
        self.data.qvel[:] = 0

    @contextmanager
    def _watch(self) -> Iterator[Callable[[], bool]]:
        """Silence MuJoCo's log, which it would write into the current folder; gives whether nothing went wrong."""
        before = mujoco.get_mju_user_warning()
        failed: list[bool] = []
        mujoco.set_mju_user_warning(lambda message: None)
        counts = self._warnings()
        try:
            yield lambda: not failed and self._warnings() == counts
        except (_Diverged, mujoco.FatalError):
            failed.append(True)
        finally:
            mujoco.set_mju_user_warning(before)

    def _warnings(self) -> list[int]:
        # a stiff object's ill-conditioned inertia is none of these: its solution is less exact, not wrong
        return [w.number for k, w in enumerate(self.data.warning) if k != mujoco.mjtWarning.mjWARN_INERTIA]

    @staticmethod
    def _checked(shapes: Iterable[np.ndarray], sane: bool) -> np.ndarray:
        """Shapes [F, V, 3] that are not finite if something went wrong, which `step` then reports."""
        stacked = np.stack(list(shapes))
        if not sane:
            stacked[:] = np.nan
        return stacked


def smooth_path(start: np.ndarray, end: np.ndarray, steps: int) -> np.ndarray:
    """Points [steps, 3] from just after start [3] to end [3] on a straight line, slow at both ends."""
    share = np.arange(1, steps + 1)[:, None] / steps
    return start + (end - start) * share**2 * (3 - 2 * share)
