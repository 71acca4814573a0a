"""Real pushes of a metal triangle (CMU, 250 pushes): both models against motion capture."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks._zhou2016 import support_points
from benchmarks.nav_push import real_centres, real_ends, real_push_errors

from visuohaptic.navigation.pushing.push_failure import CENTRE_FRACTION, CENTRE_NUMBERS


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


@pytest.mark.data
def test_the_prior_of_the_centre_of_friction_is_what_real_pushes_show(data):
    centres = real_centres(data / "navigation" / "dev" / "push" / "zhou2016")
    assert len(centres) == CENTRE_NUMBERS
    # 0.048, by any friction from 0.4 to 0.5 between 0.047 and 0.052.
    assert np.sqrt(np.mean(centres**2)) == pytest.approx(CENTRE_FRACTION, rel=0.15)


@pytest.mark.data
def test_the_declared_ellipsoid_holds_real_ends(data):
    """Of 100 pushes of a flat bottom, told its outline alone."""
    squares = real_ends(data / "navigation" / "dev" / "push" / "zhou2016", samples=160)
    assert len(squares) == 100
    # 90 % of 100 with twice the binomial deviation of 3.
    assert 0.84 <= np.mean(squares < 6.251) <= 0.96


def test_supports_are_read_from_the_name():
    np.testing.assert_allclose(
        support_points("wood_30_90_30_30_30_90_exp_08_17_0922_50.txt.gz"),
        [[0.03, 0.03], [0.09, 0.03], [0.03, 0.09]],
    )
    assert support_points("patch_exp_08_18_1435_50.txt.gz") is None
