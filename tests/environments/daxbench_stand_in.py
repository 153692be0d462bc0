"""The DaXBench bridge on the stand-in for DaXBench beside this file."""

import sys
from pathlib import Path

from piegraph_cli import environments
from tests.cli import PATIENCE

REPO = Path(__file__).parent / "fake_daxbench"
PUSH_UP = {"start": [0.05, -0.15], "end": [0.05, 0.06], "mode": 0}


def make_daxbench(name, timeout=PATIENCE, particles=50):
    return environments.make(name, particles, {"python": sys.executable, "repo": str(REPO), "timeout": timeout})
