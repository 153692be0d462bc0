"""A block that a prior of blocks is to learn: what is none is refused, its numbers are fitted, its strokes simulated."""

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from piegraph_cli.dynamics.doubts import at_bounds, unexplained
from piegraph_cli.dynamics.examples import Sequences
from piegraph_cli.dynamics.family.blocks import FRICTION, PRESSURE, REACH, simulated
from piegraph_cli.dynamics.family.drawn import TRAITS
from piegraph_cli.dynamics.own import HINT, SIMULATED, Own, is_chain, stroke_parts
from piegraph_cli.dynamics.params import RigidParams
from piegraph_cli.dynamics.prior import Chunk
from piegraph_cli.dynamics.rigid_body import MOVED, WIDE, RigidBody, body_frame, planar_residuals
from piegraph_cli.errors import DataError
from piegraph_cli.physics.rigid import moved_in_plane

KNOWN = (0.25, 0.1, 0.15)
"""Deviations of the logarithms of friction, turning length and reach in these, where there are strokes to fit them to."""
UNKNOWN = (FRICTION[1], PRESSURE[1], REACH[1])
"""The same without any stroke."""
SHAPES = 4
"""Sequences whose particles are used in simulated strokes, at most."""
BENT, SHARE = 0.005, 0.2
"""Metres from a rigid motion, and share of the motion, above which a thing bends."""


def check_block(data: Sequences) -> None:
    """Refuse a recording of something else than a block. Raises `DataError` that says by what it is told."""
    hint = "train without --from: the prior is for blocks"
    if data.picks:
        raise DataError("strokes that hold the object; the prior is for blocks that are pushed", hint=hint)
    flat = data.rest[0][:, :2] - data.rest[0][:, :2].mean(0)
    width = float(np.linalg.svd(flat, compute_uv=False)[-1] / math.sqrt(len(flat)))
    if width < WIDE:
        raise DataError(f"as narrow as a rope ({width * 1000:.0f} mm): the prior is for blocks", hint=hint)
    before, after = (data.positions[k][..., :2] for k in data.strokes.T)
    motion = np.linalg.norm(after - before, axis=-1).mean(1)
    moved = motion > MOVED
    if not moved.any():
        if is_chain(data.rest[0]):  # nothing tells that it does not bend
            raise DataError("particles lie along a line: the prior is for blocks", hint=hint)
        return
    bent = float(np.median(planar_residuals(before[moved], after[moved])))
    if bent > max(BENT, SHARE * float(np.median(motion[moved]))):
        raise DataError(
            f"particles end {bent * 1000:.0f} mm from a rigid motion: this bends; the prior is for blocks", hint=hint
        )


def fitted_body(data: Sequences) -> RigidBody:
    """Outline and numbers of a block from its strokes; without any the numbers stay as before strokes are seen.

    Raises `DataError` where they leave most of the motion.
    """
    body = RigidBody(RigidParams(fit=len(data.strokes) > 0, refine=False, friction=FRICTION[0], reach=REACH[0]))
    if not len(data.strokes):  # one that nothing comes of
        at_rest, one = data.rest[:1].repeat(2, 0), np.array([[0, 1]])
        hand, zero = np.array([[1.0, 0.0], [1.1, 0.0]], np.float32), np.zeros(1, np.int64)
        data = replace(data, positions=at_rest, hand=hand, strokes=one, mode=zero, owner=zero)
    error, _ = body.fit(data)
    first, last = data.strokes.T
    motion = float(np.linalg.norm(data.positions[last] - data.positions[first], axis=-1).mean())
    wrong = unexplained(error, motion, "pushing", "block that was pushed") if body.params.fit else None
    if wrong:
        raise DataError(wrong, hint=HINT)
    return body


def own_strokes(body: RigidBody, data: Sequences, neighbors: int, seed: int) -> Chunk:
    """Strokes of a body simulated, with the particles that its sequences have."""
    rng = np.random.default_rng([seed, len(data.strokes)])
    chosen = np.unique(np.linspace(0, len(data.rest) - 1, SHAPES).astype(int))
    like = stroke_parts(data, float(body.numbers[2])) if len(data.strokes) else None
    drawn = []
    for rest in data.rest[chosen]:
        pose = body_frame(rest, body.shape.numpy())
        own = moved_in_plane(rest[:, :2] - pose[:2], np.array([0.0, 0.0, -pose[2]]))
        spread = KNOWN if len(data.strokes) else UNKNOWN
        particles = np.concatenate([own, rest[:, 2:]], 1)
        drawn.append(simulated(rng, body.edges, body.numbers, spread, particles, SIMULATED // len(chosen), like))
    return Chunk.of(drawn, neighbors)


def traits_of(body: RigidBody) -> Tensor:
    """A body's traits [TRAITS] as the prior of blocks was told them."""
    friction, c, *_ = body.numbers.tolist()
    gyration = float(body.shape.square().sum(1).mean().sqrt())
    traits = torch.zeros(TRAITS)
    for k, (number, (middle, spread)) in enumerate([(friction, FRICTION), (c / gyration, PRESSURE)]):
        traits[k] = min(max(math.log(number / middle) / spread, -2.0), 2.0)
    return traits  # how near the pusher comes is measured from particles here: REACH stays in the middle


def own_block(data: Sequences, neighbors: int, seed: int) -> Own:
    """The block of a recording: five numbers fitted to its strokes, if it has any."""
    body = fitted_body(data)
    return Own(traits_of(body), own_strokes(body, data, neighbors, seed), at_bounds(body.ended, "block"))
