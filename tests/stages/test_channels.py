"""Colour whose red and blue are exchanged: told by the hand that is seen once they are put back."""

import numpy as np
import pytest

from piegraph_cli.perception import hands
from piegraph_cli.perception.hands import LANDMARKS
from piegraph_cli.stages.hands import _exchanged

SKIN = np.full((4, 4, 3), (200, 150, 120), np.uint8)


def finds_skin(images, model, count):
    """A detector that knows a hand by more red than blue."""
    seen = [np.full((count, LANDMARKS, 2), 1.0 if image[0, 0, 0] > image[0, 0, 2] else np.nan) for image in images]
    return np.array(seen), np.ones((len(seen), count))


@pytest.mark.parametrize(("image", "exchanged"), [(SKIN, False), (SKIN[..., ::-1], True), (np.zeros_like(SKIN), False)])
def test_exchanged_channels_are_told_by_the_hand(monkeypatch, tmp_path, image, exchanged):
    monkeypatch.setattr(hands, "find_hands", finds_skin)
    assert _exchanged([image] * 10, tmp_path) is exchanged
