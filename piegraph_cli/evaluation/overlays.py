"""Pictures made of camera images: masks, hand landmarks and particles drawn where the cameras see them."""

from collections.abc import Sequence

import numpy as np

from piegraph_cli.perception.look import Look
from piegraph_cli.recording.camera import Camera

MASK_COLOR = (255, 0, 200)
TINT = 0.15
"""Of a mask's area: little, for with more of it a thing seems to have another colour than it has."""
HAND_COLOR = (255, 210, 0)
TIP_COLOR = (255, 40, 40)
PARTICLE_COLOR = (255, 255, 0)
SMALL = 320
"""Pixels of an image's width below which lines and dots are thinner."""
BONES = [(0, 1), (1, 2), (2, 3), (3, 4), (0, 5), (5, 6), (6, 7), (7, 8), (5, 9), (9, 10), (10, 11), (11, 12), (9, 13)]
BONES += [(13, 14), (14, 15), (15, 16), (13, 17), (17, 18), (18, 19), (19, 20), (0, 17)]


def draw_mask(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """An RGB image [H, W, 3] with a mask's area tinted and its outline drawn."""
    import cv2

    tinted = image.copy()
    tinted[mask] = ((1 - TINT) * tinted[mask] + TINT * np.array(MASK_COLOR)).astype(np.uint8)
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    width = 2 if image.shape[1] >= SMALL else 1
    return np.ascontiguousarray(cv2.drawContours(tinted, outlines, -1, MASK_COLOR, width))


def draw_things(image: np.ndarray, masks: Sequence[np.ndarray]) -> np.ndarray:
    """An RGB image with things outlined and numbered from 1; the first, which is taken, is tinted."""
    import cv2

    drawn = draw_mask(image, masks[0])
    for number, mask in enumerate(masks, 1):
        if not mask.any():
            continue
        if number > 1:
            outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            drawn = np.ascontiguousarray(cv2.drawContours(drawn, outlines, -1, HAND_COLOR, 1))
        row, column = np.argwhere(mask).mean(axis=0).round().astype(int)
        _write(drawn, str(number), int(column), int(row), 0.7)
    return drawn


def draw_hand(image: np.ndarray, landmarks: np.ndarray, detected: bool) -> np.ndarray:
    """An RGB image with hand landmarks [21, 2] (px, NaN unknown); thin where only other cameras detected the hand."""
    import cv2

    if not np.isfinite(landmarks).all():
        return image
    points, bold = [(round(float(x)), round(float(y))) for x, y in landmarks], detected and image.shape[1] >= SMALL
    for a, b in BONES:
        cv2.line(image, points[a], points[b], HAND_COLOR, 2 if bold else 1, cv2.LINE_AA)
    for k, point in enumerate(points):
        cv2.circle(image, point, 3 if bold else 2, TIP_COLOR if k in (8, 12) else HAND_COLOR, -1, cv2.LINE_AA)
    return image


def draw_particles(image: np.ndarray, positions: np.ndarray, camera: Camera, colors: np.ndarray) -> np.ndarray:
    """An RGB image of a camera, also a smaller one, with particles [N, 3] (m, world) in colours uint8 [N, 3]."""
    import cv2

    pixels, depth = camera.project(positions)
    pixels, radius = pixels * (image.shape[1] / camera.width), 3 if image.shape[1] >= SMALL else 2
    for (x, y), z, color in zip(pixels, depth, colors.tolist(), strict=True):
        if z > 0 and 0 <= x < image.shape[1] and 0 <= y < image.shape[0]:
            cv2.circle(image, (round(float(x)), round(float(y))), radius + 1, (0, 0, 0), -1, cv2.LINE_AA)
            cv2.circle(image, (round(float(x)), round(float(y))), radius, color, -1, cv2.LINE_AA)
    return image


def label(image: np.ndarray, text: str, size: float = 0.5) -> np.ndarray:
    """An RGB image with a line of text in its upper left corner."""
    _write(image, text, 6, round(36 * size), size)
    return image


def _write(image: np.ndarray, text: str, x: int, y: int, size: float) -> None:
    """White text with a black rim; the rim is the text beside itself, since thicker text is wider too."""
    import cv2

    rim = [(x + dx, y + dy, (0, 0, 0)) for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1))]
    for column, row, color in [*rim, (x, y, (255, 255, 255))]:
        cv2.putText(image, text, (column, row), cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)


def tile(rows: Sequence[Sequence[np.ndarray]], gap: int = 4) -> np.ndarray:
    """Images laid out in rows, each in a field as large as the largest; white between them, or nothing with opacity."""
    height, width = np.max([image.shape[:2] for row in rows for image in row], axis=0)
    columns = max(len(row) for row in rows)
    channels = rows[0][0].shape[2]
    size = (len(rows) * (height + gap) - gap, columns * (width + gap) - gap, channels)
    sheet = np.full(size, 255 if channels == 3 else 0, np.uint8)
    for r, row in enumerate(rows):
        for c, image in enumerate(row):
            top, left = r * (height + gap), c * (width + gap)
            sheet[top : top + image.shape[0], left : left + image.shape[1]] = image
    return sheet


def look_sheet(color: Sequence[np.ndarray], cameras: Sequence[Camera], seen: Look) -> np.ndarray:
    """The images of one look, two in a row: the object's mask and particles, numbers on it and on other things."""
    yellow = np.tile(np.array(PARTICLE_COLOR, np.uint8), (len(seen.chosen), 1))
    images = []
    for c, (image, camera) in enumerate(zip(color, cameras, strict=True)):
        things = [seen.masks[c], *(masks[c] for masks in seen.others)]
        drawn = draw_things(image, things) if seen.others else draw_mask(image, things[0])
        drawn = draw_particles(drawn, seen.chosen, camera, yellow)
        images.append(label(drawn, f"{camera.name}: {seen.verdict}"))
    return tile([images[k : k + 2] for k in range(0, len(images), 2)])
