"""A recording from its rendering to its scores, in this process: what each stage hands to the core, and what it keeps.

What renders, detects and segments is replaced by what is known of a scene of two cameras; the rest is real.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from piegraph_cli.environments import hand as hands_of_environments
from piegraph_cli.environments import recording as rendering
from piegraph_cli.environments import rig
from piegraph_cli.environments.params import RecordingParams, SimulateParams
from piegraph_cli.errors import DataError, MissingError, UsageError
from piegraph_cli.evaluation import truth
from piegraph_cli.perception import clouds, hands, object_masks, sam, sam_models, seeds, segmentation
from piegraph_cli.perception.params import FuseParams, SegmentParams
from piegraph_cli.recording.images import ImageStack, encode_masks
from piegraph_cli.recording.layout import read_cameras, read_times
from piegraph_cli.stages import STAGES, evaluate, fuse, open_run, score, segment, simulate, track
from piegraph_cli.stages.images import cameras_of, color_of, depth_of, source_frames, workspace_of
from piegraph_cli.text import plain
from piegraph_cli.workspace.artifact import read_artifact
from piegraph_cli.workspace.execute import Options, run_chain, run_stage
from piegraph_cli.workspace.recipe import Recipe
from piegraph_cli.workspace.run import Run
from tests.evaluation.test_metrics import BOX, FACES
from tests.perception.scene import WORKSPACE, pushing_sequence, ring_camera
from tests.stages.chain import artifact, context

FRAMES = 7
NAMES = ("east", "north")
MODEL = {"hand_model": "hand.task"}
TRACK = {"particles": 8, "tracked": 12, "points": 60, "rounds": 3}


@pytest.fixture(scope="module")
def scene():
    """Cameras, views [frame][camera], hands [F, 21, 3], where the T is, and its surface in motion."""
    cameras = [ring_camera(azimuth, name, 106, 80) for azimuth, name in zip((0.0, 1.6), NAMES, strict=True)]
    views, joints = pushing_sequence(FRAMES, cameras)
    moved = [max(0.0, (f - FRAMES * 0.4) / FRAMES) for f in range(FRAMES)]
    bar = (BOX - [0.1, 0.05, 0]) * [1, 0.5, 0.6] + [0, 0.05, 0]
    stem = (BOX - [0.1, 0.05, 0]) * [0.25, 1.1, 0.6] + [0, -0.03, 0]
    shape = np.concatenate([bar, stem])
    vertices = []
    for far in moved:
        c, s = np.cos(0.5 * far), np.sin(0.5 * far)
        vertices.append(shape @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [0.03 - 0.15 * far, 0.02, 0])
    return SimpleNamespace(
        cameras=cameras,
        views=views,
        joints=joints,
        vertices=np.array(vertices),
        triangles=np.concatenate([FACES, FACES + len(BOX)]),
        stroke=np.array([0 if far > 0 else -1 for far in moved]),
    )


def frame_of(scene, f: int) -> rendering.Frame:
    views = scene.views[f]
    return rendering.Frame(
        SimpleNamespace(number=f),
        [view.image for view in views],
        [view.depth for view in views],
        np.stack([view.object for view in views]),
        np.stack([view.hand for view in views]),
        scene.joints[f],
        0.2 * f + np.array([0.001, 0.003]),
        np.zeros(2, bool),
    )


def tips(scene) -> np.ndarray:
    return scene.joints[:, [8, 12]].mean(1)


def truth_of(scene, frames) -> dict[str, np.ndarray]:
    objects, object_offsets = encode_masks([mask for frame in frames for mask in frame.object_mask])
    of_hands, hand_offsets = encode_masks([mask for frame in frames for mask in frame.hand_mask])
    assert all(frame.color == frame.depth == [] for frame in frames), "images are not kept in memory"
    return {
        "particles": scene.vertices,
        "vertices": scene.vertices,
        "triangles": scene.triangles,
        "object_mask": objects,
        "object_mask_offsets": object_offsets,
        "hand_mask": of_hands,
        "hand_mask_offsets": hand_offsets,
        "hand_keypoints": scene.joints,
        "end_effector": tips(scene),
        "stroke": scene.stroke,
        "contact": scene.stroke >= 0,
        "time": 0.2 * np.arange(FRAMES),
    }


@pytest.fixture(scope="module")
def stubs(scene):
    """Rendering, detection and segmentation that know the scene; each call is noted."""
    noted = SimpleNamespace(recorded=[], detected=[], found=[], segmented=[])

    def record(environment, seed, strokes, cameras, hand, modes, trouble, texture):
        noted.recorded.append((environment, seed, strokes, [c.name for c in cameras], hand, modes))
        return (frame_of(scene, f) for f in range(FRAMES))

    def detect(images, times, model, hands):
        """One hand."""
        images = list(images)
        camera = scene.cameras[len(noted.detected) % 2]
        noted.detected.append((images, times, str(model)))
        return np.stack([camera.project(joints)[0] for joints in scene.joints])[:, None], np.ones((FRAMES, 1))

    def one_hand(images, model, hands):
        count = len(list(images))
        return np.full((count, hands, 21, 2), np.nan), np.zeros((count, hands))

    def find(color, depth, cameras, hand_px, workspace, params, tips):
        noted.found.append((color, depth, [c.name for c in cameras], hand_px, workspace, params))
        return seeds.ObjectSeed(2, [view.object for view in scene.views[2]])

    def masks(images, depths, camera, hand_px, workspace, seed_frame, seed_mask, params, tips, progress, within):
        assert within is None, "the stage follows it all the way"
        noted.segmented.append((images, depths, camera.name, hand_px, workspace, seed_frame, seed_mask, params))
        c = NAMES.index(camera.name)
        return np.stack([views[c].object for views in scene.views])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulate, "make_environment", lambda *given: given)
        patch.setattr(rendering, "record", record)
        patch.setattr(rendering, "truth_arrays", lambda environment, frames: truth_of(scene, frames))
        patch.setattr(rig, "camera_rig", lambda count: scene.cameras)
        patch.setattr(hands_of_environments, "load_hand", lambda: "the hand")
        patch.setattr(hands, "detect_hands", detect)
        patch.setattr(hands, "find_hands", one_hand)
        patch.setattr(object_masks, "find_object", find)
        patch.setattr(segmentation, "segment_sequence", masks)
        yield noted


SIMULATION = SimulateParams(environment="tblock", sequences=2, strokes=3, particles=9, seed=5)


@pytest.fixture(scope="module")
def recorded(stubs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings") / "tblock"
    assert simulate.record_sequences(folder, SIMULATION, jobs=1, force=False) == ["sequence_0000", "sequence_0001"]
    return folder


@pytest.fixture(scope="module")
def run(recorded, stubs, tmp_path_factory):
    """The finished run of the first sequence: read it, never write to it."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "hand.task").write_bytes(b"weights")
    sections = {
        "ingest": {"recording": str(recorded), "workspace": WORKSPACE.ravel().tolist()},
        "hands": {"hand_model": str(folder / "hand.task")},
        "fuse": {"contact_radius": 0.06},
        "track": TRACK,
    }
    made = Run(folder / "run", Recipe(STAGES, sections))
    made.save_recipe()
    outcomes = run_chain(made, "score", Options())
    assert [str(o.error) for o in outcomes if o.error] == []
    return open_run(folder / "run")


def test_a_recording_is_written_camera_by_camera_with_its_truth(recorded, stubs, scene):
    (environment, seed, strokes, names, hand, modes), (_, other, *_) = stubs.recorded[:2]
    given = RecordingParams(**SIMULATION.model_dump(exclude={"sequences"}))
    assert environment == ("tblock", 9, given)
    assert (strokes, names, hand, modes) == (3, list(NAMES), "the hand", ())
    assert (seed, other) == tuple(simulate.sequence_seed(given, k) for k in (0, 1))
    assert seed != other
    sequence = recorded / "sequence_0000"
    assert sorted(p.name for p in recorded.iterdir()) == ["cameras.json", "sequence_0000", "sequence_0001"]
    for c, camera in enumerate(read_cameras(sequence)):
        assert camera.name == NAMES[c]
        np.testing.assert_allclose(read_times(sequence, camera), 0.2 * np.arange(FRAMES) + (0.001, 0.003)[c])
        assert len(list((sequence / camera.name / "color").iterdir())) == FRAMES
    known = read_artifact(sequence / "truth.h5", "truth")
    np.testing.assert_allclose(known["vertices"], scene.vertices, atol=1e-6)
    assert known.params == given.content()
    assert known.quality.endswith("for scoring only")


def test_finished_sequences_are_kept_unless_their_settings_change(stubs, tmp_path):
    def render(force=False, **settings):
        before = len(stubs.recorded)
        simulate.record_sequences(tmp_path / "r", SIMULATION.model_copy(update=settings), jobs=2, force=force)
        return len(stubs.recorded) - before

    def render_one(index=0, force=False, **settings):
        before = len(stubs.recorded)
        params = RecordingParams(**SIMULATION.model_copy(update=settings).model_dump(exclude={"sequences"}))
        simulate._record_sequence(tmp_path / "r" / "sequence_0000", params, index, force)
        return len(stubs.recorded) - before

    left = tmp_path / "r" / ".sequence_0000.partial" / "east" / "color"
    left.mkdir(parents=True)
    (left / "000099.jpg").write_bytes(b"of an interrupted run")
    assert render(sequences=1) == 1
    assert [render(sequences=1), render_one()] == [0, 0]
    assert [render_one(force=True), render_one(), render_one(1), render_one(1), render_one(0, seed=6)] == [
        1,
        0,
        1,
        0,
        1,
    ]
    assert sorted(path.name for path in (tmp_path / "r").iterdir()) == ["cameras.json", "sequence_0000"]
    assert len(list((tmp_path / "r" / "sequence_0000" / "east" / "color").iterdir())) == FRAMES


def test_frames_are_what_was_recorded(run, scene):
    frames = run.read("frames", "sequence_0000")
    assert frames.quality == f"{FRAMES} frames, 2 cameras, 1.2 s, geometry good"
    for camera, real in zip(cameras_of(frames), scene.cameras, strict=True):
        assert (camera.name, camera.width, camera.height, camera.depth_scale) == (real.name, 106, 80, 0.001)
        for name in ("K", "distortion", "T_world_camera"):
            np.testing.assert_allclose(getattr(camera, name), getattr(real, name), atol=1e-9)
    color, depth = color_of(frames), depth_of(frames)
    for f in range(FRAMES):
        for c in range(2):
            np.testing.assert_array_equal(depth.depth(f, c), scene.views[f][c].depth)
            assert np.abs(color.color(f, c).astype(int) - scene.views[f][c].image).mean() < 6
    np.testing.assert_allclose(workspace_of(frames), WORKSPACE)
    assert source_frames(frames).tolist() == list(range(FRAMES))


def test_the_frames_a_recording_was_taken_at_are_those_of_the_first_camera():
    frames = artifact({"source_frame": np.array([[0, 1], [2, 3], [5, 6]])})
    assert source_frames(frames).tolist() == [0, 2, 5]


def test_hands_are_looked_for_in_each_camera_and_lifted_by_its_depth(run, stubs, scene):
    found = run.read("hands", "sequence_0000")
    for c, (images, times, model) in enumerate(stubs.detected[:2]):
        assert len(images) == FRAMES
        assert np.abs(images[3].astype(int) - scene.views[3][c].image).mean() < 6
        np.testing.assert_allclose(times, run.read("frames", "sequence_0000")["time"])
        assert model.endswith("hand.task")
        pixels = np.stack([scene.cameras[c].project(joints)[0] for joints in scene.joints])
        np.testing.assert_allclose(found["landmarks"][:, c], pixels, atol=1e-3)
    assert found["seen"].all()
    assert found.quality == f"hand in 100% of {FRAMES} frames (east 100%, north 100%)"
    assert np.nanmedian(np.linalg.norm(found["keypoints"] - scene.joints, axis=-1)) < 0.02
    assert np.nanmedian(np.linalg.norm(found["end_effector"] - tips(scene), axis=-1)) < 0.03


def test_masks_are_those_of_their_frame_and_camera(run, stubs, scene):
    (color, depth, names, hand_px, workspace, params), *_ = stubs.found
    assert names == list(NAMES)
    assert [len(color), len(color[1]), len(depth), len(depth[1])] == [2, FRAMES, 2, FRAMES]
    np.testing.assert_array_equal(depth[1][4], scene.views[4][1].depth)
    landmarks = run.read("hands", "sequence_0000")["landmarks"]
    np.testing.assert_allclose(hand_px, landmarks)
    np.testing.assert_allclose(workspace, WORKSPACE)
    assert params == SegmentParams()
    for c, (images, depths, name, px, space, seed_frame, seed_mask, given) in enumerate(stubs.segmented[:2]):
        assert (name, seed_frame, given) == (NAMES[c], 2, params)
        np.testing.assert_array_equal(depths[5], scene.views[5][c].depth)
        assert np.abs(images[5].astype(int) - scene.views[5][c].image).mean() < 6
        np.testing.assert_allclose(px, landmarks[:, c])
        np.testing.assert_array_equal(space, workspace)
        np.testing.assert_array_equal(seed_mask, scene.views[2][c].object)
    masks = run.read("masks", "sequence_0000")
    stack = ImageStack(masks["mask"], masks["mask_offsets"], 2, "mask")
    area = np.array([[view.object.sum() for view in views] for views in scene.views])
    for f in range(FRAMES):
        for c in range(2):
            np.testing.assert_array_equal(stack.mask(f, c), scene.views[f][c].object)
    np.testing.assert_array_equal(masks["area"], area)
    assert masks.quality == f"object in 100% of {FRAMES} frames, 100% of the images, {np.median(area):.0f} px"


def test_clouds_are_fused_from_all_cameras_and_touched_by_the_hand(run, scene):
    made = run.read("clouds", "sequence_0000")
    sizes = np.diff(made["offsets"])
    assert made["offsets"][0] == 0
    assert (sizes > 50).all()
    for f, cloud in enumerate(np.split(made["points"], made["offsets"][1:-1])):
        off = truth.surface_distance(cloud, scene.vertices[f], scene.triangles)
        assert np.median(off) < 0.006
    touching = made["contact"].mean()
    assert touching > 0.5
    assert made.quality == f"{np.median(sizes):.0f} points a frame, 100% of the frames, contact in {touching:.0%}"
    np.testing.assert_array_equal(made["end_effector"], run.read("hands", "sequence_0000")["end_effector"])
    np.testing.assert_array_equal(made["time"], run.read("frames", "sequence_0000")["time"])


def test_tracks_follow_the_object_and_scores_say_how_well(run, scene):
    made, scored = run.read("tracks", "sequence_0000"), run.read("scores", "sequence_0000")
    assert made.quality == f"{FRAMES} frames, expected error {made['trust/doubt'].mean() * 1000:.1f} mm"
    assert (made["mode"] == 0).all()
    assert made["positions"].shape == (FRAMES, 8, 3)
    np.testing.assert_array_equal(made["contact"], run.read("clouds", "sequence_0000")["contact"])
    true = truth.carry_with_mesh(made["positions"][0], scene.vertices, scene.triangles, 0)
    np.testing.assert_allclose(scored["true_positions"], true, atol=1e-5)
    errors = np.linalg.norm(made["positions"] - true, axis=-1).mean(-1) * 1000
    names = np.array(scored.texts("score_name"))

    def of(name: str) -> np.ndarray:
        return scored["score_value"][names == name]

    np.testing.assert_allclose(of("tracked particles, all frames [mm]"), errors, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(of("tracked particles at stroke ends [mm]"), errors[-1:], rtol=1e-3)
    assert scored.quality == f"{errors[-1]:.1f} mm from the truth at stroke ends"
    assert of("object mask IoU").tolist() == [1.0] * 6, "two cameras in frames 0, 3 and 6"
    clouds_of = run.read("clouds", "sequence_0000")
    medians = [
        np.median(truth.surface_distance(cloud, scene.vertices[f], scene.triangles)) * 1000
        for f, cloud in enumerate(np.split(clouds_of["points"], clouds_of["offsets"][1:-1]))
    ]
    np.testing.assert_allclose(of("fused cloud to surface, median [mm]"), medians[::3], rtol=1e-4)
    assert of("frames with the hand found").tolist() == [1.0] * FRAMES
    off = np.linalg.norm(clouds_of["end_effector"] - tips(scene), axis=-1)
    assert len(of("end-effector error [mm]")) == np.isfinite(off).sum()


def test_scores_are_summarised_by_name(run):
    metrics, scores = evaluate.read_metrics(run)
    assert len(scores) == 2
    value, lines = evaluate.describe(run)
    rows = {row["score"]: row for row in value["scores"]}
    both = np.concatenate([s["score_value"][s["score_name"] == b"tracked particles, all frames [mm]"] for s in scores])
    row = rows["tracked particles, all frames [mm]"]
    assert row["values"] == 2 * FRAMES
    assert row["mean"] == pytest.approx(both.mean())
    assert (row["median"], row["p90"]) == (pytest.approx(np.median(both)), pytest.approx(np.quantile(both, 0.9)))
    (line,) = (line for line in plain(lines) if line.startswith("tracked particles, all frames"))
    assert line.split()[5:] == [str(2 * FRAMES), *(f"{row[name]:.3f}" for name in ("mean", "median", "p90"))]
    assert metrics == {}


def test_a_recording_without_a_truth_has_nothing_to_score(run):
    assert run.units(STAGES["score"]) == ["sequence_0000", "sequence_0001"]
    inputs = {name: run.read(name, "sequence_0000") for name in STAGES["score"].reads}
    elsewhere = context()
    elsewhere.run, elsewhere.unit = run, "sequence_0009"
    output = score.run(inputs, run.params("score"), elsewhere)
    assert output.quality == "no truth to score against"
    assert output.arrays["true_positions"].shape == (0, 8, 3)
    assert len(output.arrays["score_name"]) == len(output.arrays["score_value"]) == 0


def test_the_same_particles_are_held_to_the_true_ones_for_evaluation(run):
    scores = {"a": run.read("scores", "sequence_0000"), "b": artifact({"true_positions": np.zeros((0, 8, 3))})}
    assert evaluate._true_positions({"scores": scores}, "a") is scores["a"]["true_positions"]
    assert evaluate._true_positions({"scores": scores}, "b") is None
    assert evaluate._true_positions({"scores": scores}, "c") is None
    assert evaluate._true_positions({}, "a") is None


def inputs_of(run, *names: str) -> dict:
    return {name: run.read(name, "sequence_0000") for name in names}


def test_fusing_what_no_camera_sees_is_refused_and_what_no_hand_touches_is_told(run, monkeypatch):
    inputs = inputs_of(run, "frames", "hands", "masks")
    far = artifact(dict(inputs["hands"].arrays) | {"end_effector": np.full((FRAMES, 3), 2.0)})
    output = fuse.run(inputs | {"hands": far}, FuseParams(), context())
    assert output.warnings == ["the hand never touches the object: no stroke will be found in this sequence"]
    assert fuse.run(inputs, run.params("fuse"), context()).warnings == []
    seen = []

    def some(masks, depths, cameras, workspace, voxel):
        seen.append((len(masks), len(depths), [c.name for c in cameras], voxel))
        return np.zeros((0 if len(seen) == 2 else len(seen), 3), np.float32)

    monkeypatch.setattr(clouds, "fuse", some)
    output = fuse.run(inputs, FuseParams(voxel_size=0.01), context())
    assert seen == [(2, 2, list(NAMES), 0.01)] * FRAMES
    assert output.arrays["offsets"].tolist() == [0, 1, 1, 4, 8, 13, 19, 26]
    assert output.quality.startswith("4 points a frame, 86% of the frames, contact in ")
    monkeypatch.setattr(clouds, "fuse", lambda *_: np.zeros((0, 3), np.float32))
    with pytest.raises(DataError, match="no camera sees the object with depth in frames 0 to 6"):
        fuse.run(inputs, FuseParams(), context())


def test_hands_seen_nowhere_are_an_error_and_seldom_a_warning(run, scene, monkeypatch):
    from piegraph_cli.stages import hands as stage

    inputs = inputs_of(run, "frames")
    params = stage.HandsParams(hand_model="hand.task")

    def seeing(*frames: int):
        calls = []

        def detect(images, times, model, hands):
            if hands == 2:
                return np.full((len(times), 2, 21, 2), np.nan), np.zeros((len(times), 2))
            camera = scene.cameras[len(calls)]
            calls.append(list(images))
            pixels = np.stack([camera.project(joints)[0] for joints in scene.joints])
            pixels[[f for f in range(FRAMES) if f not in frames or (len(calls) == 2 and f == 1)]] = np.nan
            return pixels[:, None], np.ones((FRAMES, 1))

        monkeypatch.setattr(hands, "detect_hands", detect)
        return stage.run(inputs, params, context())

    few = seeing(0, 1)
    assert few.quality == "hand in 29% of 7 frames (east 29%, north 14%)"
    assert few.warnings == ["hand found in 29% of the frames only: see `piegraph report`"]
    assert "source" not in few.arrays, "no frame is without the hand: by depth alone it would be 6 cm off"
    assert seeing(0, 1, 2, 3, 4).warnings == []
    with pytest.raises(DataError, match="no camera sees a hand in frames 0 to 6") as caught:
        seeing()
    assert "cameras east, north" in caught.value.where


def test_sam_is_prompted_where_there_are_prompts(run, scene, stubs, monkeypatch):
    inputs, seen = inputs_of(run, "frames", "hands"), []

    def masks(network, images, depths, camera, px, workspace, seed_frame, seed_mask, params, tips, **given):
        key_every, prompt = given["key_every"], given["prompt"]
        assert given["within"] is None, "the stage follows it all the way"
        seen.append((network, camera.name, seed_frame, bool(seed_mask.any()), key_every, prompt and prompt.box))
        return np.zeros((FRAMES, 80, 106), bool)

    monkeypatch.setattr(sam, "segment_sequence", masks)
    monkeypatch.setattr(sam_models, "load_sam", lambda checkpoint, model: (str(checkpoint), model))
    boxes = {"east": (40.0, 36.0, 66.0, 53.0), "north": (30.0, 36.0, 68.0, 55.0)}
    box = boxes["north"]
    settings = {"segmenter": "sam", "sam_checkpoint": "sam.pt", "sam_model": "tiny", "sam_every": 4}
    output = segment.run(inputs, SegmentParams(**settings, prompts={"north": box}), context())
    network = ("sam.pt", "tiny")
    assert seen == [(network, "east", 0, True, 4, None), (network, "north", 0, True, 4, box)], (
        "one camera tells the other"
    )
    assert output.quality == f"object in 0% of {FRAMES} frames, 0% of the images, 0 px"
    seen.clear()
    segment.run(inputs, SegmentParams(**settings, prompts=boxes), context())
    assert seen == [(network, name, 0, False, 4, boxes[name]) for name in NAMES], "nothing has to be found"
    before = len(stubs.segmented)
    segment.run(inputs, SegmentParams(prompts=boxes), context())
    assert len(seen) == 2, "without sam"
    assert [call[5] for call in stubs.segmented[before:]] == [0, 0], "prompts hold for the first frame"
    with pytest.raises(DataError, match=r"prompts\.north meets nothing"):
        segment.run(inputs, SegmentParams(prompts={"north": (1.0, 2.0, 5.0, 6.0)}), context())
    with pytest.raises(UsageError, match="names no camera of this recording: west"):
        segment.run(inputs, SegmentParams(prompts={"west": box}), context())
    with pytest.raises(MissingError, match="needs weights"):
        segment.run(inputs, SegmentParams(segmenter="sam"), context())


@pytest.mark.parametrize("mode", ["push", "pick"])
def test_tracking_is_given_the_hand_for_picks_and_tells_of_poor_clouds(run, monkeypatch, mode):
    source, seen = run.read("clouds", "sequence_0000"), []
    frames = run.read("frames", "sequence_0000")
    inputs = {"clouds": source, "frames": frames, "masks": run.read("masks", "sequence_0000")}
    held = np.zeros(FRAMES, bool)
    doubt, lost = np.linspace(0.010, 0.016, FRAMES), np.zeros(FRAMES, bool)

    def tracked(given, params, hand, grasp, progress, views, time):
        seen.append((given, params, hand, grasp, list(progress(range(3)))))
        assert [len(views[0]), len(views)] == [len(frames["K"]), FRAMES]
        none, all_seen = np.zeros(FRAMES), np.ones((FRAMES, 4))
        positions = np.zeros((FRAMES, 4, 3))
        return SimpleNamespace(
            positions=positions,
            residual=none,
            weight=all_seen,
            misfit=none,
            doubt=doubt,
            held=held,
            lost=lost,
            sheet=False,
        )

    from piegraph_cli.physics import tracking

    monkeypatch.setattr(tracking, "track", tracked)
    params = track.TrackParams(mode=mode)
    output = track.run(inputs, params, context())
    given, own, hand, grasp, items = seen[0]
    assert [len(cloud) for cloud in given] == np.diff(source["offsets"]).tolist()
    np.testing.assert_array_equal(np.concatenate(given), source["points"])
    assert (own, items) == (params, [0, 1, 2])
    if mode == "pick":
        np.testing.assert_array_equal(hand, source["end_effector"])
        np.testing.assert_array_equal(grasp, source["contact"])
    else:
        assert hand is None
        assert grasp is None
    assert set(output.arrays["mode"].tolist()) == {int(mode == "pick")}
    assert (output.quality, output.warnings) == ("7 frames, expected error 13.0 mm", [])
    np.testing.assert_array_equal(output.arrays["trust/doubt"], doubt)
    doubt += 0.0025
    (poor,) = track.run(inputs, params, context()).warnings
    assert poor == "expected error 15.5 mm: look at frame 6 with `piegraph report`"
    doubt[:] = 0.001
    held[[2, 3]] = True
    lost[4] = True
    warnings = track.run(inputs, params, context()).warnings
    assert warnings[0] == "2 frames without a cloud, first 2: particles held still"
    assert warnings[1] == "1 frames in which the object is not where it can be, first 4: no examples"
    lost[4:] = True
    assert track.run(inputs, params, context()).warnings[1].endswith("not found again, so the sequence ends there")


def test_tracking_names_the_file_of_a_cloud_that_cannot_be_tracked(run):
    source = run.read("clouds", "sequence_0000")
    few = artifact(dict(source.arrays) | {"points": source["points"][:7], "offsets": np.arange(FRAMES + 1)})
    with pytest.raises(DataError) as caught:
        track.run(
            {"clouds": few} | {name: run.read(name, "sequence_0000") for name in ("frames", "masks")},
            track.TrackParams(),
            context(),
        )
    assert caught.value.where.startswith("memory.h5, ")


def test_a_stage_alone_works_on_the_units_of_what_it_reads(run):
    assert [o.state for o in run_stage(run, STAGES["fuse"], Options())] == ["cached", "cached"]
