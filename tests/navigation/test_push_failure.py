"""Probabilities of failure: limits, monotone, against counting."""

from __future__ import annotations

import numpy as np

from visuohaptic.navigation.push_failure import PushDoubt, simulated_failure
from visuohaptic.navigation.push_model import PushModel
from visuohaptic.navigation.quasi_static import line_path

BOX = 0.15 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def test_a_short_push_of_a_box_holds_and_one_beside_its_centre_does_not():
    model, rng = PushModel.patch(BOX, 0.3), np.random.default_rng(1)

    def failure(aside):
        path = line_path(np.array([0.0, aside]), np.array([0.5, aside]))
        return simulated_failure(model, (0.33, 0.0, 0.0), path, 0.17, rng, doubt=PushDoubt(), samples=40)

    assert failure(0.0) < 0.3
    assert failure(0.1) > 0.8
