"""Raw recordings of PGND: `camera_I/rgb/000000.jpg`, `camera_I/depth/000000.png` (mm), and a line of times per frame.

`timestamps.txt` has for each frame the N cameras' step numbers, relative times and absolute times; `calibration/`, in the
sequence or beside it, has `intrinsics.npy` [N, 3, 3], `rvecs.npy` [N, 3] and `tvecs.npy` [N, 3, 1], world to camera.
z points down there: the world is turned about x. A robot's poses are in `robot/TIME.txt`.
"""

from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera, check_intrinsics
from piegraph_cli.recording.end_effector import EndEffectorPath, checked
from piegraph_cli.recording.film import Film, ImageFiles
from piegraph_cli.recording.folders import entries_of
from piegraph_cli.recording.layout import image_size
from piegraph_cli.recording.numbers import by_number, frame_numbers, match_stamps, number_of
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.plain import load_numbers
from piegraph_cli.recording.text import read_rows, read_table
from piegraph_cli.recording.timing import check_times

TURN = np.diag([1.0, -1.0, -1.0, 1.0])


def read(folder: Path, params: ReadParams) -> tuple[list[Film], list[str]]:
    """The films of a sequence folder, one a camera, and what was taken for granted."""
    place = next((p for p in (folder / "calibration", folder.parent / "calibration") if p.is_dir()), None)
    if place is None:
        hint = "copy calibration/ with intrinsics.npy, rvecs.npy and tvecs.npy into it, or beside it"
        raise DataError("calibration/ is missing", str(folder), hint)
    intrinsics = load_numbers(place / "intrinsics.npy", (-1, 3, 3))
    count = len(intrinsics)
    turns = load_numbers(place / "rvecs.npy", (count, 3))
    shifts = load_numbers(place / "tvecs.npy", (count, 3, 1))
    for c, K in enumerate(intrinsics):
        check_intrinsics(K, f"the matrix of camera_{c}", str(place / "intrinsics.npy"))
    names, wanted = _camera_folders(folder), [f"camera_{c}" for c in range(count)]
    if names != wanted:
        odd = sorted(set(names) ^ set(wanted))[0]
        what = "has no calibration" if odd in names else "is calibrated, but has no folder"
        raise DataError(f"{odd} {what}", f"{folder}, {place}", "copy all cameras and the calibration of this recording")
    times = _read_times(folder / "timestamps.txt", count)
    films, notes = [], ["z points down there: the world was turned about x"]
    for c, name in enumerate(names):
        T = _inverse(turns[c], shifts[c, :, 0])
        film, gaps = _film(folder / name, intrinsics[c], T, times[:, c])
        films.append(film)
        notes += gaps
    if (folder / "robot").is_dir():
        notes.append("robot/ is taken to be in the cameras' world")
    return films, notes


def end_effector(folder: Path, params: ReadParams) -> EndEffectorPath | None:
    """The robot's path, where it was recorded: rows of a file are position, three rows of rotation, and the gripper."""
    if not (folder / "robot").is_dir():
        return None
    from scipy.spatial.transform import Rotation

    files = by_number([path for path in entries_of(folder / "robot") if path.suffix == ".txt"])
    poses = [_read_pose(path) for path in files.values()]
    if len(poses) < 2:
        raise DataError(f"holds {len(poses)} poses", str(folder / "robot"), "remove it where there was no robot")
    positions = np.array([pose[0] for pose in poses]) @ TURN[:3, :3].T
    turns = Rotation.from_matrix(TURN[:3, :3] @ np.array([pose[1] for pose in poses])).as_quat()
    opening = np.array([pose[2] for pose in poses])
    times = np.array([float(number[-1]) for number in files])
    return checked(EndEffectorPath(times, positions, turns, opening, str(folder / "robot"), "file", 0))


def _read_pose(path: Path) -> tuple[np.ndarray, np.ndarray, float]:
    hint = "expected rows: position, three rows of rotation, gripper; or write end_effector.csv (docs/formats.md)"
    rows = [row for _, row in read_rows(path, hint, commas=True)]
    if [len(row) for row in rows[:4]] != [3] * 4 or len(rows) != 5:
        raise DataError(f"holds {len(rows)} rows of {[len(row) for row in rows]} numbers", str(path), hint)
    turn = np.array(rows[1:4])
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-2) or np.linalg.det(turn) < 0:
        raise DataError("rows 2 to 4 are not a rotation", str(path), hint)
    return np.array(rows[0]), turn, rows[4][0]


def _camera_folders(folder: Path) -> list[str]:
    found = [path for path in entries_of(folder) if path.name.startswith("camera_") and (path / "rgb").is_dir()]
    return [path.name for path in sorted(found, key=number_of)]


def _read_times(path: Path, cameras: int) -> np.ndarray:
    """Absolute times [frame, camera] (s)."""
    hint = f"a line a frame: {cameras} step numbers, {cameras} relative and {cameras} absolute times"
    return read_table(path, hint, 3 * cameras)[:, 2 * cameras :]


def _film(folder: Path, K: np.ndarray, T_world_camera: np.ndarray, times: np.ndarray) -> tuple[Film, list[str]]:
    color, depth = (_images(folder / kind) for kind in ("rgb", "depth"))
    odd = sorted(color.keys() ^ depth.keys())
    if odd or not color:
        first = f"; first unpaired frame {(color.get(odd[0]) or depth[odd[0]]).stem}" if odd else ""
        message = f"{len(color)} colour and {len(depth)} depth images{first}"
        raise DataError(message, str(folder), "each frame needs rgb/NNNNNN.jpg and depth/NNNNNN.png")
    files = [(path, depth[number]) for number, path in color.items()]
    width, height = image_size(files[0][0], folder.name)
    camera = Camera(folder.name, width, height, K, np.zeros(5), T_world_camera)
    lines, gaps = match_stamps(list(color.values()), len(times), str(folder))
    stamps = times[lines]
    gaps += check_times(stamps, f"{folder.parent / 'timestamps.txt'}, {folder.name}")
    return Film(camera, stamps, ImageFiles(camera, files), frame_numbers(list(color.values()))), gaps


def _images(folder: Path) -> dict:
    if not folder.is_dir():
        raise DataError("folder is missing", str(folder), "each camera needs rgb/ and depth/")
    return by_number([p for p in entries_of(folder) if p.is_file() and p.suffix.lower() in (".jpg", ".jpeg", ".png")])


def _inverse(turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """`T_world_camera`, z up, of a world-to-camera rotation vector [3] and translation [3]."""
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
    return TURN @ np.linalg.inv(T)
