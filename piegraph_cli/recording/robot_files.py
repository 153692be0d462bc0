"""The robot's base from files: poses of the gripper beside images of the board it holds, and points that its tip touched."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording import layout
from piegraph_cli.recording.boards import Board
from piegraph_cli.recording.calibration import FEWEST_CORNERS, Sightings, board_pose
from piegraph_cli.recording.camera import Camera
from piegraph_cli.recording.locate import find_board, write_cameras
from piegraph_cli.recording.motion_csv import read_rows
from piegraph_cli.recording.numbers import number_of
from piegraph_cli.recording.robot import POOR, REACH, Base, hand_eye, touched
from piegraph_cli.recording.shots import Shots, read_shots
from piegraph_cli.recording.text import parse_number

POSE_COLUMNS = "columns image,x,y,z,qx,qy,qz,qw (metres), or rx,ry,rz (a rotation vector, radians) for the last four"
POINT_COLUMNS = "columns x,y,z of the tip (metres), and world_x,world_y,world_z, or corner, or camera,column,row"
UNIT = 0.01
"""How far a quaternion's length may be from 1."""
ALL = 1 << 30
HANGS = 0.5
"""How far down the base's z points, as a share, from which that is said."""
APART = 2.0
"""Mean pixels that corners may be off in cameras that see the board together."""


@dataclass(frozen=True)
class RobotBase:
    """Where the robot's base was found to be."""

    T_world_robot: np.ndarray
    methods: dict[str, Base]
    """Of hand-eye calibration, by name; none of touched points."""
    off: dict[str, float]
    """How far (m) each pose or point is off, by its name."""
    notes: list[str]


def read_robot(path: Path) -> np.ndarray:
    """`T_world_robot` [4, 4] of a cameras.json. Raises `DataError` where it has none, or that is no rigid transform."""
    T = layout.read_cameras_file(path).T_world_robot
    if T is None:
        hint = "run `piegraph calibrate` with --touched or --robot (docs/own-recording.md)"
        raise DataError("T_world_robot is missing: where the robot stands is not known", str(path), hint)
    return np.array(T)


def from_poses(recording: Path, sequences: Sequence[str], board: Board, file: Path) -> RobotBase:
    """The base from a table of gripper poses and the images that show the board on the gripper; kept in cameras.json.

    Cameras must be calibrated. Raises `DataError` naming the line of the table, or what is wrong with all of it.
    """
    names, gripper = read_poses(file)
    shots = read_shots(recording, sequences, most=ALL, posed=True)
    rows = [_row(shots, name, f"{file}, line {k}") for k, name in enumerate(names, 2)]
    shots = shots.only(rows)
    board, seen = find_board(shots, board, all_cameras=False)
    placed = [place_board(seen, k, shots.cameras, board) for k in range(len(names))]
    notes = [
        f"image {name}: no camera sees enough of the board, left out"
        if found is None
        else f"image {name}: cameras see the board {found[1]:.1f} px apart: was the robot at rest?"
        for name, found in zip(names, placed, strict=True)
        if found is None or found[1] > APART
    ]
    kept = [k for k, found in enumerate(placed) if found is not None]
    try:
        methods = hand_eye(
            gripper[kept], np.array([found[0] for found in placed if found is not None]).reshape(-1, 4, 4)
        )
    except DataError as error:
        raise DataError(error.message, str(file), error.hint) from None
    base = methods["refined"]
    off = {names[k]: float(np.linalg.norm(_off(base, gripper[k], placed[k][0]))) for k in kept}  # type: ignore[index]
    if base.residual.metres > POOR[0] or base.residual.degrees > POOR[1]:
        worst = max(off, key=lambda name: off[name])
        notes.append(f"poor: worst is {worst}, {1000 * off[worst]:.0f} mm off; more poses, and the robot at rest")
    notes += _upside_down(base.T_world_robot)
    _keep(shots, base.T_world_robot, calibration=shots.sequences)
    return RobotBase(base.T_world_robot, methods, off, notes)


def from_points(recording: Path, board: Board, file: Path) -> RobotBase:
    """The base from a table of points that the robot's tip touched and where they are in the world; kept in cameras.json."""
    shots = read_shots(recording, (), most=1, posed=True)
    names, robot, world = read_points(file, board, shots.cameras)
    try:
        T, off = touched(robot, world, names)
    except DataError as error:
        raise DataError(error.message, str(file), error.hint) from None
    errors = dict(zip(names, off.tolist(), strict=True))
    notes = ["three points: nothing tells whether one is wrong; touch a fourth"] if len(names) == 3 else []
    notes += _upside_down(T)
    if np.sqrt((off**2).mean()) > POOR[0]:
        worst = max(errors, key=lambda name: errors[name])
        notes.append(f"poor: worst is {worst}, {1000 * errors[worst]:.0f} mm off; check the robot's tool centre point")
    _keep(shots, T)
    return RobotBase(T, {}, errors, notes)


def _upside_down(T_world_robot: np.ndarray) -> list[str]:
    """A word where the base's z points down: points of a plane fit so when their axes are exchanged or mirrored."""
    if T_world_robot[2, 2] > -HANGS:
        return []
    return [
        "the robot's z would point down, as of one that hangs from above: if yours stands, x and y are exchanged in the "
        "table, or one of x, y, z has the other sign"
    ]


def _keep(shots: Shots, T: np.ndarray, calibration: Sequence[Path] = ()) -> None:
    """T_world_robot in cameras.json; sequences that show the board on the gripper are left out of runs too."""
    path = layout.cameras_file(shots.sequences[0])
    before = layout.read_cameras_file(path).calibration_sequence or []
    names = [before] if isinstance(before, str) else list(before)
    names = list(dict.fromkeys([*names, *(folder.name for folder in calibration)]))
    write_cameras(path, [], calibration_sequence=names or None, T_world_robot=T.tolist())


def _off(base: Base, gripper: np.ndarray, board: np.ndarray) -> np.ndarray:
    return (base.T_world_robot @ gripper @ base.T_gripper_board - board)[:3, 3]


def place_board(
    seen: Sightings, instant: int, cameras: Sequence[Camera], board: Board
) -> tuple[np.ndarray, float] | None:
    """`T_world_board` [4, 4] at an instant from all cameras that see it, and the error (px); None where none does."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    points, starts, sights = board.corners(), [], []
    for c, camera in enumerate(cameras):
        known = np.isfinite(seen.pixels[c, instant]).all(-1)
        pose = board_pose(seen.pixels[c, instant], points, camera.K, camera.distortion)
        if known.sum() >= FEWEST_CORNERS and pose is not None:
            starts.append((pose[0], camera.T_world_camera @ pose[1]))
            sights.append((camera, known, seen.pixels[c, instant][known]))
    if not starts:
        return None
    start = min(starts, key=lambda found: found[0])[1]

    def moved(x: np.ndarray) -> np.ndarray:
        T = start.copy()
        T[:3, :3] = Rotation.from_rotvec(x[:3]).as_matrix() @ T[:3, :3]
        T[:3, 3] += x[3:]
        return T

    def off(x: np.ndarray) -> np.ndarray:
        T = moved(x)
        placed = points @ T[:3, :3].T + T[:3, 3]
        return np.concatenate([camera.project(placed[known])[0] - pixels for camera, known, pixels in sights])

    fit = least_squares(lambda x: off(x).ravel(), np.zeros(6), x_scale="jac")
    return moved(fit.x), float(np.linalg.norm(off(fit.x), axis=1).mean())


def _row(shots: Shots, name: str, where: str) -> int:
    """The instant of an image that a table names by its file or its number, in the first camera's folder."""
    files = [file for file in shots.files[0] if file.name == name or file.stem == name]
    if not files:
        try:
            number = number_of(Path(name))[-1]
        except DataError:
            number = None
        files = [file for file in shots.files[0] if number_of(file)[-1] == number]
    if len(files) != 1:
        known = f"{shots.files[0][0].stem} to {shots.files[0][-1].stem}"
        what = "several images are" if files else "no image is"
        raise DataError(f"{what} called {name!r}", where, f"images of {shots.cameras[0].name} are {known}")
    return shots.files[0].index(files[0])


def read_table(path: Path, columns: str) -> list[dict[str, str]]:
    """The lines of a .csv by the names in its first line. Raises `DataError` naming the line."""
    rows = [row for row in read_rows(path, columns) if "".join(row).strip()]
    if len(rows) < 2:
        raise DataError("has no line below the names of its columns", str(path), f"write {columns}")
    header = [name.strip() for name in rows[0]]
    for n, row in enumerate(rows[1:], 2):
        if len(row) != len(header):
            message = f"has {len(row)} columns, the first line has {len(header)}"
            raise DataError(message, f"{path}, line {n}", f"write {columns}")
    return [dict(zip(header, (cell.strip() for cell in row), strict=True)) for row in rows[1:]]


def _numbers(rows: Sequence[dict[str, str]], names: Sequence[str], path: Path, columns: str) -> np.ndarray:
    missing = [name for name in names if name not in rows[0]]
    if missing:
        raise DataError(f"has no column {missing[0]}", f"{path}, line 1", f"write {columns}")
    values = np.zeros((len(rows), len(names)))
    for n, row in enumerate(rows):
        for k, name in enumerate(names):
            try:
                values[n, k] = parse_number(row[name])
            except ValueError as error:
                raise DataError(f"column {name}: {error}", f"{path}, line {n + 2}", "write numbers") from None
    return values


def read_poses(path: Path) -> tuple[list[str], np.ndarray]:
    """Names of images and `T_robot_gripper` [N, 4, 4] of a table. Raises `DataError` naming line and column."""
    from scipy.spatial.transform import Rotation

    rows = read_table(path, POSE_COLUMNS)
    quaternions = "qx" in rows[0]
    turns = ("qx", "qy", "qz", "qw") if quaternions else ("rx", "ry", "rz")
    values = _numbers(rows, ("x", "y", "z", *turns), path, POSE_COLUMNS)
    if "image" not in rows[0]:
        raise DataError("has no column image", f"{path}, line 1", f"write {POSE_COLUMNS}")
    far = int(np.abs(values[:, :3]).max(1).argmax())
    if np.abs(values[far, :3]).max() > REACH:
        message = f"the gripper is {np.linalg.norm(values[far, :3]):.0f} m from the base: are these millimetres?"
        raise DataError(message, f"{path}, line {far + 2}", "give metres")
    length = np.linalg.norm(values[:, 3:], axis=1)
    odd = np.flatnonzero(np.abs(length - 1) > UNIT if quaternions else length > 2 * np.pi + UNIT)
    if len(odd):
        message = (
            f"the quaternion's length is {length[odd[0]]:.3g}, not 1"
            if quaternions
            else f"the rotation vector is {length[odd[0]]:.0f} long: are these degrees?"
        )
        raise DataError(message, f"{path}, line {odd[0] + 2}", f"write {POSE_COLUMNS}")
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    turn = Rotation.from_quat(values[:, 3:]) if quaternions else Rotation.from_rotvec(values[:, 3:])
    T[:, :3, :3], T[:, :3, 3] = turn.as_matrix(), values[:, :3]
    return [row["image"] for row in rows], T


def read_points(path: Path, board: Board, cameras: Sequence[Camera]) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, points of the robot and of the world [N, 3] (m) of a table. Raises `DataError` naming line and column.

    A corner is a ChArUco board's as it lies at the world's origin; a pixel is what a camera sees there of the table.
    """
    rows = read_table(path, POINT_COLUMNS)
    robot = _numbers(rows, ("x", "y", "z"), path, POINT_COLUMNS)
    if "corner" in rows[0]:
        if board.kind != "charuco":
            raise DataError("corners are those of a ChArUco board", str(path), "give world_x, world_y and world_z")
        corners, numbers = board.corners(), _numbers(rows, ("corner",), path, POINT_COLUMNS)[:, 0]
        for n, number in enumerate(numbers):
            if number != int(number) or not 0 <= number < len(corners):
                message = f"corner {rows[n]['corner']}: the board has corners 0 to {len(corners) - 1}"
                raise DataError(message, f"{path}, line {n + 2}", "inner corners count row by row from marker 0 on")
        return [f"corner {row['corner']}" for row in rows], robot, corners[numbers.astype(int)]
    if "camera" in rows[0]:
        pixels = _numbers(rows, ("column", "row"), path, POINT_COLUMNS)
        places = [f"{path}, line {n}" for n in range(2, len(rows) + 2)]
        seen = [_on_table(row, xy, cameras, at) for row, xy, at in zip(rows, pixels, places, strict=True)]
        return [f"line {n}" for n in range(2, len(rows) + 2)], robot, np.array(seen)
    world = _numbers(rows, ("world_x", "world_y", "world_z"), path, POINT_COLUMNS)
    return [f"line {n}" for n in range(2, len(rows) + 2)], robot, world


def _on_table(row: dict[str, str], pixel: np.ndarray, cameras: Sequence[Camera], where: str) -> np.ndarray:
    """Where a camera's pixel meets the table z = 0."""
    camera = next((camera for camera in cameras if camera.name == row["camera"]), None)
    if camera is None:
        names = ", ".join(camera.name for camera in cameras)
        raise DataError(f"no camera {row['camera']!r}", where, f"cameras are {names}")
    ray, start = camera.T_world_camera[:3, :3] @ camera.rays(pixel[None])[0], camera.T_world_camera[:3, 3]
    inside = ((pixel >= 0) & (pixel < [camera.width, camera.height])).all()
    if not inside or ray[2] * start[2] >= 0:
        raise DataError(
            f"camera {camera.name} sees no table at {pixel[0]:g}, {pixel[1]:g}", where, "give column,row in px"
        )
    return start - ray * start[2] / ray[2]
