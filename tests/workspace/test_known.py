"""What is known of files: unchanged ones are not read again, changed ones always, and a damaged record harms nothing."""

import json
import multiprocessing
import os
import pickle
import shutil
from pathlib import Path

import h5py
import pytest

from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.workspace import known, run
from piegraph_cli.workspace.artifact import read_header
from piegraph_cli.workspace.execute import Options, run_chain, run_stage
from piegraph_cli.workspace.known import Known, known_of
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run, content_hash
from piegraph_cli.workspace.survey import status
from tests.cli import piegraph_json
from tests.stages.make_recording import make_recording

INGEST = STAGES["ingest"]


@pytest.fixture
def settled(monkeypatch):
    """As if every file had been written long ago."""
    monkeypatch.setattr(known, "TICK", 0)


@pytest.fixture
def ingested(tmp_path):
    """A run of two read sequences."""
    recording = make_recording(tmp_path / "rec")
    made = Run(tmp_path / "run", Recipe(STAGES, {"ingest": {"recording": str(recording)}}))
    made.save_recipe()
    run_stage(made, INGEST, Options())
    return tmp_path / "run"


@pytest.fixture
def reads(monkeypatch):
    """What is read: paths whose content is hashed, and artifacts whose headers are."""
    found: list[Path] = []

    def noting(work):
        def noted(path, *more):
            found.append(Path(path))
            return work(path, *more)

        return noted

    monkeypatch.setattr(run, "content_hash", noting(run.content_hash))
    monkeypatch.setattr(known, "read_header", noting(known.read_header))
    return found


def states(folder: Path) -> list[str]:
    """States of the sequences, as another process would find them."""
    known._known_of.cache_clear()
    return [row["state"] for row in status(open_run(folder)) if row["stage"] == "ingest"]


def image(folder: Path) -> Path:
    return folder.parent / "rec" / "seq 1" / "front" / "color" / "000002.jpg"


def test_what_has_not_changed_is_not_read_again(ingested, settled, reads, monkeypatch):
    assert states(ingested) == ["fresh"] * 2
    assert {path.name for path in reads} >= {"seq 0", "seq 1", "seq 0.h5"}
    before = (ingested / known.NAME).read_bytes()
    reads.clear()

    def never(*_, **__):
        raise AssertionError("a file is read")

    monkeypatch.setattr(h5py, "File", never)
    monkeypatch.setattr(Path, "read_bytes", never)
    assert states(ingested) == ["fresh"] * 2
    known._known_of.cache_clear()
    assert {o.state for o in run_stage(open_run(ingested), INGEST, Options())} == {"cached"}
    assert reads == []
    monkeypatch.undo()
    assert (ingested / known.NAME).read_bytes() == before


def test_a_touched_file_is_read_again_and_its_key_stays(ingested, settled, reads):
    states(ingested)
    reads.clear()
    os.utime(image(ingested))
    assert states(ingested) == ["fresh"] * 2
    assert [path.name for path in reads] == ["seq 1"]


def test_changed_content_of_the_same_size_and_time_is_noticed(ingested, settled):
    states(ingested)
    path = image(ingested)
    before, data = path.stat(), bytearray(path.read_bytes())
    data[-10] ^= 1
    path.write_bytes(bytes(data))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_mtime_ns == before.st_mtime_ns
    assert states(ingested) == ["fresh", "stale"]


@pytest.mark.parametrize("change", ["added", "removed", "renamed", "cameras"])
def test_other_changes_of_a_recording_are_noticed(ingested, settled, change):
    states(ingested)
    path = image(ingested)
    if change == "added":
        path.with_name("notes.txt").write_text("")
    elif change == "removed":
        path.unlink()
    elif change == "renamed":
        path.rename(path.with_name("000009.jpg"))
    else:
        (ingested.parent / "rec" / "cameras.json").write_text("{}")
    assert states(ingested) == ["stale" if change == "cameras" else "fresh", "stale"]


def test_another_artifact_in_the_place_of_one_is_noticed(ingested, settled):
    states(ingested)
    first, second = (ingested / "frames" / f"seq {i}.h5" for i in (0, 1))
    shutil.copy2(first, second)
    assert states(ingested) == ["fresh", "stale"]


def test_what_changed_just_now_is_read_again_the_next_time(ingested, reads, monkeypatch):
    monkeypatch.setattr(known, "TICK", 3_600_000_000_000)
    assert states(ingested) == ["fresh"] * 2
    assert not (ingested / known.NAME).exists()
    reads.clear()
    assert states(ingested) == ["fresh"] * 2
    assert {path.name for path in reads} >= {"seq 0", "seq 1", "seq 0.h5", "seq 1.h5"}


def test_a_source_that_is_one_file(tmp_path, settled):
    path, taken = tmp_path / "weights.pt", []

    def take() -> str:
        taken.append(path)
        return content_hash(path, "weights")

    path.write_bytes(b"one")
    first = known_of(tmp_path).content(path, take)
    assert known_of(tmp_path).content(path, take) == first == content_hash(path, "weights")
    assert len(taken) == 1
    path.write_bytes(b"two")
    assert known_of(tmp_path).content(path, take) != first


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "[" * 100_000,
        '{"version": 0}',
        "\x00",
        "headers",
        "settings",
        "contents",
        "stamp",
        "index",
    ],
)
def test_a_damaged_record_is_ignored_and_written_anew(ingested, settled, reads, text):
    states(ingested)
    path = ingested / known.NAME
    whole = json.loads(path.read_text())
    if text in whole:
        text = json.dumps(whole | {text: {"frames/seq 0.h5": 3}})
    elif text in ("stamp", "index"):
        row = whole["headers"]["frames/seq 0.h5"]
        row[{"stamp": 0, "index": 7}[text]] = {"stamp": 1.5, "index": 99}[text]
        text = json.dumps(whole)
    path.write_text(text)
    reads.clear()
    assert states(ingested) == ["fresh"] * 2
    assert {path.name for path in reads} >= {"seq 0", "seq 1", "seq 0.h5"}
    assert json.loads(path.read_text()).keys() == whole.keys()


def test_a_record_that_cannot_be_written_is_no_error(ingested, settled):
    (ingested / known.NAME).mkdir()
    assert states(ingested) == ["fresh"] * 2
    (ingested / known.NAME).rmdir()
    ingested.chmod(0o555)
    try:
        assert states(ingested) == ["fresh"] * 2
    finally:
        ingested.chmod(0o755)


def test_reading_everything_again(ingested, settled):
    states(ingested)
    path = ingested / known.NAME
    wrong = json.loads(path.read_text())
    for place, (fingerprint, _) in wrong["contents"].items():
        wrong["contents"][place] = [fingerprint, "0" * 64]
    path.write_text(json.dumps(wrong))
    assert states(ingested) == ["stale"] * 2
    opened = open_run(ingested)
    opened.known.forget()
    assert [row["state"] for row in status(opened) if row["stage"] == "ingest"] == ["fresh"] * 2
    assert states(ingested) == ["fresh"] * 2


def test_what_is_forgotten_does_not_come_back_with_what_others_kept(ingested, settled):
    states(ingested)
    path, places = ingested / known.NAME, [f"frames/seq {i}.h5" for i in (0, 1)]
    mine = Known(ingested)
    mine.forget()
    wrong = json.loads(path.read_text())
    wrong["headers"][places[1]][5] = "another key"
    path.write_text(json.dumps(wrong))
    first, second = (str(ingested / place) for place in places)
    mine.header(places[0], first, "frames")
    mine.save()
    found = mine.header(places[1], second, "frames")
    assert found is not None
    assert found.key == read_header(Path(second), "frames").key


def test_the_option_to_read_everything_again(ingested):
    found = piegraph_json("status", "--run", ingested, "--rehash")["stages"]
    assert found[0]["stage"] == "ingest"
    assert found[0]["fresh"] == 2


def test_a_moved_run_keeps_what_it_knows(ingested, settled, reads):
    states(ingested)
    moved = ingested.rename(ingested.with_name("moved run"))
    reads.clear()
    assert states(moved) == ["fresh"] * 2
    assert reads == []


def test_a_moved_recording_is_read_again_and_keeps_its_keys(ingested, settled, reads):
    states(ingested)
    (ingested.parent / "rec").rename(ingested.parent / "elsewhere")
    opened = open_run(ingested)
    opened.recipe = opened.recipe.with_values(INGEST, {"recording": "../elsewhere"}, "test", ingested)
    opened.save_recipe()
    reads.clear()
    assert states(ingested) == ["fresh"] * 2
    assert {path.parent.name for path in reads if path.suffix != ".h5"} == {"elsewhere"}


def test_a_run_works_through_its_recording_once(ingested, settled, reads):
    reads.clear()
    outcomes = run_chain(open_run(ingested), "ingest", Options())
    assert {o.state for o in outcomes} == {"cached"}
    hashed = [path for path in reads if path.suffix != ".h5"]
    assert len(hashed) == len(set(hashed)) == 2


def test_copies_of_a_run_in_other_processes_share_what_is_known(ingested):
    opened = open_run(ingested)
    assert pickle.loads(pickle.dumps(opened)).known is opened.known
    assert Run(ingested.parent / "." / "run", opened.recipe).known is opened.known


def test_processes_of_a_run_profit(tmp_path, settled):
    recording = make_recording(tmp_path / "rec", sequences=3)
    made = Run(tmp_path / "run", Recipe(STAGES, {"ingest": {"recording": str(recording)}}))
    made.save_recipe()
    run_stage(made, INGEST, Options(jobs=2))
    kept = json.loads((tmp_path / "run" / known.NAME).read_text())
    assert len(kept["contents"]) == 3
    assert states(tmp_path / "run") == ["fresh"] * 3


def keep_many(folder: Path, files: list[Path]) -> None:
    known.TICK = 0
    for file in files:
        mine = Known(folder)
        mine.content(file, lambda file=file: content_hash(file, "file"))
        mine.save()


def test_several_processes_write_at_the_same_time(tmp_path):
    folder, files = tmp_path / "run", [tmp_path / f"{i}.bin" for i in range(60)]
    folder.mkdir()
    for i, file in enumerate(files):
        file.write_text(str(i))
    spawn = multiprocessing.get_context("spawn")
    workers = [spawn.Process(target=keep_many, args=(folder, files[k::3])) for k in range(3)]
    for worker in workers:
        worker.start()
    while any(worker.is_alive() for worker in workers):
        if (folder / known.NAME).exists():
            json.loads((folder / known.NAME).read_text())
    assert [worker.exitcode for worker in workers] == [0, 0, 0]
    contents = json.loads((folder / known.NAME).read_text())["contents"]
    assert len(contents) >= 20
    assert all(found == content_hash(Path(place), "file") for place, (_, found) in contents.items())
    assert [path.name for path in folder.iterdir()] == [known.NAME]


def test_a_robot_that_is_found_and_sequences_left_out_change_nothing(tmp_path):
    sequence = tmp_path / "rec" / "take"
    sequence.mkdir(parents=True)
    file = sequence.parent / "cameras.json"
    written = []
    for beside in (
        {},
        {"calibration_sequence": "board"},
        {"calibration_sequence": ["a", "b"], "T_world_robot": [[1.0]]},
    ):
        file.write_text(json.dumps({"version": 1, "cameras": {"a": 0.1}} | beside, indent=1) + "\n")
        written.append(content_hash(sequence, "recording"))
    assert len(set(written)) == 1
    for text in ('{"version": 1, "cameras": {"a": 0.2}, "T_world_robot": 1}', '["T_world_robot"]', '{"T_world_robot"'):
        file.write_text(text)
        written.append(content_hash(sequence, "recording"))
    assert len(set(written)) == 4


def test_what_lies_behind_links_counts_and_loops_end(tmp_path, settled):
    sequence, elsewhere = tmp_path / "rec" / "sequence_0000", tmp_path / "disk" / "cam0"
    elsewhere.mkdir(parents=True)
    sequence.mkdir(parents=True)
    (elsewhere / "0.png").write_bytes(b"one")
    (sequence / "cam0").symlink_to(elsewhere)
    for name, target in (("up", ".."), ("root", "/"), ("self", "self"), ("again", elsewhere)):
        (sequence / name).symlink_to(target)
    (elsewhere / "back").symlink_to(sequence)

    def content():
        return Known(tmp_path).content(sequence, lambda: content_hash(sequence, "recording"))

    before = content()
    assert before == content()
    (elsewhere / "0.png").write_bytes(b"two")
    assert content() != before
    assert [name for name, _ in known.files_below(str(sequence))] == ["again/0.png"]


def test_names_that_are_no_text_are_names(tmp_path):
    name = os.fsdecode(b"a\xff.png")
    (tmp_path / name).write_bytes(b"one")
    assert content_hash(tmp_path, "recording") != content_hash(tmp_path / name, "recording")
