"""Run a piegraph command and kill it with SIGKILL while it writes its N-th HDF5 dataset: python killer.py N ARGUMENT ..."""

import os
import signal
import sys

import h5py

left = int(sys.argv[1])
sys.argv = ["piegraph", *sys.argv[2:]]
create = h5py.Group.create_dataset


def create_and_die(self, *arguments, **options):
    global left
    left -= 1
    result = create(self, *arguments, **options)
    if left <= 0:
        self.file.flush()
        os.kill(os.getpid(), signal.SIGKILL)
    return result


h5py.Group.create_dataset = create_and_die

from piegraph_cli.app import main  # noqa: E402

main()
