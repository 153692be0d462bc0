"""Real file systems that are small, which only root can make: the bytes gone, the inodes gone, the quota reached."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.attack.chains import different
from tests.attack.full_disk import contents
from tests.mounts import Mounts

TMPFS = "mount -t tmpfs -o size=12M,nr_inodes=400 small small"
EXT4 = """
truncate -s 12M image && mkfs.ext4 -q -F -m 0 image && mount -o loop image small || exit 1
"""
QUOTA = """
truncate -s 128M image && mkfs.btrfs -q image && mount -o loop image small || exit 1
btrfs quota enable small && btrfs subvolume create small/of && btrfs qgroup limit 4M small/of || exit 1
"""


@pytest.fixture
def disk(tmp_path) -> Iterator[Callable[..., Mounts]]:
    made: list[Mounts] = []

    def make(script: str, inner: str = "") -> Mounts:
        (tmp_path / "small").mkdir()
        made.append(Mounts(script, tmp_path, tmp_path / "small" / inner))
        return made[-1]

    yield make
    for one in made:
        one.end()


def bytes_gone(disk: Mounts, left: int) -> list[Path]:
    """Files that fill a disk, but for so many bytes."""
    ballast = [disk.seen / "ballast"]
    with ballast[0].open("wb", buffering=0) as file:
        for size in (1 << 20, 1 << 12):
            try:
                while True:
                    file.write(os.urandom(size))
            except OSError:
                continue
        if left:  # beyond a quota not even the length that it has can be set
            file.truncate(max(0, file.tell() - left))
    return ballast


def inodes_gone(disk: Mounts, left: int) -> list[Path]:
    """Files that take all inodes of a disk, but for so many."""
    (disk.seen / "many").mkdir()
    found: list[Path] = []
    try:
        while True:
            found.append(disk.seen / "many" / str(len(found)))
            found[-1].touch()
    except OSError:
        found.pop()
    for path in found[:left]:
        path.unlink()
    return found[left:]


@pytest.mark.parametrize(
    ("how", "fill", "left", "command"),
    [
        ((TMPFS,), bytes_gone, 4 << 10, "plan"),
        ((TMPFS,), inodes_gone, 0, "evaluate"),
        ((TMPFS,), inodes_gone, 1, "report"),
        ((EXT4,), bytes_gone, 0, "plan"),
        ((QUOTA, "of"), bytes_gone, 0, "plan"),
    ],
    ids=["bytes", "inodes", "one inode left", "ext4", "quota"],
)
def test_what_is_full_is_said_and_nothing_is_lost(disk, tiny_run, how, fill, left, command):
    small = disk(*how)
    shutil.copytree(tiny_run, small.seen / "run")
    before = kept(small.seen / "run")
    ballast = fill(small, left)
    full = small.piegraph(command, "--run", "run", *([] if command == "report" else ["--force"]), check=3)
    assert "cannot be written" in full.stderr
    assert "run/" in full.stderr
    assert "free disk space" in full.stderr
    assert "Traceback" not in full.stderr
    assert kept(small.seen / "run") == before
    for path in ballast:
        path.unlink()
    small.piegraph(command, "--run", "run")
    assert not different(small.seen / "run", tiny_run)


def kept(run: Path) -> dict[str, str]:
    """What a run has, but for its notes."""
    notes = (".locks", "run.log", ".known.json", "failures.json", "report")
    return {path: of for path, of in contents(run).items() if not path.startswith(notes)}
