"""For how long a hand that is not seen leads what it holds."""

import numpy as np

from piegraph_cli.stages.track import _told


def test_a_hand_that_is_not_seen_leads_for_a_frame_and_not_for_a_stroke():
    path = np.zeros((9, 3))
    path[[2, 4, 5, 6, 7]] = np.nan
    assert _told(path).tolist() == [True, True, True, True, True, False, False, True, True]
    assert not _told(np.full((3, 3), np.nan)).any()
