"""`record` and `look --live` with cameras of a made-up make: what is written, and what is said when things go wrong."""

import json
import shutil
import time
import urllib.error
import urllib.request
from dataclasses import replace

import numpy as np
import pytest

from piegraph_cli import open_cameras
from piegraph_cli.capture import cameras, disk, folder, live, session, take
from piegraph_cli.capture.cameras import Mode, choose
from piegraph_cli.capture.preview import Preview
from piegraph_cli.capture.station import Station
from piegraph_cli.errors import DataError, MissingError, UsageError
from piegraph_cli.recording.layout import read_cameras_file
from piegraph_cli.recording.params import IngestParams
from piegraph_cli.recording.sequence import read_sequence
from tests.capture.made_up import MadeUp
from tests.commands.inside import piegraph, piegraph_json

SIZE = ("--size", "64x48", "--fps", 50, "--port", 0, "--countdown", 0)
POSE = [[1.0, 0, 0, 0.1], [0, -1, 0, 0], [0, 0, -1, 0.8], [0, 0, 0, 1]]


@pytest.fixture
def plugged(monkeypatch):
    """`plugged(camera, ...)`: the cameras that are there."""

    def plug(*found: MadeUp) -> None:
        for module in (cameras, live):
            monkeypatch.setattr(module, "connected", lambda: list(found))

    monkeypatch.setattr(disk, "PROBE", 1)
    return plug


def record(folder, *options, check=0):
    return piegraph_json("record", folder, *SIZE, "--takes", 1, "--seconds", 0.3, *options, check=check)


def test_takes_become_sequences_that_ingest_reads(plugged, tmp_path):
    plugged(one := MadeUp("11"), two := MadeUp("22"))
    found = record(tmp_path / "mine", "--cameras", "front=22,left=11", "--takes", 2, "--seconds", 0.6)
    assert [t["sequence"] for t in found["takes"]] == ["sequence_0000", "sequence_0001"]
    assert not one.running
    assert not two.running
    assert sorted(found["uncalibrated"]) == ["front", "left"]
    assert "--board" in found["next"]
    file = read_cameras_file(tmp_path / "mine" / "cameras.json")
    assert {name: entry.serial for name, entry in file.cameras.items()} == {"front": "22", "left": "11"}
    for entry in file.cameras.values():
        entry.T_world_camera = POSE
    (tmp_path / "mine" / "cameras.json").write_text(file.model_dump_json(exclude_none=True))
    arrays, warnings = read_sequence(tmp_path / "mine" / "sequence_0001", IngestParams(fps=50))
    assert warnings == []
    assert len(arrays["time"]) >= 12
    np.testing.assert_allclose(np.diff(arrays["time"]), 0.02, atol=1e-3)
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {"cameras.json", "sequence_0000", "sequence_0001"}


def test_poses_stay_with_the_cameras_that_they_are_of(plugged, tmp_path):
    plugged(MadeUp("11"), MadeUp("22"))
    found = record(tmp_path, "--board")
    assert found["next"].startswith("piegraph calibrate")
    path = tmp_path / "cameras.json"
    file = read_cameras_file(path)
    file.cameras["cam0"].T_world_camera = file.cameras["cam1"].T_world_camera = POSE
    path.write_text(file.model_dump_json(exclude_none=True))
    plugged(MadeUp("22"), MadeUp("11"))
    assert record(tmp_path)["uncalibrated"] == []
    assert read_cameras_file(path).cameras["cam0"].serial == "11"
    assert "is there already" in piegraph("record", tmp_path, *SIZE, "--board", check=2).stderr
    plugged(MadeUp("11"), MadeUp("33"))
    said = piegraph("record", tmp_path, *SIZE, "--takes", 1, "--seconds", 0.3, "--cameras", "cam0=11,cam1=33", check=2)
    assert "its sequences have cam1 as 22, 64 x 48; now it is 33" in said.stderr
    for name in ("board", "sequence_0000"):
        shutil.rmtree(tmp_path / name)
    assert record(tmp_path, "--cameras", "cam0=11,cam1=33")["uncalibrated"] == ["cam1"]


def test_a_camera_that_stops_ends_the_take_which_is_kept(plugged, tmp_path):
    plugged(MadeUp("11"), MadeUp("22", stops_after=30))
    said = piegraph("record", tmp_path, *SIZE, "--takes", 2, "--seconds", 5, check=3)
    assert "camera 22 has stopped delivering" in said.stderr
    assert "sequence_0000: 0." in said.stdout
    stamps = [(tmp_path / "sequence_0000" / c / "timestamps.txt").read_text().split() for c in ("cam0", "cam1")]
    images = [len(list((tmp_path / "sequence_0000" / c / "color").iterdir())) for c in ("cam0", "cam1")]
    assert [len(s) for s in stamps] == images
    assert abs(images[0] - images[1]) <= 2


def test_frames_that_were_dropped_are_counted(plugged, tmp_path):
    plugged(MadeUp("11", skips=(20, 21)))
    (row,) = record(tmp_path)["takes"]
    assert row["dropped"] == {"cam0": 2}


def station_of(*found: MadeUp) -> Station:
    return Station({f"cam{n}": camera for n, camera in enumerate(found)}, Mode(64, 48, 50))


def session_in(station: Station, recording, typed: list[str]):
    """A session in which these lines are typed, one at each look at the keyboard; the words are kept."""
    said: list[str] = []
    models = {name: replace(model, name=name) for name, model in station.models.items()}
    made = session.Session(station, recording, models, None, said.append)
    lines = iter(typed)
    made._typed = lambda: next(lines, "q")
    return made, said


def test_keys_begin_end_drop_and_quit(tmp_path):
    with station_of(MadeUp("11")) as station:
        made, said = session_in(station, tmp_path, ["", *[None] * 4, "", "", *[None] * 4, "d", "q"])
        made.run(None, None, 0)
    assert [(t.sequence, t.kept) for t in made.taken] == [("sequence_0000", True), ("sequence_0001", False)]
    assert "sequence_0001: dropped" in said
    assert [path.name for path in tmp_path.iterdir()] == ["sequence_0000"]


def test_ctrl_c_keeps_what_was_taken(tmp_path, monkeypatch):
    with station_of(MadeUp("11")) as station:
        made, said = session_in(station, tmp_path, [])

        def interrupt():
            if station.latest["cam0"].time > begin + 0.2:
                raise KeyboardInterrupt

        begin, made._typed = station.latest["cam0"].time, interrupt
        made.run(3, 5.0, 0)
    assert "interrupted: what was taken is kept" in said
    (done,) = made.taken
    assert done.kept
    assert (tmp_path / "sequence_0000" / "cam0" / "timestamps.txt").is_file()


def test_a_full_disk_ends_the_take_and_says_so(plugged, tmp_path, monkeypatch):
    plugged(MadeUp("11"))
    written = take.write_frame

    def full(folder, camera, frame, *images):
        if frame == 5:
            raise OSError(28, "No space left on device")
        written(folder, camera, frame, *images)

    monkeypatch.setattr(take, "write_frame", full)
    said = piegraph("record", tmp_path, *SIZE, "--takes", 2, "--seconds", 5, check=3)
    assert "frame 5 of cam0 cannot be written: No space left on device" in said.stderr
    assert len(list((tmp_path / "sequence_0000" / "cam0" / "color").glob("*.jpg"))) == 5


def test_a_disk_that_cannot_keep_up_is_refused(tmp_path):
    load = disk.Load(needed=90.0, speed=50.0, free=1e6, cores=0.5, available=2)
    with pytest.raises(DataError, match="90 MB a second, this disk takes 50"):
        disk.check(load, tmp_path, None)
    with pytest.raises(DataError, match="enough for 2 s"):
        disk.check(replace(load, speed=500.0, free=180.0), tmp_path, 10.0)
    assert "hardly more" in disk.check(replace(load, speed=100.0), tmp_path, None)[0]
    assert "of 2 cores" in disk.check(replace(load, speed=900.0, cores=1.9), tmp_path, None)[0]
    assert disk.check(replace(load, speed=900.0), tmp_path, None) == []


@pytest.mark.parametrize(
    ("wanted", "error", "text"),
    [
        ("3", MissingError, "3 cameras are asked for, 2 found"),
        ("front=99", MissingError, "camera 99 is not plugged in"),
        ("a=11,a=22", UsageError, "two cameras have one name"),
        ("a=11,b=11", UsageError, "or one has two"),
        ("../x=11", UsageError, "no name for a camera"),
    ],
)
def test_cameras_that_cannot_be_chosen(wanted, error, text):
    with pytest.raises(error, match=text):
        choose([MadeUp("11"), MadeUp("22")], wanted, {})


def test_names_of_cameras():
    found = [MadeUp("11"), MadeUp("22"), MadeUp("33")]
    assert {n: c.serial for n, c in choose(found, None, {"22": "cam0"}).items()} == {
        "cam1": "11",
        "cam0": "22",
        "cam2": "33",
    }
    assert list(choose(found, "1", {"22": "front"})) == ["front"]
    assert {n: c.serial for n, c in choose(found, "left=33,11", {}).items()} == {"left": "33", "cam0": "11"}


def test_folders_that_are_no_recordings(plugged, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="no recording, and not empty"):
        folder.known_cameras(tmp_path)
    with pytest.raises(UsageError, match="is a file"):
        folder.known_cameras(tmp_path / "notes.txt")
    plugged(MadeUp("11"))
    new = tmp_path / "new"
    (new / ".sequence_0000.part").mkdir(parents=True)
    said = piegraph("record", new, *SIZE, "--takes", 1, "--seconds", 0.3)
    assert ".sequence_0000.part is what a take left that was killed" in said.stderr
    assert (new / "sequence_0001").is_dir()
    assert "nobody says when a take ends" in piegraph("record", new, *SIZE, "--takes", 1, check=2).stderr
    assert (
        "cannot read --size" in piegraph("record", new, "--size", "big", "--takes", 1, "--seconds", 1, check=2).stderr
    )


def test_the_live_picture_is_for_this_machine():
    with station_of(MadeUp("11")) as station, Preview(station.latest, ["cam0"], lambda: "ready", 0) as preview:
        page = urllib.request.urlopen(preview.url, timeout=5).read().decode()
        assert 'src="/cam0.mjpg"' in page
        assert json.loads(urllib.request.urlopen(preview.url + "state", timeout=5).read()) == {"state": "ready"}
        with urllib.request.urlopen(preview.url + "cam0.mjpg", timeout=5) as stream:
            head = stream.read(200)
        assert b"image/jpeg" in head
        assert b"\xff\xd8" in head
        for path, host in (("none.mjpg", None), ("", "evil.example:80")):
            request = urllib.request.Request(preview.url + path, headers={"Host": host} if host else {})
            with pytest.raises(urllib.error.HTTPError):
                urllib.request.urlopen(request, timeout=5)
        with pytest.raises(UsageError, match=f"port {preview.port} cannot be used"):
            Preview(station.latest, ["cam0"], lambda: "", preview.port)


def test_a_live_look_takes_calibrated_cameras(plugged, tmp_path):
    plugged(MadeUp("11"), MadeUp("22"))
    record(tmp_path)
    with pytest.raises(DataError, match="T_world_camera is missing"):
        open_cameras(tmp_path)
    path = tmp_path / "cameras.json"
    file = read_cameras_file(path)
    for entry in file.cameras.values():
        entry.T_world_camera = POSE
    path.write_text(file.model_dump_json(exclude_none=True))
    with open_cameras(tmp_path, fps=50) as opened:
        first, second = opened.scene(), opened.scene()
    assert [camera.name for camera in first.cameras] == ["cam0", "cam1"]
    assert first.cameras[0].T_world_camera[0, 3] == 0.1
    assert (second.color[0] != first.color[0]).any()
    said = piegraph("look", tmp_path, "--live", check=3)
    assert said.stdout.startswith("bad: 0 points")  # the wall is no object
    plugged(MadeUp("11"))
    assert "camera 22 is not plugged in" in piegraph("look", tmp_path, "--live", check=4).stderr
    path.write_text(file.model_dump_json(exclude_none=True).replace(',"serial":"11"', ""))
    assert "no serial number" in piegraph("look", tmp_path, "--live", check=3).stderr


def test_times_that_do_not_belong_together_are_refused():
    with (
        station_of(MadeUp("11"), MadeUp("22", delay=0.5)) as station,
        pytest.raises(DataError, match="ms behind cam1"),
    ):
        station.shots()


@pytest.mark.parametrize(("behind", "waits"), [(1.0, True), (3600.0, False)])
def test_shots_are_handed_on_from_one_moment_of_all_cameras(behind, waits):
    """What a camera had taken before, and its thread brings late, has no partner; clocks that disagree tell no moment."""
    got: dict[str, list[float]] = {"cam0": [], "cam1": []}
    with station_of(MadeUp("11", delay=-behind), MadeUp("22")) as station:
        begin = time.time()
        station.hand_to(lambda name, shot: got[name].append(shot.time + (behind if name == "cam0" else 0) - begin))
        station.wait(lambda: min(map(len, got.values())) >= 1, 5)
        station.hand_to(None)
    assert (got["cam0"][0] > 0.8) == waits
    assert got["cam1"][0] < 0.8
