"""What is attacked: artifacts of every kind, files that others write, recordings in every layout; and `texts`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from piegraph_cli.recording.params import ReadParams
from piegraph_cli.workspace.artifact import CHECKED_FROM, read_artifact
from piegraph_cli.workspace.schema import SCHEMAS, field_of
from tests.attack.engine import Attack
from tests.attack.hostile import HOSTILE, make_hostile
from tests.attack.mutators import bytes_of, mutate_array, mutate_file_of, text_of
from tests.attack.samples import write_sample
from tests.attack.texts import texts
from tests.hdf5 import edited, reseal, unsealed


def _arrays(path: Path) -> dict[str, np.ndarray]:
    return read_artifact(path).arrays


def _make_artifact(kind: str, folder: Path) -> Path:
    return write_sample(folder / f"{kind}.h5", kind)


def _make_unsealed(kind: str, folder: Path) -> Path:
    path = _make_artifact(kind, folder)
    unsealed(path, CHECKED_FROM - 1)
    return path


def _of_values(kind: str, path: Path, rng: np.random.Generator) -> str:
    """A value that the schema forbids, under a checksum that fits."""
    found = []
    for name in _names(path):
        field = field_of(kind, name)
        assert field is not None
        with h5py.File(path) as file:
            dtype, size = file[name].dtype, file[name].size
        bounds = (0, 1000) if field.index else field.bounds
        odd = [
            v
            for v in (np.nan, np.inf, -np.inf)
            if dtype.kind == "f" and not (field.nan and (np.isnan(v) or not bounds))
        ]
        odd += [v for v in (1e30, -1e30, -2, 250, 2e9) if bounds and not bounds[0] <= v <= bounds[1]]
        odd = [v for v in odd if dtype.kind == "f" or (np.isfinite(v) and v == dtype.type(np.clip(v, -9e18, 9e18)))]
        if not (bounds and bounds[0] == -np.inf) and size:
            found += [(name, v) for v in odd if not (field.nan and np.isnan(v))]
    name, value = found[int(rng.integers(len(found)))]
    with edited(path) as file:
        values = file[name][()]
        values = np.array(values)
        values.flat[int(rng.integers(values.size))] = value
        file[name][...] = values
    return f"{name} holds {value}"


def _of_structure(kind: str, path: Path, rng: np.random.Generator) -> str:
    """Something hostile, or a dataset that is gone, there twice, or another, under a checksum that fits."""
    name = _names(path)[int(rng.integers(len(_names(path))))]
    how = [*HOSTILE, "gone", "another", "another", "another", "another"][int(rng.integers(len(HOSTILE) + 5))]
    if how in HOSTILE:
        make_hostile(path, how, name)
    else:
        with h5py.File(path, "a") as file:
            value = file[name][()]
            del file[name]
            if how == "another":
                new, how = mutate_array(value, rng)
                file[name] = new
    reseal(path)
    return f"{name}: {how}"


def _names(path: Path) -> list[str]:
    found: list[str] = []
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None)
    return found


def artifacts() -> list[Attack]:
    """Of every kind: damaged bytes, values and structures under a fitting checksum, and old ones without one."""
    found = []
    for kind in SCHEMAS:
        make = partial(_make_artifact, kind)
        found.append(Attack(f"artifact {kind}", make, bytes_of, _arrays, refused=True))
        found.append(Attack(f"structure of {kind}", make, partial(_of_structure, kind), _arrays))
        found.append(Attack(f"old {kind}", partial(_make_unsealed, kind), bytes_of, _arrays))
        if kind != "checkpoint":
            found.append(Attack(f"values of {kind}", make, partial(_of_values, kind), _arrays, refused=True))
    return found


def motion(frames: int = 12) -> dict[str, np.ndarray]:
    """Particles over time, as others write them."""
    rng = np.random.default_rng(0)
    rest = rng.uniform(0, 0.1, (6, 3))
    moved = np.arange(frames)[:, None] * [0.004, 0.0, 0.0]
    return {"particles": rest + moved[:, None], "end_effector": moved + rest[0], "times": np.arange(frames) / 10}


def _make_motion(suffix: str, folder: Path) -> Path:
    path, arrays = folder / f"take{suffix}", motion()
    if suffix == ".npz":
        np.savez(path, **arrays)  # type: ignore[arg-type]
    elif suffix == ".h5":
        with h5py.File(path, "w") as file:
            for name, value in arrays.items():
                file.create_dataset(name, data=value, compression="gzip" if name == "particles" else None)
    else:
        count = arrays["particles"].shape[1]
        header = ["time", "ee_x", "ee_y", "ee_z", *(f"p{k}_{a}" for k in range(count) for a in "xyz")]
        rows = np.column_stack(
            [arrays["times"], arrays["end_effector"], arrays["particles"].reshape(len(arrays["times"]), -1)]
        )
        path.write_text("\n".join([",".join(header), *(",".join(f"{v:.6g}" for v in row) for row in rows)]) + "\n")
    return path


def _read_motion(path: Path) -> Any:
    from piegraph_cli.recording.motion import read_motion
    from piegraph_cli.stages.import_tracks import READERS

    found = read_motion(path, 0.03, "push", READERS)
    return [getattr(found, name) for name in ("positions", "end_effector", "time", "contact", "mode", "visibility")]


def _make_episode(folder: Path) -> Path:
    arrays, place = motion(), folder / "episode_0000"
    place.mkdir()
    np.savez(place / "traj.npz", xyz=arrays["particles"] * [1, -1, -1])
    np.savetxt(place / "eef_traj.txt", arrays["end_effector"] * [1, -1, -1])
    np.savetxt(place / "eef_gripper.txt", np.full((len(arrays["times"]), 1), 0.05))
    return place


def _make_points(suffix: str, folder: Path) -> Path:
    from piegraph_cli.recording.points import write_points

    path, points = folder / f"cloud{suffix.lstrip('_')}", np.random.default_rng(0).uniform(0, 0.1, (40, 3))
    if suffix == "_.ply":
        rows = "\n".join(" ".join(f"{v:.5f}" for v in row) for row in points)
        head = "ply\nformat ascii 1.0\nelement vertex 40\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        path.write_text(f"{head}{rows}\n")
    elif suffix == ".npz":
        np.savez(path, points=points, offsets=np.array([0, 10, 40]), time=np.arange(2.0))
    elif suffix == ".h5":
        write_sample(path, "clouds")
    else:
        write_points(path, points)
    return path


def _read_points(path: Path) -> Any:
    from piegraph_cli.stages.points import read_points

    return read_points(path, None)


def files_of_others() -> list[Attack]:
    """Point files, motion of others, and a model given as a file."""
    found = [
        Attack(f"points {s}", partial(_make_points, s), bytes_of, _read_points)
        for s in (".ply", "_.ply", ".npz", ".h5")
    ]
    found.append(Attack("points text", partial(_make_points, "_.ply"), text_of, _read_points))
    for suffix in (".npz", ".h5", ".csv"):
        found.append(Attack(f"import {suffix}", partial(_make_motion, suffix), bytes_of, _read_motion))
    found.append(Attack("import text", partial(_make_motion, ".csv"), text_of, _read_motion))
    found.append(Attack("import hostile", partial(_make_motion, ".h5"), _hostile_import, _read_motion))
    found.append(Attack("import episode", _make_episode, mutate_file_of, _read_motion))
    return found


def _hostile_import(path: Path, rng: np.random.Generator) -> str:
    how, name = list(HOSTILE)[int(rng.integers(len(HOSTILE)))], list(motion())[int(rng.integers(3))]
    make_hostile(path, how, name)
    return f"{name}: {how}"


def _make_recording(layout: str, folder: Path) -> Path:
    from tests.recording import test_readers as of_others
    from tests.stages.make_recording import make_recording

    if layout == "piegraph":
        return make_recording(folder / "rec", 1) / "seq 0"
    return getattr(of_others, f"write_{layout}")(folder)


def _change_recording(path: Path, rng: np.random.Generator) -> str:
    return mutate_file_of(path.parent if rng.random() < 0.4 else path, rng)


def _read_recording(path: Path) -> Any:
    from piegraph_cli.recording.sequence import read_sequence

    arrays, warnings = read_sequence(path, ReadParams())
    return [arrays, len(warnings)]


def _make_bag(suffix: str, folder: Path) -> Path:
    from tests.recording import test_bags as bags

    types = bags.ONE if suffix == ".bag" else bags.TWO
    return bags.write_bag(
        folder / "rec" / f"take{suffix}", bags.camera_messages(types, bags.LEFT, bags.pictures(0, 4), "/left")
    )


def _change_bag(path: Path, rng: np.random.Generator) -> str:
    return bytes_of(path, rng) if path.is_file() else mutate_file_of(path, rng)


def recordings() -> list[Attack]:
    """Sequences in every layout, and bags."""
    layouts = ("piegraph", "tum", "gbnd", "phystwin", "pgnd")
    found = [Attack(f"recording {n}", partial(_make_recording, n), _change_recording, _read_recording) for n in layouts]
    return found + [
        Attack(f"bag {s}", partial(_make_bag, s), _change_bag, _read_recording) for s in (".bag", ".db3", ".mcap")
    ]


GROUPS: dict[str, Callable[[], list[Attack]]] = {
    "artifacts": artifacts,
    "files": files_of_others,
    "recordings": recordings,
    "texts": texts,
}
