"""Strokes as arrays, and the action seen from the stroke's own frame, which no rotation or shift of the scene changes."""

import torch

from piegraph_cli.errors import DataError

MIN_STROKE = 1e-3
"""Metres; a shorter stroke has no heading."""

FEATURES = 10
"""Node features of `canonical_action`."""

NEAR = 0.01
"""Metres: the scale of a pusher, on which it is decided whether it takes a rope's end along or slips off."""

PICK_FEATURES = 5
"""Node features of `pick_features`."""


def make_strokes(start, end, mode, held=None) -> torch.Tensor:
    """Strokes [B, 7]: start x, y, end x, y in m, mode (0 push, 1 pick), whether a pick holds the object at start and end.

    From start [B, 2], end [B, 2], mode [B] and held [B, 2]; without it strokes are whole: grasped after their start,
    let go before their end.
    """
    start, end, mode = (torch.as_tensor(part) for part in (start, end, mode))
    held = torch.zeros_like(start) if held is None else torch.as_tensor(held).to(start)
    return torch.cat([start, end, mode[..., None].to(start), held], -1)


def check_strokes(strokes: torch.Tensor) -> None:
    """Refuse strokes [B, 7] that are not finite or too short to have a heading. Raises `DataError` naming the first."""
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


def canonical_action(
    positions: torch.Tensor, strokes: torch.Tensor, mirror: bool = False
) -> tuple[torch.Tensor, torch.Tensor]:
    """Node features [B, N, 10] and sides [B, N, 2] of positions [B, N, 3] (m) under strokes [B, 7].

    The particle relative to the stroke's end in the stroke's frame (2, m), its height (m), the stroke's length (m), the mode,
    at the pusher's scale as tanh(u / `NEAR`) how far it is ahead of the end, ahead of the start, and to the side, and without
    their signs how far it is to the side in both scales. Unchanged when scene and stroke are turned about z or moved in the
    plane together.

    With `mirror` unchanged by reflection too. Then the sides change sign: on which side of the stroke the particle lies,
    and on which the object, from -1 (right) to 1 (left); what has a sign above is multiplied by the second. Without it sides
    are one, and left is told from right.

    Source: paper, Eq. 5; the rest is this project's. That expression alone forgets where the stroke began, and a network
    that must resolve millimetres from decimetres gets glancing strokes wrong.
    """
    relative = (positions[..., :2] - strokes[:, None, 2:4]) @ stroke_rotation(strokes)
    length = (strokes[:, 2:4] - strokes[:, :2]).norm(dim=-1)
    shared = torch.stack([length, strokes[:, 4]], -1)[:, None].expand(-1, positions.shape[1], -1)
    ahead, aside = relative.split(1, -1)
    near = (torch.cat([ahead, ahead + shared[..., :1], aside], -1) / NEAR).tanh()
    side = near[..., 2:]
    sides = torch.cat([side, side.mean(1, keepdim=True).expand_as(side)], -1) if mirror else torch.ones_like(relative)
    seen, near_seen = aside * sides[..., 1:], side * sides[..., 1:]
    parts = [ahead, seen, positions[..., 2:], shared, near[..., :2], near_seen, aside.abs(), side.abs()]
    return torch.cat(parts, -1), sides


def grasped_particle(positions: torch.Tensor, strokes: torch.Tensor) -> torch.Tensor:
    """Index [B] of the particle of positions [B, N, 3] (m) that lies nearest to the strokes' starts in the plane."""
    return (positions[..., :2] - strokes[:, None, :2]).norm(dim=-1).argmin(-1)


def pick_features(
    positions: torch.Tensor, strokes: torch.Tensor, rest: torch.Tensor, grasp: torch.Tensor
) -> torch.Tensor:
    """What a pick adds to the node features [B, N, 5] of positions [B, N, 3] (m) under strokes [B, 7]; zero for pushes.

    Whether the object is held at the stroke's start and end; the particle's distance to the grasped one `grasp` [B] in
    the rest state [B, N, 3] (m); how much further than that it is from the stroke's end, by which it must be dragged
    if nothing stretches (m); its height above the grasped one (m). All are invariant in the plane.

    Source: the paper gives pushes only; this is the project's.
    """
    row = torch.arange(len(positions), device=positions.device)
    reach = (rest - rest[row, grasp][:, None]).norm(dim=-1)
    slack = ((positions[..., :2] - strokes[:, None, 2:4]).norm(dim=-1) - reach).clamp_min(0)
    above = positions[..., 2] - positions[row, grasp, 2][:, None]
    held = strokes[:, None, 5:7].expand(-1, positions.shape[1], -1)
    return torch.cat([held, torch.stack([reach, slack, above], -1)], -1) * strokes[:, 4, None, None]
