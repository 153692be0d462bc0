"""End to end on the sample recording: the figures that perception and tracking must reach, golden outputs, the report."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from piegraph_cli.evaluation.truth import mask_iou
from piegraph_cli.recording.images import ImageStack
from piegraph_cli.stages import STAGES, open_run
from piegraph_cli.workspace.artifact import Artifact, read_artifact
from tests.cli import REPOSITORY, SAMPLE, piegraph, piegraph_json
from tests.report.page import Page

GOLDEN = Path(__file__).parent / "golden" / "sample.json"
RECORDED = ("ingest", "hands", "segment", "fuse", "track", "score", "dataset")


def test_figures_against_the_truth(sample_run):
    scores = {row["score"]: row for row in piegraph_json("evaluate", "--run", sample_run)["scores"]}
    assert scores["frames with the hand found"]["mean"] >= 0.95
    assert scores["object mask IoU"]["median"] >= 0.92
    assert scores["end-effector error [mm]"]["median"] <= 10
    assert scores["fused cloud to surface, median [mm]"]["median"] <= 4
    assert scores["tracked particles at stroke ends [mm]"]["mean"] <= 5


def test_every_stroke_of_the_sample_is_found(sample_run):
    truth = sum(
        len(set(read_artifact(p / "truth.h5", "truth")["stroke"]) - {-1}) for p in SAMPLE.iterdir() if p.is_dir()
    )
    assert len(read_artifact(sample_run / "dataset.h5", "dataset")["strokes"]) == truth


def summary(artifact: Artifact) -> dict[str, list]:
    """Shape, mean and deviation of every dataset: equal bytes on one machine, equal numbers on another."""
    rows = {}
    for name, value in artifact.arrays.items():
        numbers = value.astype(float) if value.dtype.kind in "fiub" else np.zeros(1)
        rows[name] = [list(value.shape), float(np.nanmean(numbers)), float(np.nanstd(numbers))]
    return rows


def measured(sample_run: Path) -> dict[str, dict]:
    sequence = sorted(p.name for p in SAMPLE.iterdir() if p.is_dir())[0]
    found = {}
    for name in RECORDED:
        stage = STAGES[name]
        path = open_run(sample_run).path(stage.writes, None if stage.unit == "run" else sequence)
        found[name] = {"version": stage.version, "datasets": summary(read_artifact(path, stage.writes))}
    return found


@pytest.mark.parametrize("name", RECORDED)
def test_golden(sample_run, name):
    """Outputs that change need a new stage version; then `python tests/test_sample.py RUN` writes the golden file anew."""
    golden, found = json.loads(GOLDEN.read_text())[name], measured(sample_run)[name]
    assert found["version"] == golden["version"], "the version was raised: write the golden file anew"
    assert found["datasets"].keys() == golden["datasets"].keys()
    for dataset, (shape, mean, deviation) in golden["datasets"].items():
        message = (
            f"{name} writes another {dataset}: raise its version in stages/__init__.py and write the golden file anew"
        )
        assert found["datasets"][dataset][0][1:] == shape[1:], message
        assert found["datasets"][dataset][0][:1] == pytest.approx(shape[:1], rel=2e-3), message
        assert found["datasets"][dataset][1:] == pytest.approx([mean, deviation], rel=2e-3, abs=2e-4), message


def test_the_report_has_all_sequences_and_plots(sample_run, tmp_path):
    folder = tmp_path / "run with space"
    shutil.copytree(sample_run, folder)
    found = piegraph_json("report", "--run", folder)
    page = Page(Path(found["report"]))
    assert Path(found["report"]) == folder / "report" / "index.html"
    words = {verdict["part"]: verdict["word"] for verdict in found["verdicts"]}
    assert words == dict.fromkeys(("recording", "hands", "masks", "tracks"), "good") | {
        "model": "check",  # one held-out sequence says little
        "plan": words["plan"],
    }
    assert words["plan"] != "not yet"
    assert found["left_out"] == []
    names = sorted(p.name for p in SAMPLE.iterdir() if p.is_dir())
    assert len(page.all("article")) == len(names)
    for name in names:
        pictures = [image for image in page.all("img") if (image["alt"] or "").startswith(name)]
        assert len(pictures) == 3, "a film, all cameras, from above"
        assert all(len(image["src"]) > 20_000 for image in pictures)
    assert len(page.all("svg")) == len(names) + 3 + 1 + 3, "tracks, metrics, the training, episodes of the plan"


def one_sequence(folder: Path) -> Path:
    """A recording of the sample's first sequence alone; returns the sequence."""
    sequence = sorted(p for p in SAMPLE.iterdir() if p.is_dir())[0]
    folder.mkdir()
    shutil.copy(SAMPLE / "cameras.json", folder)
    shutil.copytree(sequence, folder / sequence.name)
    return folder / sequence.name


def test_a_hand_never_seen_is_an_error_that_says_where(tmp_path):
    sequence = one_sequence(tmp_path / "rec")
    for camera in (p for p in sequence.iterdir() if p.is_dir()):
        first = (camera / "color" / "000000.jpg").read_bytes()
        for image in (camera / "color").iterdir():
            image.write_bytes(first)
    run = tmp_path / "run"
    piegraph("ingest", "--run", run, "--recording", tmp_path / "rec")
    done = piegraph("run", "--run", run, "--until", "track", check=3)
    assert "no camera sees a hand in frames 0 to" in done.stderr
    assert sequence.name in done.stderr
    done = piegraph("run", "--run", run, check=3)
    assert "no sequence has tracks" in done.stderr


def test_an_object_never_seen_is_an_error_that_says_where(sample_run, tmp_path):
    one_sequence(tmp_path / "rec")
    run = tmp_path / "run"
    piegraph("ingest", "--run", run, "--recording", tmp_path / "rec", "--workspace", "0.36,0.44,0.36,0.44,-0.02,0.3")
    done = piegraph("run", "--run", run, "--until", "segment", check=3)
    assert "no object found" in done.stderr
    assert "try:" in done.stderr


def test_the_papers_association_is_there_and_tracks_worse(sample_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(sample_run, folder)
    piegraph(
        "run",
        "--run",
        folder,
        "--set",
        "track.association=nearest",
        "--set",
        "train.piegraph.steps=50",
        "--until",
        "evaluate",
    )
    nearest, soft = (
        {r["score"]: r["mean"] for r in piegraph_json("evaluate", "--run", f)["scores"]} for f in (folder, sample_run)
    )
    score = "tracked particles at stroke ends [mm]"
    assert nearest[score] > 2 * soft[score]


def test_segment_anything_masks_the_sample(sample_run, sam_checkpoint, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(sample_run, folder)
    missing = piegraph("segment", "--run", folder, "--segmenter", "sam", check=4)
    assert "piegraph doctor --fetch sam-vit-b" in missing.stderr
    options = ("--segmenter", "sam", "--sam-model", "tiny", "--sam-checkpoint", sam_checkpoint, "--jobs", 2)
    piegraph("segment", "--run", folder, *options)
    overlaps = []
    for path in sorted((folder / "masks").iterdir()):
        masks, truth = read_artifact(path, "masks"), read_artifact(SAMPLE / path.stem / "truth.h5", "truth")
        found = ImageStack(masks["mask"], masks["mask_offsets"], 4, "mask")
        true = ImageStack(truth["object_mask"], truth["object_mask_offsets"], 4, "mask")
        overlaps += [mask_iou(found.mask(f, c), true.mask(f, c)) for f in range(0, len(found), 3) for c in range(4)]
    assert np.median(overlaps) > 0.85


if __name__ == "__main__":
    import sys

    GOLDEN.write_text(json.dumps(measured(Path(sys.argv[1])), indent=1) + "\n")
    print(f"wrote {GOLDEN.relative_to(REPOSITORY)}")
