"""Episodes of PGND's `sub_episodes_v`: material particles over time, and the poses of grippers.

`traj.npz` has `xyz` [T, P, 3] (m), `eef_traj.txt` [T, 3 n], `eef_gripper.txt` [T, n]; 30 frames a second. z points down
there: the world is turned about x. Velocities and rotations are not read.
"""

from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.points import read_arrays
from piegraph_cli.recording.text import read_table

PARTICLES, TIPS, GRIPPERS = "traj.npz", "eef_traj.txt", "eef_gripper.txt"
RATE = 30.0
"""Frames a second, which the episodes do not tell."""
TURN = np.array([1.0, -1.0, -1.0])


def is_episode(folder: Path) -> bool:
    """Whether a folder is one."""
    return all((folder / name).is_file() for name in (PARTICLES, TIPS))


def read_episode(folder: Path) -> tuple[dict[str, np.ndarray], list[str]]:
    """particles, end_effector, times, and opening where there are grippers, as `read_motion` takes them; and what to say.

    Of several end-effectors the one that travels farthest is taken. Raises `DataError` naming file and line.
    """
    found = read_arrays(folder / PARTICLES, ("xyz",))
    if "xyz" not in found:
        raise DataError("has no array xyz", str(folder / PARTICLES), "expected particles [T, P, 3]")
    particles, tips = found["xyz"], _table(folder / TIPS)
    if particles.ndim != 3 or particles.shape[2] != 3 or particles.dtype.kind not in "fiu":
        message = f"xyz is {particles.dtype} {list(particles.shape)}"
        raise DataError(message, str(folder / PARTICLES), "expected particles [T, P, 3]")
    if tips.shape[1] % 3 or len(tips) != len(particles):
        message = f"holds {len(tips)} lines of {tips.shape[1]} numbers beside {len(particles)} frames of particles"
        raise DataError(message, str(folder / TIPS), "expected three numbers for each end-effector in each frame")
    paths = tips.reshape(len(tips), -1, 3)
    travel = np.linalg.norm(np.diff(paths, axis=0), axis=2).sum(0)
    chosen = int(travel.argmax())
    arrays = {"particles": particles * TURN, "end_effector": paths[:, chosen] * TURN}
    arrays["times"] = np.arange(len(tips)) / RATE
    notes = [
        f"no time stamps: {RATE:g} frames a second are taken for granted",
        "z points down there: the world was turned about x",
    ]
    if len(travel) > 1:
        told = ", ".join(f"{length:.2f}" for length in travel)
        notes.append(
            f"{len(travel)} end-effectors, which travel {told} m: number {chosen} is taken, what others do is not known"
        )
    if (folder / GRIPPERS).is_file():
        openings = _table(folder / GRIPPERS)
        if openings.shape != paths.shape[:2]:
            message = f"holds {len(openings)} lines of {openings.shape[1]} numbers"
            raise DataError(message, str(folder / GRIPPERS), f"expected {len(tips)} lines of {len(travel)}, as {TIPS}")
        arrays["opening"] = openings[:, chosen]
    return arrays, notes


def _table(path: Path) -> np.ndarray:
    """Finite numbers [line, column] of a text file."""
    hint = "copy the episode again; it may be cut"
    rows = read_table(path, hint, commas=True)
    if not len(rows):
        raise DataError("is empty", str(path), hint)
    return rows
