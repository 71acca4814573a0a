"""What the fingers feel is what the picture of their foam says, and nothing else of the world."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from visuohaptic.core.camera import Frame
from visuohaptic.rigs.virtual_gripper import STRIP, TRACKING, VirtualHand, finger_sensor
from visuohaptic.simulation.tabletop import DeformableContainer
from visuohaptic.tasks.manipulation import FoamFingerOnDrive

#: A cylinder of 35 mm whose wall is a spring of 5 N/mm everywhere.
WALL_N_PER_M, RADIUS_M = 5000.0, 0.035
CYLINDER = DeformableContainer(
    "cylinder", np.array([0.0, 0.5]), np.full(2, RADIUS_M), np.array([0.0, 0.02]),
    np.full((2, 1), 0.02 * WALL_N_PER_M) * [0.0, 1.0],
)  # fmt: skip


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("finger")
    return finger_sensor().build(
        folder, np.random.default_rng(0), zero_frames=10, tracking=TRACKING, strip=STRIP
    )


def squeezed(opening_m: float) -> tuple[VirtualHand, list[Frame]]:
    """The hand closed on the cylinder, and its frames on the way there and at rest."""
    hand = VirtualHand(CYLINDER, np.random.default_rng(2), open_m=0.076)
    hand.move(opening_m, 0.012)
    return hand, list(itertools.islice(hand, 32))


def test_the_foam_in_the_picture_tells_force_and_place_of_the_wall(sensor) -> None:
    hand, frames = squeezed(0.062)
    finger = FoamFingerOnDrive(sensor, hand)
    sensor.reset()
    touch = [finger(frame) for frame in frames]
    assert all(one.valid for one in touch)
    assert abs(touch[0].force_N) < 0.05
    assert np.isnan(touch[0].surface_m)
    # The spring of the wall, from its force: what foam and wall give way together is known from the opening.
    assert hand.force_N == pytest.approx(WALL_N_PER_M * hand.deformation_m, rel=0.02)
    assert hand.force_N > 5.0
    # The press that calibrates the foam has 0.15 N; 2 % for what of the foam's hysteresis is not modelled.
    assert touch[-1].force_N == pytest.approx(hand.force_N, rel=0.02, abs=0.15)
    # A pixel is 0.2 mm, an edge is found to a tenth of it, over a curved body to a half.
    assert touch[-1].surface_m == pytest.approx(RADIUS_M - hand.force_N / WALL_N_PER_M, abs=1e-4)


@pytest.mark.parametrize("picture", ["blank", "at rest"])
def test_the_truth_does_not_pass_by_the_picture(sensor, picture: str) -> None:
    hand, _ = squeezed(0.062)
    assert hand.force_N > 5.0
    finger = FoamFingerOnDrive(sensor, hand)
    sensor.reset()
    if picture == "at rest":
        touch = [finger(frame) for frame in squeezed(0.076)[1]]
        assert abs(touch[-1].force_N) < 0.05
    else:
        hand.blind_at_s = 0.0
        touch = [finger(Frame(hand.image(t), t, k)) for k, t in enumerate(np.arange(20, 24))]
        assert not any(one.valid for one in touch)
    assert np.isnan(touch[-1].surface_m)
