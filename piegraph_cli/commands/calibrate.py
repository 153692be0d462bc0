"""The command `calibrate`: cameras by a board or by the table, and the robot's base, into cameras.json."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from piegraph_cli.commands.options import AsJson
from piegraph_cli.commands.output import Report, emit
from piegraph_cli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from piegraph_cli.recording.axes import Shown
    from piegraph_cli.recording.boards import Board
    from piegraph_cli.recording.robot_files import RobotBase

BOARD, INSTEAD = "The board", "In place of locating cameras by a board"


def _option(help: str, panel: str | None = None, name: str = "") -> Any:
    names = [name] if name else []
    return typer.Option(*names, help=help, rich_help_panel=panel, show_default=not name)


Recording = Annotated[
    Path, typer.Argument(metavar="RECORDING", help="recording folder whose cameras.json has K and distortion")
]
Names = Annotated[str | None, _option("sequences that show the board: NAME,NAME [default: the first]")]
Intrinsics = Annotated[bool, _option("find K and distortion too; those given are a start", name="--intrinsics")]
Kind = Annotated[Literal["charuco", "grid"], _option("kind of board; grid: of AprilTags", BOARD)]
Columns = Annotated[int, _option("squares (tags) across the board", BOARD)]
Rows = Annotated[int, _option("squares (tags) down the board", BOARD)]
Square = Annotated[float, _option("edge of a square; of a grid from tag to tag [m]", BOARD)]
Marker = Annotated[float, _option("edge of a marker [m]", BOARD)]
Dictionary = Annotated[
    str | None, _option("OpenCV's name of the markers [default: DICT_5X5_100, of a grid DICT_APRILTAG_36h11]", BOARD)
]
Table = Annotated[
    bool, _option("move all cameras as one so that the table in depth is z = 0; no board", INSTEAD, "--table")
]
Poses = Annotated[
    Path | None, _option("find the robot's base by poses of its gripper, which holds the board in --sequence", INSTEAD)
]
Points = Annotated[Path | None, _option("find the robot's base by points that its tip touched", INSTEAD)]


def calibrate(
    recording: Recording,
    sequence: Names = None,
    intrinsics: Intrinsics = False,
    board: Kind = "charuco",
    columns: Columns = 7,
    rows: Rows = 5,
    square: Square = 0.04,
    marker: Marker = 0.03,
    dictionary: Dictionary = None,
    table: Table = False,
    robot: Poses = None,
    touched: Points = None,
    as_json: AsJson = False,
) -> None:
    """Locate the cameras by a board, or by the table; find the robot's base.

    The board lies on the table in the first image that shows it; its middle there is the origin of the world, z up. It may
    lie elsewhere, or be held, in others. Fills cameras.json, and notes there which sequences show the board: runs leave
    them out. calibration.png beside it shows the axes in each camera, calibration.json keeps the errors.
    """
    from piegraph_cli.recording.boards import Board

    if sum((table, robot is not None, touched is not None)) > 1:
        raise UsageError("--table, --robot and --touched are three calibrations", "piegraph calibrate", "one at a time")
    if intrinsics and (table or robot or touched):
        raise UsageError("--intrinsics needs a board that locates cameras", "piegraph calibrate", "give it alone")
    names = [name.strip() for name in sequence.split(",") if name.strip()] if sequence else []
    default = "DICT_5X5_100" if board == "charuco" else "DICT_APRILTAG_36h11"
    printed = Board(columns, rows, square, marker, dictionary or default, kind=board)
    printed.make()
    if table:
        report = _by_table(recording, names)
    elif robot or touched:
        report = _robot(recording, names, printed, robot, touched)
    else:
        report = _by_board(recording, names, printed, intrinsics)
    emit(report, as_json)


def _by_board(recording: Path, names: "Sequence[str]", board: "Board", intrinsics: bool) -> Report:
    from piegraph_cli.recording.locate import calibrate as locate

    found = locate(recording, names, board, intrinsics)
    lines = [
        f"{one.camera.name:12s} {one.error:5.2f} px{''.join(f'  {text}' for text in one.warnings)}"
        for one in found.cameras
    ]
    if intrinsics:
        for one in found.cameras:
            K = one.camera.K
            lines.append(
                f"{one.camera.name:12s} focal {K[0, 0]:.1f}, {K[1, 1]:.1f}, centre {K[0, 2]:.1f}, {K[1, 2]:.1f} px"
            )
    lines += found.notes
    lines += ["the board has the layout from before OpenCV 4.6"] if found.board.legacy else []
    if found.places > 1:
        lines += [f"the board lay in {found.places} places, which were fitted together"]
    lines += [f"the world's origin is the middle of the board as it lies in image {found.origin}"]
    several = len(found.sequences) > 1
    shown = f"sequences {', '.join(found.sequences)} show" if several else f"sequence {found.sequences[0]} shows"
    lines += [f"{shown} the board: runs leave {'them' if several else 'it'} out"]
    cameras = {
        one.camera.name: {"error_px": one.error, "frames_px": one.frames, "warnings": one.warnings}
        for one in found.cameras
    }
    value = {
        "cameras": cameras,
        "sequence": found.sequences if several else found.sequences[0],
        "legacy_board": found.board.legacy,
        "places": found.places,
        "origin": found.origin,
        "notes": found.notes,
    }
    warnings = [f"{one.camera.name}: {text}" for one in found.cameras for text in one.warnings] + found.notes
    return _with_picture(found.file, [one.shown for one in found.cameras], value, lines, warnings)


def _by_table(recording: Path, names: "Sequence[str]") -> Report:
    from piegraph_cli.recording.table import level_by_table

    found = level_by_table(recording, names)
    if found.posed:
        lines = [
            f"the table lay {1000 * found.height:+.1f} mm from z = 0 and was tilted by {found.tilt:.2f} deg: it is z = 0 now"
        ]
        lines += [
            f"{name:12s} {1000 * m:.1f} mm, {deg:.2f} deg from the table of all" for name, (m, deg) in found.off.items()
        ]
    else:
        lines = ["the world begins on the table in the middle of the view: x right, y away from the camera, z up"]
    value = {
        "height_mm": 1000 * found.height,
        "tilt_deg": found.tilt,
        "cameras": {name: {"off_mm": 1000 * m, "off_deg": deg} for name, (m, deg) in found.off.items()},
        "notes": found.notes,
    }
    return _with_picture(found.file, found.shown, value, lines + found.notes, found.notes)


def _robot(recording: Path, names: "Sequence[str]", board: "Board", robot: Path | None, touched: Path | None) -> Report:
    from piegraph_cli.recording.robot_files import from_points, from_poses

    found: RobotBase
    found = from_poses(recording, names, board, robot) if robot else from_points(recording, board, touched)  # type: ignore[arg-type]
    lines = [
        f"{name:12s} {1000 * base.residual.metres:6.2f} mm  {base.residual.degrees:6.3f} deg"
        for name, base in found.methods.items()
    ]
    if not found.methods:
        lines = [f"{name:12s} {1000 * off:6.2f} mm" for name, off in found.off.items()]
    x, y, z = found.T_world_robot[:3, 3]
    lines += [
        *found.notes,
        f"the robot's base is at ({x:+.4f}, {y:+.4f}, {z:+.4f}) m: T_world_robot is in cameras.json",
    ]
    value: dict[str, Any] = {"T_world_robot": found.T_world_robot.tolist(), "notes": found.notes}
    value["off_mm"] = {name: 1000 * off for name, off in found.off.items()}
    value["methods"] = {
        name: {"residual_mm": 1000 * base.residual.metres, "residual_deg": base.residual.degrees}
        for name, base in found.methods.items()
    }
    return Report(value, lines, warnings=found.notes)


def _with_picture(
    file: Path, shown: "Sequence[Shown]", value: dict[str, Any], lines: list[str], warnings: list[str]
) -> Report:
    """The report, with the picture and the errors written beside cameras.json."""
    import json

    import cv2

    from piegraph_cli.files import atomic_file
    from piegraph_cli.recording.axes import draw_axes, origin_in_view

    blind = [one.camera.name for one in shown if not origin_in_view(one.camera)]
    hidden = [f"the world's origin is outside the view of {', '.join(blind)}"] if blind else []
    picture, numbers = file.with_name("calibration.png"), file.with_name("calibration.json")
    drawn = cv2.imencode(".png", cv2.cvtColor(draw_axes(shown), cv2.COLOR_RGB2BGR))[1]
    for path, data in ((picture, drawn.tobytes()), (numbers, (json.dumps(value, indent=1) + "\n").encode())):
        with atomic_file(path) as temporary:
            temporary.write_bytes(data)
    value = value | {"picture": str(picture), "numbers": str(numbers)}
    lines = [*lines, *hidden, f"axes and corners: {picture}; errors: {numbers}"]
    return Report(value, lines, warnings=warnings + hidden)
