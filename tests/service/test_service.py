"""What is answered: the same as in Python, in the commands' envelope; bad requests get an error, and the next one is served."""

import base64
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from piegraph_cli import Strokes, load_model, look_settings, read_scene, save_model
from piegraph_cli.errors import DataError
from piegraph_cli.planning.model import Model
from piegraph_cli.service.requests import MOST_BYTES, points_of, written
from piegraph_cli.service.service import Eye, Origin, Service
from piegraph_cli.service.setup import opened_service
from tests.cli import SAMPLE
from tests.envelopes import Envelope


def asked(service: Service, command: str | None, value: object) -> dict:
    """The envelope that answers a request."""
    reply = service.reply(value if isinstance(value, bytes) else json.dumps(value).encode(), command)
    assert b"\n" not in reply.text
    Envelope.model_validate_json(reply.text, strict=True)
    found = json.loads(reply.text)
    assert reply.exit_code == (found["error"] or {"exit_code": 0})["exit_code"]
    return found


def test_a_plan_is_that_of_python(service, tiny_run, block, question):
    found = asked(service, None, {"command": "plan", **question, "candidates": 3})
    plan = load_model(tiny_run).plan(block, goal_pose=(0.1, 0.0, 0.5))
    result, rows = found["result"], found["result"]["strokes"]
    assert (found["command"], found["error"], found["warnings"]) == ("plan", None, list(plan.warnings))
    assert result["expected_gain"] == pytest.approx(plan.expected_gain)
    assert rows[0]["expected_error"] == pytest.approx(plan.expected_error)
    assert any("no stroke is expected to help" in text for text in plan.warnings) == (
        plan.expected_gain <= plan.expected_error
    )
    np.testing.assert_allclose([rows[0]["start"], rows[0]["end"]], plan.strokes.ends[0].numpy(), atol=1e-7)
    np.testing.assert_allclose([row["predicted"] for row in rows], plan.predicted, atol=1e-6)
    assert rows[0]["predicted_distance"] == pytest.approx(plan.steps[0].plan.cost)
    assert result["model"] == {"label": "piegraph", "key": service.origin.key}
    assert [c["cost"] for c in result["candidates"]] == sorted(c["cost"] for c in result["candidates"])
    assert len(result["candidates"]) == 3
    assert 0 < result["seconds"]["plan"] < result["seconds"]["total"]


def test_a_goal_cloud_and_settings_of_the_request_alone(service, block, question):
    moved = {"state": question["state"], "goal": (block + np.float32([0.1, 0.05, 0])).tolist()}
    there = asked(service, "plan", moved | {"settings": {"samples": 16, "horizon": 2}})["result"]
    assert len(there["strokes"]) == 2
    assert (there["metric"], there["start_distance"]) == ("distance", pytest.approx(np.hypot(0.1, 0.05), abs=2e-3))
    near = {"state": question["state"], "goal_pose": [0.001, 0, 0]}
    assert asked(service, "plan", near)["result"]["strokes"] == []
    assert len(asked(service, "plan", question)["result"]["strokes"]) == 1


def test_a_prediction_is_that_of_python(service, tiny_run, block):
    strokes = [{"start": [-0.2, 0.0], "end": [-0.02, 0.0]}, {"start": [0.0, 0.2], "end": [0.0, 0.02], "mode": "push"}]
    request = {"state": block.tolist(), "strokes": strokes}
    found = asked(service, "predict", request)["result"]["predicted"]
    wanted = load_model(tiny_run).predict(block, Strokes.of([[-0.2, 0.0], [0.0, 0.2]], [[-0.02, 0.0], [0.0, 0.02]], 0))
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    packed = asked(service, "predict", request | {"encoding": "base64", "rest": written(block, "base64")})["result"]
    np.testing.assert_array_equal([points_of(text) for text in packed["predicted"]], wanted)


def test_info_tells_what_is_served(service):
    found = asked(service, "info", b"")["result"]
    assert found["model"] == {"label": "piegraph", "key": service.origin.key}
    assert (found["particles"], found["modes"], found["on_disk"], found["look"]) == (50, ["push"], "same", None)
    assert found["commands"] == ["plan", "predict", "look", "info"]
    assert found["settings"]["samples"] == 12


def test_a_file_on_another_computer_and_its_replacement(tiny_run, tmp_path, question):
    file = tmp_path / "block.h5"
    save_model(tiny_run, file)
    with opened_service(None, str(file)) as service:
        first = asked(service, "plan", question)
        assert all("no stroke is expected to help" in text for text in first["warnings"]), "a tiny model"
        shutil.copy(file, tmp_path / "touched.h5")
        (tmp_path / "touched.h5").replace(file)
        assert asked(service, "info", {})["warnings"] == []
        file.write_bytes(b"half of an")
        again = asked(service, "plan", question)
        assert "the model file is replaced on disk: this is still the one of key" in again["warnings"][-1]
        assert again["result"]["strokes"] == first["result"]["strokes"]
        file.unlink()
        assert asked(service, "info", {})["result"]["on_disk"] == "gone"
    with opened_service(tiny_run, "static") as still:
        assert asked(still, "info", {})["result"]["model"] == {"label": "static", "key": None}


BAD = [
    (b'{"command": "plan", "state": [[NaN, 0, 0]]}', "data", "NaN is no number of JSON"),
    (b'{"command": "plan", "state": [[1e400, 0, 0]], "goal_pose": [0, 0, 0]}', "usage", "point 0 is not finite"),
    (b"{", "data", "not JSON"),
    (b"\x00\xff\xfe\x80", "data", "not JSON"),
    (b"[" * 100_000, "data", "not JSON"),
    (b"1" * 10_000, "data", "not JSON"),
    (b"[1, 2]", "data", "not a JSON object but list"),
    (b" " * (MOST_BYTES + 1), "data", "more than 8 MB"),
    ({"command": "move"}, "usage", "no command 'move'"),
    ({"command": ["plan"]}, "usage", "no command"),
    ({"state": []}, "usage", "no command is named"),
    ({"command": "plan"}, "usage", "the field is missing"),
    ({"command": "info", "verbose": True}, "usage", "unknown field"),
    ({"command": "look", "source": "sequence_0000:0"}, "usage", "no images to look at"),
    ({"command": "look", "source": "../etc"}, "usage", "String should match"),
]
OF_A_PLAN = [
    ({"goal_pose": None}, "data", "one goal is needed"),
    ({"goal": [[0, 0, 0]]}, "data", "one goal is needed"),
    ({"goal_pose": [0.1, 0, 90]}, "usage", "90 degrees are 1.571"),
    ({"smaples": 3}, "usage", "unknown field"),
    ({"settings": {"smaples": 3}}, "usage", "unknown setting"),
    ({"settings": {"goal": "/etc/passwd"}}, "usage", "goal is no setting of a request"),
    ({"settings": {"cameras": "/etc/passwd"}}, "usage", "cameras is no setting of a request"),
    ({"settings": {"samples": 1e12}}, "usage", "at most 100000"),
    ({"settings": {"keep_out": [[5, 6, 5, 6, 0, 1]] * 101}}, "usage", "at most 100 items"),
    ({"candidates": -1}, "usage", "greater than or equal to 0"),
    ({"state": [[1, 2]]}, "usage", "rows of three numbers"),
    ({"state": [[1, 2, 3], [1]]}, "usage", "rows of three numbers"),
    ({"state": [["1", "2", "3"]]}, "usage", "rows of three numbers"),
    ({"state": [[True, False, True]]}, "usage", "rows of three numbers"),
    ({"state": [[None, 0, 0]]}, "usage", "rows of three numbers"),
    ({"state": [[10**30, 0, 0]]}, "usage", "rows of three numbers"),
    ({"state": [[450.0, 0, 0]]}, "usage", "beyond 100 m"),
    ({"state": []}, "usage", "0 points"),
    ({"state": "no base64!"}, "usage", "not base64"),
    ({"state": base64.b64encode(b"12345").decode()}, "usage", "no rows of three float32"),
    ({"state": {"x": 1}}, "usage", "give points as a list"),
    ({"state": [[0.0, 0.0, 0.0]] * 10}, "data", "the model needs 50 or more"),
    ({"settings": {"frame": "robot"}}, "usage", "where the robot stands is not known"),
]


@pytest.mark.parametrize(("request_", "kind", "message"), BAD)
def test_a_bad_request_gets_an_error(service, request_, kind, message):
    _refused(asked(service, None, request_), kind, message)


@pytest.mark.parametrize(("change", "kind", "message"), OF_A_PLAN)
def test_a_bad_plan_gets_an_error_and_the_next_is_served(service, question, change, kind, message):
    _refused(asked(service, "plan", question | change), kind, message)
    assert asked(service, "info", {})["error"] is None


def _refused(found: dict, kind: str, message: str) -> None:
    assert (found["result"], found["error"]["kind"]) == (None, kind)
    assert message in found["error"]["message"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"strokes": []}, "at least 1 item"),
        ({"strokes": [{"start": [0, 0], "end": [0, 0]}]}, "no heading"),
        ({"strokes": [{"start": [0, 0], "end": [0, 1], "mode": "kick"}]}, "'push' or 'pick'"),
        ({"strokes": [{"start": [0, 0], "end": [0, 1e9]}]}, "less than or equal to 100"),
        ({"strokes": [{"start": [0, 0], "end": [0, 1]}] * 1001}, "at most 1000 items"),
        ({"rest": [[0, 0, 0]]}, "a rest shape of 1"),
        ({"state": [[0, 0, 0]]}, "one particle is no object"),
        ({"state": [[0.001 * k, 0, 0] for k in range(1001)]}, "1001 particles"),
    ],
)
def test_bad_predictions(service, block, change, message):
    request = {"state": block.tolist(), "strokes": [{"start": [-0.2, 0], "end": [0, 0]}]}
    assert message in asked(service, "predict", request | change)["error"]["message"]


def test_a_bug_is_an_error_and_not_the_end(service, question, monkeypatch, caplog):
    monkeypatch.setattr("piegraph_cli.service.service.answer", lambda *_, **__: 1 / 0)
    found = asked(service, "plan", question)
    assert (found["error"]["kind"], found["error"]["exit_code"]) == ("bug", 1)
    assert "ZeroDivisionError" in caplog.text
    monkeypatch.undo()
    assert asked(service, "plan", question)["error"] is None


def test_strokes_in_the_robots_frame(service, question):
    T = np.array([[0.0, -1, 0, 0.5], [1, 0, 0, 0.2], [0, 0, 1, -0.1], [0, 0, 0, 1]])
    (here,) = asked(service, "plan", question)["result"]["strokes"]
    told = asked(replace(service, robot=lambda: T), "plan", question | {"settings": {"frame": "robot"}})["result"]
    assert told["frame"] == "robot"
    wanted = np.linalg.inv(T) @ [*here["start"], 0, 1]
    np.testing.assert_allclose(told["strokes"][0]["start"], wanted[:3], atol=1e-6)


def test_a_look_at_a_recording():
    model, read = Model("static", None), []

    def scene(source):
        read.append(source)
        return read_scene(f"{SAMPLE}/{source}")

    service = Service(model, Origin(), eye=Eye(look_settings(), scene, "a recording"))
    found = asked(service, "look", {"source": "sequence_0000:0", "cloud": True, "encoding": "base64"})
    result = found["result"]
    assert (read, result["verdict"], found["error"]) == (["sequence_0000:0"], "doubtful", None)
    assert len(found["warnings"]) == len(result["findings"]) > 0
    assert len(points_of(result["cloud"])) == result["points"] > 500
    assert len(points_of(result["particles"])) == 50
    blind = replace(service, eye=Eye(look_settings(ingest={"workspace": (2, 3, 2, 3, 0, 1)}), scene, "elsewhere"))
    found = asked(blind, "look", {"source": "sequence_0000:0", "cloud": True})
    assert (found["result"]["verdict"], found["result"]["particles"], found["result"]["cloud"]) == ("bad", None, None)
    assert "the look is bad" in found["error"]["message"]


def test_a_recording_is_looked_at_by_its_sequences_alone(tiny_run):
    with opened_service(tiny_run, "static", SAMPLE) as service:
        for name in ("elsewhere:0", "..:0", ".", "sequence_0000:999"):
            found = asked(service, "look", {"source": name})
            assert (found["result"], found["error"]["kind"] in ("usage", "data")) == (None, True), name
    with pytest.raises(DataError, match="no such recording"), opened_service(tiny_run, "static", SAMPLE / "nowhere"):
        pass


def test_a_prediction_of_another_object_is_refused(service, block):
    stroke = {"start": [-0.2, 0.0], "end": [-0.02, 0.0]}
    error = asked(service, "predict", {"state": written(block * 100, "lists"), "strokes": [stroke]})["error"]
    assert "these are centimetres, not metres" in error["message"]
