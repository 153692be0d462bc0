"""What the two fake tasks share: states as DaXBench's, and the ways to go wrong that the tests ask for.

The fake has DaXBench's interface as the bridge uses it, and none of its code or physics.
"""

import os
import subprocess
import sys
import time
from typing import NamedTuple

import numpy as np


class PrimitiveState(NamedTuple):
    size: np.ndarray
    position: np.ndarray


class MPMState(NamedTuple):
    x: np.ndarray
    v: np.ndarray
    key: np.ndarray
    cur_step: np.ndarray
    primitives: list = []  # noqa: RUF012 - DaXBench's default is shared by all its states, too


class ClothState(NamedTuple):
    x: np.ndarray
    primitive0: np.ndarray
    key: np.ndarray
    cur_step: np.ndarray


class Simulator:
    key_global = np.zeros(2, np.uint32)


def stack(states):
    """Named tuples and lists of arrays, one per sub-action, as one whose arrays have sub-actions first."""
    first = states[0]
    if not isinstance(first, (tuple, list)):
        return np.stack(states)
    parts = [stack([state[i] for state in states]) for i in range(len(first))]
    return type(first)(*parts) if hasattr(first, "_fields") else parts


def misbehave():
    """Crash, hang or print as FAKE_DAXBENCH says; called in every step."""
    print("what a library prints must not reach the bridge")
    mode = os.environ.get("FAKE_DAXBENCH")
    if mode == "crash":
        print("\x1b[31msomething \x07broke", file=sys.stderr)
        os._exit(3)
    if mode == "raise":
        raise FloatingPointError("the solver gave up")
    if mode == "hang":
        other = subprocess.Popen(["sleep", "600"])
        with open(os.environ["FAKE_DAXBENCH_PIDS"], "w") as file:
            file.write(f"{os.getpid()} {other.pid}\n")
        time.sleep(600)
