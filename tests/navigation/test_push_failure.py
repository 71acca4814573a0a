"""Probabilities of failure: limits, monotone, against counting."""

from __future__ import annotations

import numpy as np

from visuohaptic.navigation.pushing import PushModel, PushUncertainty, line_path, simulated_failure

BOX = 0.15 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def test_a_short_push_of_a_box_holds_and_one_beside_its_centre_does_not():
    model, rng = PushModel.patch(BOX, 0.3), np.random.default_rng(1)

    def failure(aside):
        path = line_path(np.array([0.0, aside]), np.array([0.5, aside]))
        return simulated_failure(
            model, (0.33, 0.0, 0.0), path, 0.17, rng, uncertainty=PushUncertainty(), samples=40
        )

    assert failure(0.0) < 0.3
    assert failure(0.1) > 0.8


def test_an_object_drawn_into_the_platform_is_met_earlier():
    # A long one, touched near its end: a turn by 3 sigma puts 6 cm of it into the platform.
    plank = np.array([[-0.05, -0.4], [0.05, -0.4], [0.05, 0.4], [-0.05, 0.4]])
    model, rng = PushModel.patch(plank, 0.3), np.random.default_rng(2)
    path = line_path(np.array([0.0, 0.3]), np.array([0.3, 0.3]))
    uncertainty = PushUncertainty(place_m=0.03, yaw_rad=0.15)
    for _ in range(5):
        fraction = simulated_failure(
            model, (0.22, 0.0, 0.0), path, 0.17, rng, uncertainty=uncertainty, samples=40
        )
        assert 0.5 < fraction <= 1.0


def test_a_platform_that_begins_in_the_outline_is_moved_back():
    model, rng = PushModel.patch(BOX, 0.3), np.random.default_rng(1)
    path = line_path(np.zeros(2), np.array([0.5, 0.0]))
    inside = simulated_failure(model, (0.317, 0.0, 0.0), path, 0.17, rng, samples=40)  # 3 mm
    assert inside < 0.3
