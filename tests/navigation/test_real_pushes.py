"""Real pushes of a metal triangle (CMU, 250 pushes): both models against motion capture."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks._zhou2016 import support_points
from benchmarks.nav_push import real_push_errors


@pytest.mark.data
def test_real_pushes_are_foreseen_to_a_fifth_of_their_way(data):
    found = real_push_errors(data / "navigation" / "dev" / "push" / "zhou2016")
    assert len(found) == 5
    ours = np.concatenate([errors["ours position"] for errors in found.values()])
    peer = np.concatenate([errors["algorithm 2 position"] for errors in found.values()])
    moved = np.concatenate([errors["moved"] for errors in found.values()])
    assert len(ours) == 250
    # Pusher and object of one push are 1.2 mm apart (rms) where they should touch: no model can be better.
    assert np.median(ours) < 0.0015
    assert np.median(ours) < 0.2 * np.median(moved)
    assert np.median(ours) < 0.6 * np.median(peer)


def test_supports_are_read_from_the_name():
    np.testing.assert_allclose(
        support_points("wood_30_90_30_30_30_90_exp_08_17_0922_50.txt.gz"),
        [[0.03, 0.03], [0.09, 0.03], [0.03, 0.09]],
    )
    assert support_points("patch_exp_08_18_1435_50.txt.gz") is None
