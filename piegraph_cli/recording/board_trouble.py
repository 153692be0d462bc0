"""Why a board is not found in images, or is another one than was said: each guess is tried on the images."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from piegraph_cli.errors import DataError
from piegraph_cli.recording.boards import Board, find_markers
from piegraph_cli.recording.checks import SHARP, sharpness_of

ENOUGH = 4
"""Markers in one image that are no chance."""
LARGEST = 24
"""Squares across that are tried."""
ASKED = 3
"""Every so many of the images is searched for markers of all kinds."""
FAMILIES = {
    **{f"DICT_{n}X{n}_": ("50", "100", "250", "1000") for n in (4, 5, 6, 7)},
    "DICT_APRILTAG_": ("36h11",),
    **{f"DICT_APRILTAG_{name}": ("",) for name in ("16h5", "25h9", "36h10")},
    "DICT_ARUCO_": ("ORIGINAL",),
    "DICT_ARUCO_MIP_": ("36h12",),
}
"""OpenCV's dictionaries: those of one family begin alike, and the largest holds the smaller ones."""
QUADS, BIT = 60, 8
"""Things in an image that are looked at as markers, the largest, and pixels across that each of their bits gets."""
WRONG_BITS = 0.3
"""Of the bits by which markers of a dictionary differ, how many may be read wrong."""
FITS = 0.15
"""Edges of a marker by which markers may lie beside where a board has them."""

MARKER_OFF = 0.8, 1.1
"""Shares of the size that was said within which markers are seen: blur makes small ones smaller."""


def why_not_found(images: Sequence[np.ndarray], board: Board) -> str:
    """What to try, for RGB images of one camera in which too little of a board was found."""
    found = max((_markers(image, board) for image in images), key=len, default={})
    if len(found) >= ENOUGH:
        return _other_size(found, board)
    for image in images:
        if len(_markers(np.ascontiguousarray(image[:, ::-1]), board)) >= ENOUGH:
            return "the images are mirrored: record them as the camera sees, or flip them"
    other = _other_dictionary(images, board)
    if other:
        return f"the markers are of {other}: --dictionary {other}"
    sharp = [value for image in images if (value := sharpness_of(image)) is not None]
    if sharp and max(sharp) < SHARP:
        return "the images are blurred: hold the board and the camera still, more light, focus"
    if found:
        return "hardly a marker is found: move the board closer, light it evenly, show all of it"
    return "no marker is seen: show the board to this camera; check --dictionary, move it closer, light it evenly"


def _markers(image: np.ndarray, board: Board) -> dict[int, np.ndarray]:
    """Markers in an image; tags of a grid with either border."""
    borders = (1, 2) if board.kind == "grid" else (1,)
    return max((find_markers(image, replace(board, border=border)) for border in borders), key=len)


def more_markers(image: np.ndarray, board: Board) -> str:
    """A word on markers in an RGB image that the board does not have, or none."""
    beyond = [number for number in find_markers(image, board) if number >= board.markers]
    if not beyond:
        return ""
    return (
        f"marker {max(beyond)} is seen, and {board.columns} x {board.rows} has {board.markers}, from 0 on: "
        "if it is on the board, --columns or --rows is wrong, and so is the origin"
    )


def check_marker(image: np.ndarray, board: Board, camera: str) -> None:
    """Raise `DataError` where a ChArUco board's markers in an RGB image are larger or smaller than was said.

    Corners would be looked for beside where they are, and still be found. Middles of markers do not depend on their size.
    """
    import cv2

    found = find_markers(image, board) if board.kind == "charuco" else {}
    at = _middles(board) if found else {}
    known = [n for n in found if n in at]
    if len(known) < 2 * ENOUGH:  # few lie in a row, where nothing tells how large they are
        return
    H, _ = cv2.findHomography(np.array([found[n].mean(0) for n in known]), np.array([at[n] for n in known]))
    if H is None:
        return
    placed = cv2.perspectiveTransform(np.array([found[n] for n in known], float), H)
    edge = float(np.median(np.linalg.norm(placed - np.roll(placed, 1, axis=1), axis=-1)))
    if not MARKER_OFF[0] < edge / board.marker < MARKER_OFF[1]:
        message = f"camera {camera}: markers are {edge:.3g} m large beside squares of {board.square:g} m"
        raise DataError(message, "", f"--marker is {board.marker:g} m: measure a marker with its black border")


def never_seen(seen: np.ndarray, board: Board) -> str:
    """A word on rows or columns of a ChArUco board of which no camera saw a corner, `seen` [corner] bool, or none."""
    if board.kind != "charuco":
        return ""
    grid = seen.reshape(board.rows - 1, board.columns - 1)
    rows, columns = int((~grid.any(1)).sum()), int((~grid.any(0)).sum())
    if not rows and not columns:
        return ""
    what = " and ".join(f"{n} {word}" for n, word in ((rows, "rows"), (columns, "columns")) if n)
    return (
        f"{what} of corners are seen by no camera: if the board has them not, --columns or --rows is wrong, "
        "and so is the origin"
    )


def _other_size(found: dict[int, np.ndarray], board: Board) -> str:
    """The board on which the markers lie as they are seen."""
    fits = [
        (round(off, 2), one.rows, one)
        for columns in range(2, LARGEST)
        for one in _boards(board, columns, max(found))
        if (off := _off(found, one)) < FITS
    ]
    if not fits:
        return "markers are seen, but they lie on no flat board: keep it flat; check --board and --dictionary"
    one = min(fits, key=lambda fit: fit[:2])[2]
    if one.columns != board.columns:
        swapped = f" --rows {board.columns}" if one.columns == board.rows else f", and {one.rows} rows or more"
        return f"the markers lie as on a board of {one.columns} columns: --columns {one.columns}{swapped}"
    if max(found) >= board.markers:
        return f"marker {max(found)} is seen, the board has {board.markers}, from 0 on: --rows {one.rows} or more"
    return "check --square against --marker, and show more of the board at once"


def _boards(board: Board, columns: int, last: int) -> list[Board]:
    """Boards of so many columns that have a marker of that number."""
    if board.kind == "grid":
        rows = max(board.rows, -(-(last + 1) // columns))
        return [replace(board, columns=columns, rows=rows, from_below=below) for below in (False, True)]
    fewest = max(3, -(-2 * (last + 1) // columns))
    return [
        replace(board, columns=columns, rows=rows, legacy=legacy)
        for rows in (fewest, fewest + 1)
        for legacy in (False, True)
        if columns >= 3 and columns * rows // 2 > last and columns * rows // 2 <= len(board.codes().bytesList)
    ]


def _off(found: dict[int, np.ndarray], board: Board) -> float:
    """How far markers lie from where a board has them, median, in edges of a marker."""
    import cv2

    at = _middles(board)
    if board.kind == "grid" and board.from_below:
        turned = np.arange(board.markers).reshape(board.rows, board.columns)[::-1].ravel()
        at = {int(n): at[k] for k, n in enumerate(turned)}
    known = [n for n in found if n in at]
    if len(known) < ENOUGH:
        return np.inf
    seen = np.array([found[n].mean(0) for n in known])
    edge = np.median([np.linalg.norm(found[n][0] - found[n][2]) for n in known]) / np.sqrt(2)
    H, _ = cv2.findHomography(np.array([at[n] for n in known]), seen)
    if H is None:
        return np.inf
    placed = cv2.perspectiveTransform(np.array([at[n] for n in known])[None].astype(float), H)[0]
    return float(np.median(np.linalg.norm(placed - seen, axis=1)) / edge)


def _middles(board: Board) -> dict[int, np.ndarray]:
    """Where the board has the middles of its markers [2] (m), by number."""
    made = board.make()
    return {
        int(n): np.mean(points, 0)[:2] for n, points in zip(np.ravel(made.getIds()), made.getObjPoints(), strict=True)
    }


def _other_dictionary(images: Sequence[np.ndarray], board: Board) -> str:
    """The smallest dictionary whose markers are in the images, where it is not the board's; empty where there is none."""
    cells: dict[tuple[int, int], list[list[np.ndarray]]] = {}
    quads = [_quads(image, board) for image in images[::ASKED]]
    found: list[tuple[int, str]] = []
    for (family, sizes), border in product(FAMILIES.items(), (1, 2) if board.kind == "grid" else (1,)):
        codes = replace(board, dictionary=f"{family}{sizes[-1]}").codes()
        size = codes.markerSize, border
        if size not in cells:
            cells[size] = [_codes(grey, corners, *size) for grey, corners in quads]
        numbers = max(({n for one in seen if (n := _number(one, codes)) >= 0} for seen in cells[size]), key=len)
        if len(numbers) >= ENOUGH:
            enough = [size for size in sizes if not size.isdigit() or int(size) > max(numbers)]
            found.append((len(numbers), f"{family}{enough[0]}"))
    best = max(found)[1] if found else ""
    return best if best != board.dictionary else ""


def _quads(image: np.ndarray, board: Board) -> tuple[np.ndarray, list[np.ndarray]]:
    """A grey image of an RGB one, and the corners [4, 2] (px) of the largest things in it that may be markers."""
    import cv2

    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    corners, _, others = cv2.aruco.ArucoDetector(board.codes()).detectMarkers(grey)
    quads = [np.reshape(one, (4, 2)).astype(np.float32) for one in (*corners, *others)]
    return grey, sorted(quads, key=cv2.contourArea, reverse=True)[:QUADS]


def _codes(grey: np.ndarray, quads: Sequence[np.ndarray], size: int, border: int) -> list[np.ndarray]:
    """The bits uint8 [size, size] of those of quads [4, 2] (px) that have a black border, so many bits wide."""
    import cv2

    side = size + 2 * border
    square = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32) * BIT - 0.5
    inside, found = np.s_[border:-border, border:-border], []
    for quad in quads:
        flat = cv2.warpPerspective(grey, cv2.getPerspectiveTransform(quad, square), (side * BIT, side * BIT))
        _, black = cv2.threshold(flat, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
        bits = (black.reshape(side, BIT, side, BIT)[:, 2:-2, :, 2:-2].mean((1, 3)) > 0.5).astype(np.uint8)
        if bits.sum() == bits[inside].sum() > 0:
            found.append(np.ascontiguousarray(bits[inside]))
    return found


def _number(bits: np.ndarray, codes) -> int:
    """The number of the marker of a dictionary that has these bits [size, size], -1 for none."""
    known, number, _ = codes.identify(bits, WRONG_BITS)
    return int(number) if known else -1
