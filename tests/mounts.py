"""File systems that only the processes of one test see: made by root, and gone with the process that holds them."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.cli import piegraph


class Mounts:
    """What a shell script has mounted, in a folder; commands run in `inside`, which is `seen` from outside.

    Skips where this is not root, or the machine cannot make it.
    """

    def __init__(self, script: str, folder: Path, inside: Path):
        if os.geteuid() or subprocess.run(["unshare", "-m", "true"], capture_output=True).returncode:
            pytest.skip("to mount a file system takes root")
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        words = ["unshare", "-m", "sh", "-c", f"{script}\necho there; exec cat"]
        self.process = subprocess.Popen(words, cwd=folder, **pipes)
        assert self.process.stdout is not None
        if not any(line == "there\n" for line in self.process.stdout):
            _, said = self.process.communicate()
            pytest.skip(f"this machine cannot make it: {said.strip()[-200:]}")
        self.inside, self.seen = inside, Path(f"/proc/{self.process.pid}/root{inside}")

    def piegraph(self, *arguments: object, **how):
        """Run the command line there."""
        return piegraph(*arguments, cwd=self.inside, mounts=self.process.pid, **how)

    def end(self) -> None:
        """Let go of it."""
        self.process.communicate()
