"""`python -m tests.attack --seconds N`: a long attack, with what came of it in a table; what fails is named by its seed.

`--only NAME --seed K` repeats one and leaves what it changed in `--keep`.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from itertools import count
from pathlib import Path

from tests.attack.attacks import GROUPS
from tests.attack.engine import Attack, Tally, run_attack

OUTCOMES = ("refused", "same", "other", "traceback", "hang", "crash", "memory", "differs", "accepted")


def main() -> int:
    """Attack, print, and end with 1 where there was a fault."""
    parser = argparse.ArgumentParser(prog="python -m tests.attack", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--count", type=int, help="attacks on each target, whatever time they take")
    parser.add_argument("--groups", nargs="*", default=list(GROUPS), choices=list(GROUPS))
    parser.add_argument("--only", help="targets whose name holds this")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--keep", type=Path, help="with --only: change one thing, leave it there, and read it here")
    given = parser.parse_args()
    attacks = [(group, attack) for group in given.groups for attack in GROUPS[group]()]
    attacks = [(group, attack) for group, attack in attacks if given.only is None or given.only in attack.name]
    if given.keep:
        return _repeat(attacks[0][1], given.seed, given.keep)
    begin, found = time.monotonic(), {}
    for k, (group, attack) in enumerate(attacks):
        until = begin + given.seconds * (k + 1) / len(attacks) if given.count is None else float("inf")
        seeds = count(given.seed) if given.count is None else iter(range(given.seed, given.seed + given.count))
        tally = found.setdefault(group, {}).setdefault(attack.name, Tally())
        with tempfile.TemporaryDirectory(prefix="attack") as folder:
            run_attack(attack, seeds, Path(folder), tally, until)
        print(f"{attack.name:26s} {_counts(tally.counts)}", flush=True)
        for fault in tally.faults[:5]:
            print(f"    {fault}", flush=True)
    for group, tallies in found.items():
        print(f"{group:26s} {_counts(sum((tally.counts for tally in tallies.values()), Counter()))}")
    return int(any(tally.faults for tallies in found.values() for tally in tallies.values()))


def _counts(counts: Counter) -> str:
    return f"{sum(counts.values()):6d}  " + "  ".join(f"{name} {counts[name]}" for name in OUTCOMES if counts[name])


def _repeat(attack: Attack, seed: int, folder: Path) -> int:
    import numpy as np

    path = attack.make(folder)
    print(path, attack.change(path, np.random.default_rng(seed)), flush=True)
    print(attack.read(path))
    return 0


if __name__ == "__main__":
    sys.exit(main())
