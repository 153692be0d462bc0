"""A dataset: strokes cut from the hand's path and contact, training pairs of frames, a split by sequence."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from piegraph_cli.dynamics.cutting import Cut, cut_strokes, frame_pairs
from piegraph_cli.dynamics.params import DatasetParams
from piegraph_cli.dynamics.splits import split_sequences
from piegraph_cli.errors import DataError
from piegraph_cli.params import PICK

NO_STROKE = "check the hand with `piegraph report`, or lower min_stroke"
UNSEEN = "the object is hardly seen: look at the clouds with `piegraph report`, or lower min_seen"

SEEN = 0.1
"""Least visibility of a particle whose place counts as known."""

Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Found:
    """The strokes and pairs of one sequence, and what was left out of them."""

    strokes: np.ndarray
    """[S, 2] first and last frame."""
    follows: np.ndarray
    """[S] whether nothing unknown happened to the object since the stroke before."""
    pairs: list[np.ndarray]
    """[P, 2] two frames, per stroke."""
    cut: Cut
    unseen: int = 0
    """Frames in which too little of the object is seen."""
    strokes_lost: int = 0
    """Strokes of which nothing is left, since the object was not seen."""
    particles_unseen: float = 0.0
    """Share of the particles, over the frames of its strokes, whose places are not known."""
    pairs_lost: int = 0
    """Pairs left out since the object was not seen in one of their frames."""


def build_dataset(
    tracks: Mapping[str, Arrays], params: DatasetParams
) -> tuple[dict[str, np.ndarray], dict[str, Found]]:
    """The datasets of a dataset artifact, from the arrays of tracks by sequence, and what was found in each sequence.

    Raises `DataError` where no stroke is found, or particles differ in number.
    """
    _check_particles(tracks)
    found = {name: find_strokes(artifact, params) for name, artifact in tracks.items()}
    empty = {name for name, of in found.items() if len(of.strokes) == 0}
    if len(empty) == len(found):
        lost = any(of.strokes_lost for of in found.values())
        raise DataError("no stroke was found in any sequence", hint=UNSEEN if lost else NO_STROKE)
    columns: dict[str, list[Any]] = {name: [] for name in ("strokes", "owner", "mode", "pairs", "pair_stroke", "start")}
    frames, stroke_count = 0, 0
    for index, (name, of) in enumerate(found.items()):
        columns["start"].append(frames)
        columns["strokes"] += (of.strokes + frames).tolist()
        columns["owner"] += [index] * len(of.strokes)
        columns["mode"] += tracks[name]["mode"][of.strokes[:, 0]].tolist()
        for pairs in of.pairs:
            columns["pairs"] += (pairs + frames).tolist()
            columns["pair_stroke"] += [stroke_count] * len(pairs)
            stroke_count += 1
        frames += len(tracks[name]["time"])
    arrays = {
        "positions": np.concatenate([a["positions"] for a in tracks.values()]),
        "seen": np.concatenate([known_particles(a) for a in tracks.values()]),
        "end_effector": np.nan_to_num(np.concatenate([a["end_effector"][:, :2] for a in tracks.values()])),
        "strokes": np.array(columns["strokes"]),
        "stroke_sequence": np.array(columns["owner"]),
        "stroke_mode": np.array(columns["mode"]),
        "stroke_follows": np.concatenate([of.follows for of in found.values()]),
        "pairs": np.array(columns["pairs"], np.int64).reshape(-1, 2),
        "pair_stroke": np.array(columns["pair_stroke"]),
        "sequence_name": np.array(list(tracks)),
        "sequence_start": np.array(columns["start"]),
        "sequence_split": split_sequences(list(tracks), params, empty),
    }
    return arrays, found


def find_strokes(artifact: Arrays, params: DatasetParams) -> Found:
    """The strokes and pairs of one sequence: its frames that are seen, counted against what all of them would give."""
    particles = known_particles(artifact)
    seen = particles.mean(1) >= params.min_seen
    if "trust/doubt" in artifact:
        seen &= artifact["trust/doubt"] <= params.max_doubt
    kept = _strokes_in(artifact, seen, params)
    within = [particles[first : last + 1] for first, last in kept.strokes]
    unseen = float(1 - np.concatenate(within).mean()) if within else 0.0
    if seen.all():
        return replace(kept, particles_unseen=unseen)
    whole = _strokes_in(artifact, np.ones_like(seen), params)
    left = [((kept.strokes[:, 0] <= last) & (kept.strokes[:, 1] >= first)).any() for first, last in whole.strokes]
    pairs_lost = sum(map(len, whole.pairs)) - sum(map(len, kept.pairs))
    return replace(
        kept,
        unseen=int((~seen).sum()),
        strokes_lost=len(left) - sum(left),
        particles_unseen=unseen,
        pairs_lost=max(0, pairs_lost),
    )


def known_particles(artifact: Arrays) -> np.ndarray:
    """Particles [F, N] whose places are known: those of which some is seen."""
    return artifact["visibility"] >= SEEN


def _strokes_in(artifact: Arrays, seen: np.ndarray, params: DatasetParams) -> Found:
    """Strokes whose frames are seen. Of a pick, which hides what it carries, the ends have to be; it may bend."""
    hand, pick = artifact["end_effector"], artifact["mode"] == PICK
    touching = artifact["contact"].astype(bool) & (seen | pick)
    cut = cut_strokes(hand, touching, params.min_stroke, np.where(pick, np.inf, params.max_bend))
    known = seen[cut.strokes].all(1)
    strokes, run = cut.strokes[known], cut.run[known]
    pairs = [frame_pairs(first, last, hand, params.min_gap) for first, last in strokes]
    follows = np.zeros(len(strokes), bool)
    for k in range(1, len(strokes)):
        before, first = strokes[k - 1, 1], strokes[k, 0]
        gap = run[k] == run[k - 1] and first != before  # a piece in between was too short
        follows[k] = seen[before : first + 1].all() and not gap
    return Found(strokes, follows, [p[seen[p].all(1)] for p in pairs], cut)


def _check_particles(tracks: Mapping[str, Arrays]) -> None:
    counts = {name: artifact["positions"].shape[1] for name, artifact in tracks.items()}
    if len(set(counts.values())) > 1:
        raise DataError(f"sequences differ in particles: {counts}", hint="track all with the same --particles")
