"""Work that a GPU does again and again, recorded once as a CUDA graph."""

from collections.abc import Callable

import torch


class Recorded:
    """A function that changes tensors which stay where they are, and draws from `generator` alone.

    With `record` what its second call asks of the GPU is recorded, and replayed then and from then on: a hundred small
    operations take longer to ask for than to do. It must not wait for the GPU, nor ask anything that depends on values.
    """

    def __init__(self, work: Callable[[], None], generator: torch.Generator, record: bool):
        self.work, self.generator, self.record = work, generator, record
        self.called = False
        self.graph: torch.cuda.CUDAGraph | None = None

    def __call__(self) -> None:
        if self.record and self.called and self.graph is None:
            self.graph = torch.cuda.CUDAGraph()
            self.graph.register_generator_state(self.generator)
            with torch.cuda.graph(self.graph):
                self.work()
        if self.graph is not None:
            self.graph.replay()
        else:
            self.work()
            self.called = True


def recording() -> bool:
    """Whether work is being recorded: checks that wait for its results have been done before."""
    return torch.cuda.is_available() and torch.cuda.is_current_stream_capturing()
