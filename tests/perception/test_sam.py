"""Segment Anything through its official predictor, with a small model of the official classes trained here."""

import sys

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from piegraph_cli.errors import DataError, MissingError, UsageError
from piegraph_cli.perception import sam_models
from piegraph_cli.perception.params import SegmentParams
from piegraph_cli.perception.sam import SamPrompt, automatic_prompt, predict_mask, segment_sequence
from tests.perception.scene import WORKSPACE, pushing_sequence, ring_camera
from tests.perception.tiny_sam import tee

NO_HAND = np.zeros((0, 2))


@pytest.fixture(scope="module")
def sam(sam_checkpoint):
    return sam_models.load_sam(sam_checkpoint, "tiny")


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return (a & b).sum() / (a | b).sum()


def test_the_official_predictor_beats_filling_the_box(sam):
    predictor = sam_models.import_segment_anything().SamPredictor(sam)
    rng = np.random.default_rng(1)
    found, filled = [], []
    for _ in range(10):
        image, mask = tee(rng)
        prompt = automatic_prompt(mask)
        found.append(iou(predict_mask(predictor, image, prompt, NO_HAND, np.zeros_like(mask)), mask))
        left, top, right, bottom = (int(b) for b in prompt.box)
        box = np.zeros_like(mask)
        box[max(top, 0) : bottom, max(left, 0) : right] = True
        filled.append(iou(box, mask))
    assert np.mean(found) > 0.75 > np.mean(filled) + 0.2


def test_a_sequence_is_embedded_on_key_frames_only(sam):
    camera = ring_camera(0.4, width=256, height=192)
    views, hands = pushing_sequence(5, [camera])
    hand_px = np.array([camera.project(hand)[0] for hand in hands])
    truth = np.array([row[0].object for row in views])
    images, depths = [row[0].image for row in views], [row[0].depth for row in views]
    embedded = []
    hook = sam.image_encoder.register_forward_hook(lambda *_: embedded.append(1))
    masks = segment_sequence(sam, images, depths, camera, hand_px, WORKSPACE, 0, truth[0], SegmentParams(), key_every=2)
    hook.remove()
    assert len(embedded) == 3
    assert all(iou(m, t) > 0.6 for m, t in zip(masks, truth, strict=True))


def test_a_prompt_replaces_the_seed(sam):
    camera = ring_camera(0.4, width=256, height=192)
    views, _ = pushing_sequence(1, [camera])
    view, no_hand, empty = views[0][0], np.full((1, 21, 2), np.nan), np.zeros((192, 256), bool)
    arguments = (sam, [view.image], [view.depth], camera, no_hand, WORKSPACE, 0, empty, SegmentParams())
    with pytest.raises(DataError, match="camera cam, frame 0"):
        segment_sequence(*arguments)
    masks = segment_sequence(*arguments, prompt=automatic_prompt(view.object))
    assert iou(masks[0], view.object) > 0.6


class FakePredictor:
    """Proposes nothing, the left half and everything, with the qualities given."""

    def __init__(self, quality):
        self.quality = np.array(quality)

    def set_image(self, image):
        self.masks = np.zeros((3, *image.shape[:2]), bool)
        self.masks[1, :, :4] = True
        self.masks[2] = True

    def predict(self, **_):
        return self.masks, self.quality, None


def test_the_best_proposal_is_taken_by_quality_and_overlap():
    image, rough = np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8), bool)
    rough[:, :4] = True
    prompt = SamPrompt(points=((1.0, 1.0),))
    assert predict_mask(FakePredictor([0.5, 0.5, 0.6]), image, prompt, NO_HAND, rough).sum() == 32
    assert predict_mask(FakePredictor([0.1, 0.1, 0.9]), image, prompt, NO_HAND, rough).sum() == 64


def test_automatic_points_lie_on_the_object():
    _, mask = tee(np.random.default_rng(3))
    prompt = automatic_prompt(mask)
    assert len(prompt.points) == 3
    assert all(mask[int(row), int(column)] for column, row in prompt.points)
    rows, columns = np.nonzero(mask)
    left, top, right, bottom = prompt.box
    assert left < columns.min()
    assert right > columns.max()
    assert top < rows.min()
    assert bottom > rows.max()


def test_an_empty_prompt_is_refused():
    with pytest.raises(UsageError, match="points or a box"):
        predict_mask(None, np.zeros((8, 8, 3), np.uint8), SamPrompt(), NO_HAND, np.zeros((8, 8), bool))


def test_missing_weights_say_how_to_get_them(tmp_path):
    with pytest.raises(MissingError, match=r"(?s)sam_vit_b\.pth.*doctor --fetch.*--sam-checkpoint"):
        sam_models.load_sam(tmp_path / "sam_vit_b.pth", "vit_b")


def test_weights_of_another_model_are_refused(tmp_path):
    torch.save({"some.weight": torch.zeros(3)}, tmp_path / "other.pt")
    with pytest.raises(DataError, match=r"other\.pt"):
        sam_models.load_sam(tmp_path / "other.pt", "tiny")


class Payload:
    """Writes a file when unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_weights_cannot_run_code(tmp_path):
    torch.save(Payload(tmp_path / "ran"), tmp_path / "evil.pt")
    with pytest.raises(DataError, match=r"evil\.pt"):
        sam_models.load_sam(tmp_path / "evil.pt", "tiny")
    assert not (tmp_path / "ran").exists()


def test_an_unknown_model_lists_the_known_ones():
    with pytest.raises(UsageError, match="vit_h, vit_l, vit_b, tiny"):
        sam_models.build_sam("huge")


def test_the_stand_in_leaves_no_trace(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] in ("segment_anything", "torchvision")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sam_models, "batched_nms", mark := lambda *_: None)
    monkeypatch.setitem(sys.modules, "torchvision", None)
    package = sam_models.import_segment_anything()
    assert package.automatic_mask_generator.batched_nms is mark
    assert not any(name.startswith("torchvision.") for name in sys.modules)
    for name in [name for name in sys.modules if name.split(".")[0] == "segment_anything"]:
        monkeypatch.delitem(sys.modules, name)


coordinate = st.floats(0, 20)
scored_box = st.tuples(coordinate, coordinate, coordinate, coordinate, st.floats(0, 1), st.integers(0, 2))


@settings(max_examples=50, deadline=None)
@example([(0, 0, 10, 10, 0.9, 0), (0, 0, 10, 9, 0.8, 1), (0, 0, 10, 9, 0.7, 0)])
@given(st.lists(scored_box, max_size=12))
def test_suppression_equals_its_definition(rows):
    table = torch.tensor(rows, dtype=torch.float32).reshape(-1, 6)
    boxes = torch.cat([table[:, :2], table[:, :2] + table[:, 2:4] + 0.1], dim=1)
    scores, groups = table[:, 4], table[:, 5]
    kept = []
    for n in sorted(range(len(rows)), key=lambda n: -scores[n].item()):
        if all(groups[n] != groups[k] or overlap(boxes[n], boxes[k]) <= 0.5 for k in kept):
            kept.append(n)
    assert sam_models.batched_nms(boxes, scores, groups, 0.5).tolist() == kept


def overlap(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    width = (torch.minimum(a[2], b[2]) - torch.maximum(a[0], b[0])).clamp(min=0)
    height = (torch.minimum(a[3], b[3]) - torch.maximum(a[1], b[1])).clamp(min=0)
    both = width * height
    return both / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - both)


def test_resizing_equals_antialiased_interpolation():
    image = np.random.default_rng(0).integers(0, 256, (60, 90, 3)).astype(np.uint8)
    resized = np.array(sam_models.resize(sam_models.to_pil_image(image), (20, 30)))
    tensor = torch.tensor(image).permute(2, 0, 1)[None].float()
    reference = torch.nn.functional.interpolate(tensor, (20, 30), mode="bilinear", antialias=True)[0].permute(1, 2, 0)
    assert resized.shape == (20, 30, 3)
    assert np.abs(resized - reference.numpy()).max() <= 1
