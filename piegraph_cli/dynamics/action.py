"""Strokes as arrays, and the action seen from the stroke's own frame, which no rotation or shift of the scene changes."""

import torch

from piegraph_cli.errors import DataError

MIN_STROKE = 1e-3
"""Metres; a shorter stroke has no heading."""

FEATURES = 5
"""Node features of `canonical_action`."""


def make_strokes(start, end, mode) -> torch.Tensor:
    """Strokes [B, 5] (start x, y, end x, y in m, mode 0 push or 1 pick) from start [B, 2], end [B, 2] and mode [B]."""
    start, end, mode = (torch.as_tensor(part) for part in (start, end, mode))
    return torch.cat([start, end, mode[..., None].to(start.dtype)], -1)


def check_strokes(strokes: torch.Tensor) -> None:
    """Refuse strokes [B, 5] that are not finite or too short to have a heading. Raises `DataError` naming the first."""
    lengths = (strokes[:, 2:4] - strokes[:, :2]).norm(dim=-1)
    bad = ~torch.isfinite(strokes).all(-1) | (lengths < MIN_STROKE)
    if bad.any():
        index = int(bad.nonzero()[0])
        raise DataError(
            f"start and end {strokes[index, :4].tolist()} are equal or not finite: no heading",
            f"stroke {index}",
            f"give strokes of at least {MIN_STROKE * 1000:g} mm",
        )


def stroke_rotation(strokes: torch.Tensor) -> torch.Tensor:
    """R(phi) [B, 2, 2], which turns the x axis to the stroke's heading."""
    heading = strokes[:, 2:4] - strokes[:, :2]
    cosine, sine = (heading / heading.norm(dim=-1, keepdim=True)).unbind(-1)
    return torch.stack([torch.stack([cosine, -sine], -1), torch.stack([sine, cosine], -1)], -2)


def canonical_action(positions: torch.Tensor, strokes: torch.Tensor) -> torch.Tensor:
    """Node features [B, N, 5] of positions [B, N, 3] (m) under strokes [B, 5].

    The particle relative to the stroke's end in the stroke's frame (2, m), its height (m), the stroke's length (m), the mode.
    Unchanged when scene and stroke are turned about z or moved in the plane together; not under reflection, since an
    object's centre of mass may lie off its axis.

    Source: paper, Eq. 5; height, length and mode are added, since that expression alone forgets where the stroke began.
    """
    relative = (positions[..., :2] - strokes[:, None, 2:4]) @ stroke_rotation(strokes)
    length = (strokes[:, 2:4] - strokes[:, :2]).norm(dim=-1)
    shared = torch.stack([length, strokes[:, 4]], -1)[:, None].expand(-1, positions.shape[1], -1)
    return torch.cat([relative, positions[..., 2:], shared], -1)
