"""A fake of DaXBench's rope: particles inside the pusher move along with it and coast on when it stops."""

import os

import numpy as np
import pyrender
from daxbench.core.engine.fake import MPMState, PrimitiveState, Simulator, misbehave, stack
from daxbench.core.engine.pyrender.py_render import ParticlePyRenderer

HALF = 0.015
SUB_ACTIONS = 30


class ShapeRopeEnv:
    def __init__(self, batch_size, seed, max_steps=6, conf=None):
        self.simulator, self.max_steps, self.state = Simulator(), max_steps, None
        self.drawing = ParticlePyRenderer(), pyrender.Scene()
        self.seed(seed)
        self.reset(self.simulator.key_global)

    def seed(self, seed):
        self.simulator.key_global = np.array([0, seed], np.uint32)
        np.random.seed(seed)  # noqa: NPY002 - as DaXBench does

    def reset(self, key):
        x = np.stack(np.meshgrid(np.linspace(0.375, 0.625, 40), [0.007, 0.013], [0.497, 0.503]), -1).reshape(-1, 3)
        state = MPMState(x.astype(np.float32), np.zeros_like(x, np.float32), self.simulator.key_global, np.array(0))
        state.primitives.append(PrimitiveState(np.full(3, HALF, np.float32), np.zeros((4, 3), np.float32)))
        state = state._replace(primitives=[PrimitiveState(*(a[None] for a in p)) for p in state.primitives])
        self.init_state = state._replace(
            x=state.x[None], v=state.v[None], key=key[None], cur_step=np.zeros(1, np.int32)
        )
        self.state = self.init_state
        for _ in range(2):
            way = np.random.uniform(-0.05, 0.05, 2)  # noqa: NPY002
            start, end = ([0.5 + sign * way[0], 0, 0.5 + sign * way[1]] for sign in (-1, 1))
            self.state = self.step_diff(np.array([[*start, *end]], np.float32), self.state)[3]["state"]
        return None, self.state

    def step_diff(self, actions, state):
        misbehave()
        x, v = state.x.copy(), state.v.copy()
        start, end = (actions[0, k : k + 3] * [1, 0, 1] + [0, 0.01, 0] for k in (0, 3))
        move = ((end - start) / SUB_ACTIONS).astype(np.float32)
        record = []
        for k in range(1, SUB_ACTIONS + 1):
            at = (start + k * move).astype(np.float32)
            inside = (np.abs(x[0] - at)[:, [0, 2]] < HALF).all(1)
            v[0] = np.where(inside[:, None], move, 0.5 * v[0])
            x = x + v
            primitive = state.primitives[0]._replace(position=np.broadcast_to(at, (1, 4, 3)).copy())
            record.append(state._replace(x=x.copy(), v=v.copy(), primitives=[primitive, *state.primitives[1:]]))
        if os.environ.get("FAKE_DAXBENCH") == "nan" and np.linalg.norm(end - start) > 0.2:
            # a NaN on the way, in no frame of a stroke of 40 cm, which DaXBench has made a number again by the end
            record[1].x[0, 5] = np.nan
        after = record[-1]._replace(cur_step=state.cur_step + 1)
        done = after.cur_step[0] >= self.max_steps
        return None, 0.0, done, {"state": self.init_state if done else after, "state_list": stack(record)}
