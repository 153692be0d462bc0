"""Metrics against values worked out by hand, intervals, and scores against a known truth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piegraph_cli.dynamics.stroke import Strokes
from piegraph_cli.evaluation.metrics import chamfer_distance, particle_distance, shape_error
from piegraph_cli.evaluation.params import ModelEvaluateParams
from piegraph_cli.evaluation.statistics import bootstrap_grid, bootstrap_mean
from piegraph_cli.evaluation.truth import carry_with_mesh, hand_scores, mask_iou, surface_distance, track_errors
from piegraph_cli.evaluation.windows import window_metrics

LINE = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])


def test_distances_in_centimetres():
    moved = LINE + np.array([0, 0.03, 0.04])
    assert particle_distance(moved, LINE) == pytest.approx(5)
    assert chamfer_distance(moved, LINE) == pytest.approx(10)
    assert chamfer_distance(LINE[::-1], LINE) == pytest.approx(0)
    assert particle_distance(LINE[::-1], LINE) == pytest.approx(40 / 3)


def test_shape_error_ignores_translation_and_sees_stretch():
    edges = np.array([[0, 1], [1, 2]])
    assert shape_error(LINE + 0.5, LINE, edges) == pytest.approx(0)
    stretched = LINE.copy()
    stretched[2, 0] += 0.02
    assert shape_error(stretched, LINE, edges) == pytest.approx((0 + 4) / 2)


def test_the_bootstrap_interval_holds_the_mean_and_narrows():
    values = np.random.default_rng(0).normal(3, 1, 400)
    mean, low, high = bootstrap_mean(values)
    assert low < mean < high
    assert high - low == pytest.approx(4 * 1 / 20, rel=0.2)
    assert np.isnan(bootstrap_mean(np.array([]))).all()


BOX = np.array([[x, y, z] for x in (0, 0.2) for y in (0, 0.1) for z in (0, 0.05)], float)
FACES = np.array(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
)


def test_material_points_move_rigidly_with_a_rigid_mesh():
    rng = np.random.default_rng(0)
    points = rng.uniform([0, 0, 0.045], [0.2, 0.1, 0.055], (30, 3))
    poses = [(Rotation.from_euler("z", a).as_matrix(), np.array([a, -a, 0])) for a in (0.0, 0.4, 2.0)]
    vertices = np.stack([BOX @ R.T + t for R, t in poses])
    carried = carry_with_mesh(points, vertices, FACES, 0)
    for frame, (R, t) in enumerate(poses):
        np.testing.assert_allclose(carried[frame], points @ R.T + t, atol=1e-6)


def test_surface_distance_and_iou():
    points = np.array([[0.1, 0.05, 0.06], [0.1, 0.05, 0.05], [0.25, 0.05, 0.02]])
    np.testing.assert_allclose(surface_distance(points, BOX, FACES), [0.01, 0, 0.05], atol=1e-6)
    mask = np.zeros((4, 4), bool)
    mask[:2] = True
    other = np.zeros((4, 4), bool)
    other[1:3] = True
    assert mask_iou(mask, other) == pytest.approx(1 / 3)
    assert mask_iou(mask & False, other & False) == 1


def test_hand_scores_count_only_frames_with_a_hand():
    true = np.array([[0.0, 0, 0], [0.1, 0, 0], [np.nan] * 3])
    found = np.array([[0.003, 0.004, 9], [np.nan] * 3, [5.0, 5, 5]])
    seen = np.array([[True, False], [False, False], [True, True]])
    scores = hand_scores(seen, found, true)
    assert scores["frames with the hand found"].tolist() == [1, 0]
    np.testing.assert_allclose(scores["end-effector error [mm]"], [5])


def test_the_shape_error_of_a_table_does_not_depend_on_the_springs():
    rng = np.random.default_rng(0)
    rest = np.concatenate([rng.uniform(0, 0.2, (30, 2)), np.zeros((30, 1))], 1).astype(np.float32)
    sequence = {
        "rest": rest,
        "before": rest[None],
        "after": rest[None] + rng.normal(0, 0.01, (1, 30, 3)).astype(np.float32),
        "strokes": Strokes.of([[0.0, 0.0]], [[0.1, 0.0]], [0]),
        "follows": np.array([False]),
        "frames": np.array([[0, 5]]),
        "seen": np.ones((2, 1, 30), bool),
    }
    rows = [
        list(
            window_metrics(
                sequence, None, None, ModelEvaluateParams(label="static", horizons=(1,), spring_radius=radius)
            )
        )
        for radius in (0.02, 0.08)
    ]
    np.testing.assert_equal(rows[0], rows[1])


def test_one_value_alone_has_no_interval():
    assert bootstrap_grid(np.array([[3.0]]))[0] == 3
    assert np.isnan(bootstrap_grid(np.array([[3.0]]))[1:]).all()
    for two in (np.array([[1.0, 3.0]]), np.array([[1.0], [3.0]])):
        mean, low, high = bootstrap_grid(two)
        assert (mean, low, high) == (2, 1, 3)
    mean, low, high = bootstrap_mean(np.array([1.0, 3.0]))
    assert (mean, low, high) == (2, 1, 3)
    assert bootstrap_mean([4.0]) == (4, 4, 4)


def test_errors_of_tracks_are_means_over_particles_in_millimetres():
    errors = track_errors(np.stack([LINE, LINE]), np.stack([LINE, LINE + np.array([0, 0.003, 0.004])]))
    np.testing.assert_allclose(errors, [0, 5], atol=1e-9)
