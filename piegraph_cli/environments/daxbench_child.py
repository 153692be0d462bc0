"""The far end of the DaXBench bridge: the script that the interpreter with DaXBench's packages runs.

It knows DaXBench and speaks its frame and units; turning and scaling them is the near end's work. It is started by path,
needs Python 3.9 or newer and imports nothing of piegraph, which that interpreter lacks. docs/daxbench.md has the protocol.
"""

from __future__ import annotations

import base64
import importlib.metadata
import json
import math
import os
import queue
import sys
import threading
import traceback
from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple
from unittest.mock import MagicMock

PROTOCOL = 1
DTYPES = ("<f4", "<f8", "<i4", "<i8", "<u4")
STILL = 2e-4
"""DaXBench's units of length that no particle moves by in one sub-action of an object at rest."""
PACKAGES = ("jax", "jaxlib", "numpy", "scipy", "gym", "optax", "opencv-python-headless", "trimesh")
"""What DaXBench's two tasks import, by the names they are installed under."""
_DRAWING = ("pyrender", "daxbench.core.engine.pyrender.py_render", "daxbench.core.engine.usdrender.mesh_usd")
"""Modules that open a display or need packages of their own; nothing is drawn here, so stand-ins do."""


class Task(NamedTuple):
    """Where a task's parts are in DaXBench. Its records of a step have axes sub-action, batch, and then their own."""

    module: str
    environment: str
    state: str
    rest: Callable[[Any], Any]
    """Of the environment: the undeformed particles [P, 3], the same for every seed."""
    tool: Callable[[Any], Any]
    """Of the recorded states: where the pusher or picker is after each sub-action, [T, 3]."""
    approach: int
    """Sub-actions before the tool is at the stroke's start."""
    reach: float
    """A picker holds what is closer than this; 0 for a pusher."""


TASKS = {
    "rope": Task(
        "shape_rope_env",
        "ShapeRopeEnv",
        "MPMState",
        rest=lambda env: env.init_state.x[0],
        tool=lambda states: states.primitives[0].position[:, 0, 0],
        approach=0,
        reach=0.0,
    ),
    "tshirt": Task(
        "fold_cloth_tshirt_env",
        "FoldTshirtEnv",
        "ClothState",
        rest=lambda env: env.simulator.reset_jax().x[0],
        tool=lambda states: states.primitive0[:, 0, :3],
        approach=3,
        reach=0.01,
    ),
}


def pack(array: Any) -> dict[str, Any]:
    """A NumPy array as plain JSON: dtype, shape and its little-endian bytes in base64."""
    little = array.astype(array.dtype.newbyteorder("<"))
    data = base64.b64encode(little.tobytes()).decode()
    return {"dtype": little.dtype.str, "shape": list(array.shape), "data": data}


def unpack(packed: Any) -> Any:
    """The NumPy array of `pack`, bit for bit. Raises ValueError for anything else."""
    import numpy as np

    if not isinstance(packed, dict) or packed.keys() != {"dtype", "shape", "data"}:
        raise ValueError("no array where one is due")
    dtype, shape, data = packed["dtype"], packed["shape"], packed["data"]
    if dtype not in DTYPES or not isinstance(data, str):
        raise ValueError(f"an array of type {str(dtype)[:20]}")
    if not isinstance(shape, list) or len(shape) > 8 or not all(type(n) is int and n >= 0 for n in shape):
        raise ValueError(f"an array of shape {str(shape)[:40]}")
    raw = base64.b64decode(data, validate=True)
    if len(raw) != math.prod(shape) * np.dtype(dtype).itemsize:
        raise ValueError(f"{len(raw)} bytes for an array {dtype} {shape}")
    return np.frombuffer(raw, dtype).reshape(shape).copy()


def flatten(state: Any, name: str = "") -> dict[str, Any]:
    """The arrays of a state made of named tuples and lists, by their dotted path, as NumPy arrays."""
    import numpy as np

    if not isinstance(state, (tuple, list)):
        return {name: np.asarray(state)}
    fields = getattr(state, "_fields", range(len(state)))
    flat = {}
    for i, part in enumerate(state):
        flat.update(flatten(part, f"{name}.{fields[i]}" if name else str(fields[i])))
    return flat


def rebuild(like: Any, arrays: dict[str, Any], name: str = "") -> Any:
    """A state of the same form as `like` with the arrays of `flatten`."""
    if not isinstance(like, (tuple, list)):
        return arrays[name]
    fields = getattr(like, "_fields", range(len(like)))
    parts = [rebuild(p, arrays, f"{name}.{fields[i]}" if name else str(fields[i])) for i, p in enumerate(like)]
    return type(like)(*parts) if hasattr(like, "_fields") else type(like)(parts)


def problem(error: Exception) -> dict[str, Any]:
    """What keeps DaXBench from starting, with the versions that are found of what the bridge was tested with."""
    traceback.print_exc()
    found: dict[str, str | None] = {"python": ".".join(map(str, sys.version_info[:3]))}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = None
    return {"problem": f"{type(error).__name__}: {error}", "found": found}


class Simulation:
    """One DaXBench environment and its state; points [x, y, z] in DaXBench's frame (y up) and units.

    Made, it has imported what it needs; DaXBench's environment, which takes a minute for the rope, comes with a reset.
    """

    def __init__(self, task: str, repo: str):
        self.task = TASKS[task]
        sys.path[0] = repo  # in place of this script's folder, whose modules are none of DaXBench's business
        envs = ModuleType("daxbench.core.envs")
        envs.__path__ = [os.path.join(repo, "daxbench", "core", "envs")]
        sys.modules[envs.__name__] = envs  # its own __init__ imports every task and all that they need
        sys.modules.update({name: MagicMock() for name in _DRAWING})
        module = importlib.import_module(f"{envs.__name__}.{self.task.module}")
        self.defaults = getattr(getattr(module, self.task.state), "_field_defaults", {})
        self.make = getattr(module, self.task.environment)
        self.env: Any = None
        self.state: Any = None

    def reset(self, seed: int) -> dict[str, Any]:
        """Start from a seed, at rest; or what keeps DaXBench from being there, see `problem`."""
        import numpy as np

        if self.env is None:
            try:
                self.env = self.make(batch_size=1, seed=0)
            except (ImportError, AttributeError, TypeError) as error:  # it is not what the bridge knows
                return problem(error)
        for default in self.defaults.values():
            if isinstance(default, list):
                default.clear()  # a list that all states share and every reset would make longer
        self.env.seed(seed)
        _, state = self.env.reset(self.env.simulator.key_global)
        self.state = rebuild(state, flatten(state))
        self._settle()
        return {"rest": pack(np.asarray(self.task.rest(self.env))), "particles": pack(self.state.x[0])}

    def step(self, start: list[float], end: list[float], frames: int) -> dict[str, Any]:
        """One stroke: particles and tool at `frames` even intervals of the tool's way; the last ones are at rest."""
        import numpy as np

        before, skip = self.state.x[0], self.task.approach
        states = self._act(start, end)
        tool, shapes = np.asarray(self.task.tool(states)), np.asarray(states.x)[:, 0]
        begin = tool[skip - 1] if skip else np.array([start[0], tool[0, 1], start[2]], tool.dtype)
        grasped = bool((np.linalg.norm(before - begin, axis=1) < self.task.reach).any())
        if np.abs(shapes[-1] - shapes[-2]).max() > STILL:
            self._settle()
        shapes = np.concatenate([before[None], shapes[skip:-1], self.state.x])
        tool = np.concatenate([begin[None], tool[skip:]])
        chosen = np.linspace(0, len(tool) - 1, frames + 1).round().astype(int)
        return {"frames": pack(shapes[chosen]), "tool": pack(tool[chosen]), "grasped": grasped}

    def get_state(self) -> dict[str, Any]:
        """Everything that a step depends on."""
        return {"state": {name: pack(array) for name, array in flatten(self.state).items()}}

    def set_state(self, state: dict[str, Any]) -> dict[str, Any]:
        """Return to a state of `get_state`."""
        self.state = rebuild(self.state, {name: unpack(packed) for name, packed in state.items()})
        return {"particles": pack(self.state.x[0])}

    def _settle(self) -> None:
        """A DaXBench step far from the object: after some strokes it is still sliding or falling."""
        centre = self.state.x[0].mean(0)
        away = [float(centre[0] < 0.5), 0.0, float(centre[2] < 0.5)]
        self._act(away, away)

    def _act(self, start: list[float], end: list[float]) -> Any:
        """One DaXBench step; returns the states that it recorded after each sub-action."""
        import numpy as np

        # DaXBench counts steps, and puts the rope back to its start after six of them
        now = self.state._replace(cur_step=np.zeros_like(self.state.cur_step))
        info = self.env.step_diff(np.array([[*start, *end]], np.float32), now)[3]
        self.state = rebuild(info["state"], flatten(info["state"]))
        if not np.isfinite(np.asarray(info["state_list"].x)).all():
            # DaXBench turns NaN into 0 and goes on
            self.state = self.state._replace(x=np.full_like(self.state.x, np.nan))
        return info["state_list"]


def _listen(requests: queue.Queue) -> None:
    """Queue what is asked; when nobody can ask any more, end the process even in the middle of a step."""
    for line in sys.stdin.buffer:
        requests.put(json.loads(line))
    os._exit(0)


def main(task: str, repo: str) -> None:
    """Answer requests, one JSON line each, until the input ends."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print must not get between the replies
    requests: queue.Queue = queue.Queue()
    threading.Thread(target=_listen, args=(requests,), daemon=True).start()
    reply: dict[str, Any] = {"id": 0, "protocol": PROTOCOL, "task": task}
    try:
        simulation = Simulation(task, repo)
    except Exception as error:
        reply |= problem(error)
    while True:
        replies.write(json.dumps(reply) + "\n")
        replies.flush()
        request = requests.get()
        number, do = request.pop("id"), request.pop("do")
        reply = {"id": number, **getattr(simulation, do)(**request)}


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except Exception:
        traceback.print_exc()
        os._exit(1)  # at once: an orderly exit would wait for the thread that reads
