"""Benchmarks: what they print, and that they refuse to time wrong results."""

import pytest
import torch

from piegraph_cli.bench import kernels, pipeline
from piegraph_cli.bench.measure import Row, table
from piegraph_cli.bench.run import draw_roofline
from piegraph_cli.dynamics.network_kernel import NetworkKernel
from piegraph_cli.dynamics.params import EGNNParams
from piegraph_cli.errors import DataError
from tests.cli import piegraph, piegraph_json


def test_a_benchmark_by_name():
    rows = piegraph_json("bench", "track")["rows"]
    assert [row["subject"] for row in rows] == ["machine"] * (len(rows) - 2) + ["track", "track"]
    assert rows[0]["gflops"] > 1
    assert rows[-1]["seconds"] > 0
    assert rows[-1]["error"] < pipeline.TRACKED


def test_names_runs_and_pictures_that_cannot_be(tmp_path):
    fly = piegraph("bench", "fly", check=2).stderr
    assert "no benchmark fly" in fly
    assert "perception" in fly
    assert "--run" in piegraph("bench", "perception", check=2).stderr
    for picture in (tmp_path / "none" / "x.png", tmp_path / "x.doc"):
        assert "bench --roofline" in piegraph("bench", "track", "--roofline", picture, check=2).stderr
        assert not picture.exists()


def test_wrong_springs_are_not_timed(monkeypatch):
    right = kernels.spring_kernel.guide
    monkeypatch.setattr(kernels.spring_kernel, "guide", lambda *a: right(*a) + 1e-4)
    with pytest.raises(DataError, match=r"bench sms: deviates from its reference by 1.0\de-04 m"):
        next(kernels.spring_rows())


def test_a_wrong_network_is_not_timed(monkeypatch):
    right = NetworkKernel.__call__
    monkeypatch.setattr(NetworkKernel, "__call__", lambda *a: right(*a) * torch.tensor(1.001))
    with pytest.raises(DataError, match="bench egnn"):
        next(kernels.network_rows())


def test_operations_of_the_network_grow_with_its_size():
    small, large = (kernels.network_flop(50, EGNNParams(hidden=hidden)) for hidden in (32, 64))
    assert 2 < large / small < 4
    twice = 2 * kernels.network_flop(50, EGNNParams())
    assert kernels.network_flop(100, EGNNParams()) == pytest.approx(twice, rel=2e-3), "all but the map of the mean"


def test_the_table_and_the_roofline():
    rows = [
        Row("machine", "copy", 1e-6, bytes=1e5),
        Row("sms", "512 x 50", 0.01, error=1e-7, flop=1e9, bytes=1e9, reference_seconds=0.5, share=0.4),
    ]
    line = table(rows).plain()[2]
    assert all(part in line for part in ("sms 512 x 50", "10 ms", "1.0e-07 m", "100.0", "40%", "500 ms", "50.0x"))
    assert draw_roofline(rows).axes[0].get_legend_handles_labels()[1] == ["sms", "egnn"]
