"""A fake of DaXBench's T-shirt: what the picker holds follows it, the rest follows less, and all falls slowly."""

import numpy as np
from daxbench.core.engine.fake import ClothState, Simulator, misbehave, stack
from daxbench.core.engine.usdrender.mesh_usd import create_usd_cloth_scene

CELL = 1 / 36


class FoldTshirtEnv:
    def __init__(self, batch_size, conf=None, aux_reward=False, seed=1):
        self.simulator, self.drawing = Simulator(), create_usd_cloth_scene
        self.simulator.reset_jax = self._flat
        self.seed(seed)

    def seed(self, seed):
        self.simulator.key_global = np.array([0, seed], np.uint32)

    def _flat(self):
        rows, columns = np.mgrid[0:19, 0:13]
        shirt = (rows < 7) | ((columns > 2) & (columns < 10))
        x = np.column_stack([rows[shirt], np.zeros(shirt.sum()), columns[shirt]]) * CELL
        x = x - (x.max(0) + x.min(0)) / 2 * [1, 0, 1] + [0.5, 0, 0.5]
        picker = np.array([[0.5, 0.5, 0.5, 0.01]], np.float32)
        return ClothState(x[None].astype(np.float32), picker, self.simulator.key_global[None], np.zeros(1, np.int32))

    def reset(self, key):
        shift = np.random.default_rng(key).normal(0, 0.05, 2).astype(np.float32)
        state = self._flat()
        state.x[..., [0, 2]] += shift
        return None, state

    def step_diff(self, actions, state):
        misbehave()
        x, picker = state.x[0].copy(), state.primitive0[0].copy()
        pick, place = (actions[0, k : k + 3] * [1, 0, 1] for k in (0, 3))
        moves = np.concatenate([
            np.repeat([(pick - picker[:3]) / 3], 3, 0), [[0, 0.006, 0]] * 10, np.repeat([(place - pick) / 20], 20, 0),
            np.zeros((7, 3)),
        ])  # fmt: skip
        record = []
        for k, move in enumerate(moves):
            if k == 3:
                distance = np.linalg.norm(x - picker[:3], axis=1)
                hold = np.exp(-distance / 0.1)[:, None] * (distance.min() < picker[3])
            picker[:3] = np.clip(picker[:3] + move, 0, 1)
            x = x + move * hold if 3 <= k < 33 else x - [0, 0.005, 0]
            x = np.clip(x, 0, 1)
            record.append(
                state._replace(
                    x=x[None].astype(np.float32), primitive0=picker[None].copy(), cur_step=state.cur_step + 1
                )
            )
        return None, 0.0, False, {"state": record[-1], "state_list": stack(record)}
