"""A short attack of fixed seeds, and cases of what longer ones found."""

import errno
import json
import os
import signal
import struct
import subprocess
import sys
import time
import zipfile
import zlib

import cv2
import h5py
import numpy as np
import pytest

from piegraph_cli.errors import DataError, UsageError
from piegraph_cli.experiments.recipes import with_changes
from piegraph_cli.files import refused as refused_by
from piegraph_cli.recording.encoded import MOST_PIXELS, declared_size, decode_image
from piegraph_cli.recording.layout import read_cameras, write_times
from piegraph_cli.recording.params import ReadParams
from piegraph_cli.recording.sequence import read_sequence
from piegraph_cli.recording.text import MOST_BYTES, parse_number, read_numbers, read_text
from piegraph_cli.recording.timing import align_frames, check_times
from piegraph_cli.stages import STAGES
from piegraph_cli.stages.import_tracks import read_h5
from piegraph_cli.stages.points import read_points
from piegraph_cli.workspace import probe
from piegraph_cli.workspace.artifact import read_artifact, read_header
from piegraph_cli.workspace.recipe import load_recipe
from piegraph_cli.workspace.schema import SCHEMAS
from tests.attack import engine, texts
from tests.attack.attacks import GROUPS, motion
from tests.attack.engine import Attack, Tally, run_attack
from tests.attack.hostile import HOSTILE, OF_ARTIFACTS, make_hostile
from tests.attack.samples import arrays_of, write_sample
from tests.cli import piegraph
from tests.hdf5 import reseal, unsealed
from tests.stages.make_recording import make_cameras, make_recording

SHORT = {"artifacts": 3, "files": 6, "recordings": 3, "texts": 12}


@pytest.mark.parametrize("group", GROUPS)
def test_a_short_attack_finds_no_fault(tmp_path, group):
    for k, attack in enumerate(GROUPS[group]()):
        tally = Tally()
        run_attack(attack, iter(range(1000 * k, 1000 * k + SHORT[group])), tmp_path / str(k), tally)
        assert sum(tally.counts.values()) == SHORT[group]
        assert not tally.faults, attack.name


@pytest.mark.parametrize(
    ("read", "outcome"),
    [
        (lambda path: 1 / 0, "traceback"),
        (lambda path: os.kill(os.getpid(), signal.SIGKILL), "crash"),
        (lambda path: time.sleep(60), "hang"),
        (lambda path: path.read_bytes(), "differs"),
        (lambda path: np.ones(60 << 17).sum(), "memory"),
    ],
)
def test_faults_are_found(tmp_path, monkeypatch, read, outcome):
    monkeypatch.setattr(engine, "MOST", 30 << 20)
    monkeypatch.setattr(engine, "SLOWEST", 3.0)

    def reads(path):
        return read(path) if path.read_bytes() == b"changed" else 1

    def change(path, rng):
        path.write_bytes(b"changed")
        return "all of it"

    def make(folder):
        (folder / "file").write_bytes(b"whole")
        return folder / "file"

    tally = Tally()
    run_attack(Attack("any", make, change, reads, sealed=True), iter(range(2)), tmp_path, tally)
    assert tally.counts == {outcome: 2}
    assert len(tally.faults) == 2


@pytest.mark.parametrize("kind", SCHEMAS)
def test_a_sample_of_every_kind_is_whole(tmp_path, kind):
    found = read_artifact(write_sample(tmp_path / "a.h5", kind), kind)
    assert found.arrays.keys() == arrays_of(kind).keys()


@pytest.mark.parametrize("how", HOSTILE)
def test_what_strangers_send_is_refused_before_a_value_is_read(tmp_path, how):
    path = write_sample(tmp_path / "tracks.h5", "tracks")
    make_hostile(path, how, "positions")
    reseal(path)
    with pytest.raises(DataError) as refused:
        read_artifact(path, "tracks")
    assert str(path) in str(refused.value)
    assert refused.value.hint
    motions = tmp_path / "take.h5"
    with h5py.File(motions, "w") as file:
        for name, value in motion().items():
            file[name] = value
    make_hostile(motions, how, "particles")
    if how in OF_ARTIFACTS:
        np.testing.assert_array_equal(read_h5(motions)["particles"], motion()["particles"])
    else:
        with pytest.raises(DataError, match="dataset particles"):
            read_h5(motions)


def test_a_pipe_and_a_device_are_no_artifacts(tmp_path):
    os.mkfifo(tmp_path / "pipe.h5")
    (tmp_path / "zero.h5").symlink_to("/dev/zero")
    for name in ("pipe.h5", "zero.h5"):
        assert read_header(tmp_path / name, "tracks") is None
        with pytest.raises(DataError, match="not a regular file"):
            read_artifact(tmp_path / name)


def png(width: int, height: int, length: int | None = None) -> bytes:
    """A PNG that says it has so many pixels, and has none."""

    def part(kind: bytes, data: bytes, length: int | None = None) -> bytes:
        size = len(data) if length is None else length
        return struct.pack(">I", size) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = part(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + part(b"IDAT", zlib.compress(b"\0" * 100), length) + part(b"IEND", b"")


def test_images_are_what_they_say_before_they_are_decoded(monkeypatch):
    image = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    whole = {suffix: cv2.imencode(suffix, image)[1].tobytes() for suffix in (".png", ".jpg", ".bmp", ".webp")}
    for suffix in (".png", ".jpg"):
        assert declared_size(memoryview(whole[suffix])) == (60, 40)
        assert decode_image(whole[suffix], cv2.IMREAD_COLOR).shape == (40, 60, 3)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("was decoded"))
    refused = {
        "it says that it is 100000 x 100000": png(100_000, 100_000),
        "it says that it is 20000 x 20000": png(20_000, 20_000),
        f"at most {MOST_PIXELS} pixels": png(0, 5),
        "do not fit together": png(20, 20, 2**31),
        "it is empty": b"",
        "neither JPEG nor PNG": whole[".bmp"],
        "is neither": whole[".webp"],
        "cut off": whole[".png"][:-20],
    }
    for message, data in refused.items():
        with pytest.raises(ValueError, match=message):
            decode_image(data, cv2.IMREAD_COLOR)


@pytest.mark.parametrize(
    "word", ["1_000", "٣", "0x10", "1,5", "1e", "", "--1", "1e400", "1e308", "nan", "-inf", "9" * 400]
)
def test_words_that_are_no_numbers(tmp_path, word):
    with pytest.raises(ValueError, match=r"is no number|is too large|not a finite number"):
        parse_number(word)
    if word:
        (tmp_path / "t.txt").write_text(f"# times\n0\n\n{word}\n", encoding="utf-8")
        with pytest.raises(DataError, match=r"t.txt, line 4: "):
            read_numbers(tmp_path / "t.txt", "hint")


def test_numbers_are_read_as_python_writes_them(tmp_path):
    values = [0.0, -1.5, 1e-20, 1700000000.123456, 17e17, 5e-324, 0.1]
    (tmp_path / "t.txt").write_bytes("\ufeff".encode() + "\r\n".join(map(repr, values)).encode())
    assert read_numbers(tmp_path / "t.txt", "hint").tolist() == values
    assert np.isnan(parse_number(" NaN ", bounded=False))
    assert parse_number("-1e308", bounded=False) == -1e308
    with (tmp_path / "large.txt").open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(DataError, match="has more than"):
        read_text(tmp_path / "large.txt", "hint")


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (np.arange(4) * 4.9 + 2e11, "go from 2e"),
        (np.arange(20_000) * 4.9, "go from 0 to 97995.1 s"),
        (np.array([0, 0.2, 0.4, 1.7e9]), "leap"),
        (np.array([0, 1e308, 1.1e308]), "are these nanoseconds"),
    ],
)
def test_times_that_no_recording_has(times, message):
    with pytest.raises(DataError, match=message):
        check_times(times, "here")


def test_many_frames_at_uneven_times_take_no_memory():
    times = np.cumsum(np.r_[np.full(6000, 0.001), np.full(6000, 7.0)])
    clock, source, _ = align_frames({"a": times}, 30.0, 0.05, "here")
    assert len(clock) == len(source) < 12_000


def test_a_camera_of_a_long_name_is_refused_and_files_of_desktops_are_nobodys(tmp_path):
    recording = make_recording(tmp_path / "rec", 1)
    sequence = recording / "seq 0"
    for path in [p for p in sequence.rglob("*") if p.is_file()]:
        path.with_name(f"._{path.name}").write_bytes(b"\0\5\26\7")
    arrays, warnings = read_sequence(sequence, ReadParams())
    assert len(arrays["time"]) == 4
    assert not warnings
    text = (recording / "cameras.json").read_text()
    (recording / "cameras.json").write_text(text.replace("left cam", "l" * 300))
    with pytest.raises(DataError, match="at most 100 bytes") as refused:
        read_sequence(sequence, ReadParams())
    assert len(str(refused.value)) < 400


def test_a_wrong_number_of_distortions_is_its_cameras_error(tmp_path):
    recording = make_recording(tmp_path / "rec", 1)
    file = json.loads((recording / "cameras.json").read_text())
    file["cameras"]["left cam"]["distortion"] = [0.0] * 7
    (recording / "cameras.json").write_text(json.dumps(file))
    with pytest.raises(DataError, match="distortion must be 4, 5, 8, 12 or 14") as refused:
        read_cameras(recording / "seq 0")
    assert "camera left cam" in refused.value.where


def test_times_from_a_pipe_are_refused(tmp_path):
    recording, camera = make_recording(tmp_path / "rec", 1), make_cameras()[0]
    path = recording / "seq 0" / camera.name / "timestamps.txt"
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(DataError, match=r"timestamps.txt: .*no regular file"):
        read_sequence(recording / "seq 0", ReadParams())
    path.unlink()
    write_times(recording / "seq 0", camera, np.arange(4) / 5)
    read_sequence(recording / "seq 0", ReadParams())


def test_what_breaks_or_stops_hdf5_is_an_error(tmp_path, monkeypatch):
    """Whatever the file is: here a process that is told to be such."""
    path = write_sample(tmp_path / "tracks.h5", "tracks")
    read_artifact(path, foreign=True)
    for wrong, message in (("sys.stdin.readline(); os.abort()", "breaks what"), ("time.sleep(60)", "takes too long")):
        command = [sys.executable, "-c", f"import os, sys, time; print('{{}}', flush=True); {wrong}"]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        monkeypatch.setattr(probe, "_running", [(os.getpid(), process)])
        monkeypatch.setattr(probe, "SECONDS", 2.0)
        assert probe._answer(process, 60.0) == {}
        with pytest.raises(DataError, match=f"no whole HDF5 file: it {message}"):
            read_artifact(path, foreign=True)
        assert process.poll() is not None
    monkeypatch.setattr(probe, "SECONDS", 60.0)
    monkeypatch.setattr(probe, "_running", [])
    read_artifact(path, foreign=True)
    assert len(probe._running) == 1
    unsealed(path, 1)
    assert read_header(path, "tracks") is not None


def test_an_npz_that_unpacks_to_far_more_than_it_has_is_refused(tmp_path):
    with (
        zipfile.ZipFile(tmp_path / "goal.npz", "w", zipfile.ZIP_DEFLATED) as file,
        file.open("points.npy", "w") as member,
    ):
        np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": (12_000_000, 3)})
        for _ in range(9):
            member.write(bytes(32_000_000))
    with pytest.raises(DataError, match="unpacks to 288"):
        read_points(tmp_path / "goal.npz", None)


def test_a_recipe_that_is_no_file_or_without_end_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "deep.toml").write_text("[ingest]\nrecording = " + "[" * 100_000)
    (tmp_path / "null.toml").write_text('[ingest]\nrecording = "a\\u0000b"\n')
    (tmp_path / "long.toml").write_text(f"[plan]\nsamples = {'9' * 5000}\n")
    (tmp_path / "latin.toml").write_bytes('[ingest]\nrecording = "\xe4"\n'.encode("latin-1"))
    for name, message in (
        ("pipe.toml", "not a regular file"),
        ("deep.toml", "not a readable TOML file"),
        ("null.toml", "a path that cannot be"),
        ("long.toml", "not a readable TOML file"),
        ("latin.toml", "not a readable TOML file"),
    ):
        with pytest.raises(UsageError, match=message):
            load_recipe(tmp_path / name, STAGES)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"plan.samples={'9' * 5000}", "cannot read --set plan.samples"),
        (f"evaluate.horizons={'[' * 3000}", "cannot read --set evaluate.horizons"),
        (f"plan.samples={'9' * 4000}", "samples: more than 9223372036854775807"),
        (f"train.piegraph.seeds=[{'9' * 4000}]", "train"),
        (f"trials.models={'9' * 20}", "trials.models"),
        ("ingest.recording=rec\udcff", "no UTF-8 text"),
        ("dataset.test_names=a,\udcff", "no UTF-8 text"),
        ("simulate.sequences=100000000", "simulate.sequences"),
        ("trials.goals=100000000", "trials.goals"),
    ],
)
def test_settings_that_no_recipe_can_hold(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        texts.settled([text], tmp_path)


def test_an_experiment_is_changed_by_what_can_be_read():
    for text in ("trials.seeds=" + "9" * 5000, "trials.seeds=" + "[" * 3000, "trials.seeds"):
        with pytest.raises(UsageError, match=r"cannot read --set trials\.seeds"):
            with_changes({}, [text])


def test_a_request_of_a_number_without_end_is_refused(tmp_path):
    request = tmp_path / "plan.json"
    request.write_text(json.dumps(texts.JSONS["plan"] | {"settings": {"samples": 10**4000}}))
    with pytest.raises(DataError, match="more than 9223372036854775807"):
        texts.read_request(request)


@pytest.mark.parametrize(
    ("number", "code", "said"),
    [
        (errno.EACCES, 3, "cannot be used: Permission denied"),
        (errno.EIO, 3, "cannot be used: Input/output error"),
        (errno.ENAMETOOLONG, 2, "cannot be a file"),
        (errno.ENOSPC, 3, "cannot be written"),
    ],
)
def test_what_a_file_system_refuses_is_no_bug(number, code, said):
    told = refused_by(OSError(number, os.strerror(number), "x" * 300), "here")
    assert told.exit_code == code
    assert said in told.message
    assert refused_by(OSError(number, os.strerror(number)), "here").where == "here"
    assert refused_by(OSError(errno.ENOENT, "No such file"), "here") is None
    assert refused_by(ValueError("another"), "here") is None


def test_a_name_that_is_too_long_is_said(tmp_path):
    for words in (("status", "--run"), ("ingest", "--run", tmp_path / "run", "--recording")):
        done = piegraph(*words, "x" * 300, check=2)
        assert "File name too long" in done.stderr
        assert "Traceback" not in done.stderr
