"""The benchmark of the workspace: its made-up runs are fresh, and it refuses to time what is not."""

import pytest

from piegraph_cli.bench import workspace
from piegraph_cli.bench.workspace import make_recording, make_run, workspace_rows
from piegraph_cli.errors import DataError
from piegraph_cli.workspace import known

SMALL = {"small": (2, 2, 50)}


def test_rows_of_a_small_run(monkeypatch):
    monkeypatch.setattr(known, "TICK", 0)
    monkeypatch.setattr(workspace, "reading_rows", lambda: iter(()))
    rows = list(workspace_rows(SMALL))
    assert [row.case for row in rows] == [f"{c}, small" for c in ("status", "run", "piegraph status", "piegraph run")]
    assert all(row.seconds > 0 for row in rows)
    assert rows[0].reference_seconds == rows[1].reference_seconds > 0


def test_rows_of_artifacts_that_are_read(monkeypatch):
    monkeypatch.setattr(workspace, "READINGS", 2)
    rows = list(workspace.reading_rows({"a few": ("tracks", 3, 4, 5), "one": ("clouds", 1, 3, 10)}))
    assert [row.case for row in rows] == ["read, a few", "read, one"]
    assert all(row.seconds > 0 and row.reference_seconds > 0 for row in rows)


def test_what_is_not_fresh_is_not_timed(tmp_path):
    run = make_run(tmp_path / "run", make_recording(tmp_path / "recording", *SMALL["small"]))
    (tmp_path / "run" / "masks" / "sequence_0001.h5").unlink()
    with pytest.raises(DataError, match="1 of 16 artifacts"):
        workspace._status(run)
