"""The action seen from the stroke's own frame, which no rotation or shift of the scene changes."""

import torch

from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.params import PICK

FEATURES = 10
"""Node features of `canonical_action`."""

NEAR = 0.01
"""Metres: the scale of a pusher, on which it is decided whether it takes a rope's end along or slips off."""

PICK_FEATURES = 5
"""Node features of `pick_features`."""


def canonical_action(
    positions: torch.Tensor, strokes: Strokes, mirror: bool = False
) -> tuple[torch.Tensor, torch.Tensor]:
    """Node features [B, N, 10] and sides [B, N, 2] of positions [B, N, 3] (m) under strokes [B].

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
    relative = (positions[..., :2] - strokes.planar.end[:, None]) @ strokes.rotation
    shared = torch.stack([strokes.length, strokes.mode.to(positions)], -1)[:, None].expand(-1, positions.shape[1], -1)
    ahead, aside = relative.split(1, -1)
    near = (torch.cat([ahead, ahead + shared[..., :1], aside], -1) / NEAR).tanh()
    side = near[..., 2:]
    sides = torch.cat([side, side.mean(1, keepdim=True).expand_as(side)], -1) if mirror else torch.ones_like(relative)
    seen, near_seen = aside * sides[..., 1:], side * sides[..., 1:]
    parts = [ahead, seen, positions[..., 2:], shared, near[..., :2], near_seen, aside.abs(), side.abs()]
    return torch.cat(parts, -1), sides


def grasped_particle(positions: torch.Tensor, strokes: Strokes) -> torch.Tensor:
    """Index [B] of the particle of positions [B, N, 3] (m) that lies nearest to the strokes' starts in the plane."""
    return (positions[..., :2] - strokes.planar.start[:, None]).norm(dim=-1).argmin(-1)


def pick_features(positions: torch.Tensor, strokes: Strokes, rest: torch.Tensor, grasp: torch.Tensor) -> torch.Tensor:
    """What a pick adds to the node features [B, N, 5] of positions [B, N, 3] (m) under strokes [B]; zero for pushes.

    Whether the object is held at the stroke's start and end; the particle's distance to the grasped one `grasp` [B] in
    the rest state [B, N, 3] (m); how much further than that it is from the stroke's end, by which it must be dragged
    if nothing stretches (m); its height above the grasped one (m). All are invariant in the plane.

    Source: the paper gives pushes only; this is the project's.
    """
    row = torch.arange(len(positions), device=positions.device)
    reach = (rest - rest[row, grasp][:, None]).norm(dim=-1)
    slack = ((positions[..., :2] - strokes.planar.end[:, None]).norm(dim=-1) - reach).clamp_min(0)
    above = positions[..., 2] - positions[row, grasp, 2][:, None]
    held = strokes.held[:, None].expand(-1, positions.shape[1], -1).to(positions)
    return torch.cat([held, torch.stack([reach, slack, above], -1)], -1) * (strokes.mode == PICK)[:, None, None]
