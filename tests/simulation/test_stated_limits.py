"""What the constants of simulated worlds are said to do, computed by other means."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import constants

from visuohaptic.simulation.floor import floor_model
from visuohaptic.simulation.foam import strip_law
from visuohaptic.simulation.rendering import _coverage, textures
from visuohaptic.simulation.tabletop import crown_cap, deformable, gripper_setup


def test_feet_and_foam_give_way_by_millimetres() -> None:
    """A critically damped spring of the time constant tau has the stiffness m / tau^2."""
    assert constants.g * floor_model.SINK_S**2 == pytest.approx(0.004, rel=0.1)
    assert pytest.approx(0.003, rel=0.1) == 10.0 / (3.0 / floor_model.FOAM_S**2)


def test_blur_is_drawn_from_a_hundredth_of_the_variance_of_a_pixel() -> None:
    assert pytest.approx(100.0, rel=0.2) == (1 / 12) / _coverage.SHARP_PX**2


def test_foam_at_rest_is_compressed_by_less_than_can_be_seen() -> None:
    """A fifth of a micrometre of a strip of 20 mm, and a hundredth for its texture."""
    assert pytest.approx(0.2e-6, rel=0.1) == 0.02 * strip_law.FREE_STRAIN
    assert pytest.approx(0.01e-6, rel=0.1) == 0.02 * textures._AT_REST


def test_fillings_have_the_density_of_their_grains() -> None:
    """Water; rice of 1450 kg/m^3 with two fifths of air."""
    water, rice = deformable.WATER_FILL, deformable.GRAIN_FILL
    assert (water.kg_per_m3, water.solid) == pytest.approx((1000.0, 1.0), rel=0.005)
    assert (rice.kg_per_m3, rice.solid) == pytest.approx((1450.0 * 0.6, 0.6), rel=0.01)


def test_a_crown_cap_has_its_standard_size() -> None:
    """ISO 12821: 32.1 mm wide and 6.0 mm high; about half a millimetre of them is the lining."""
    cap = crown_cap.CAPPED[crown_cap.CAPPED[:, 1] >= -0.0061]
    assert 2.0 * cap[:, 0].max() == pytest.approx(0.0321, abs=2e-4)
    assert -cap[:, 1].min() == pytest.approx(0.006, abs=1.5e-4)


def test_foams_are_as_stiff_as_stated() -> None:
    """Slope at rest: rubber foam .4 MPa, the foam of the continuum simulation 2 (33.6 + .15) kPa, per unit strain."""
    for law, slope_Pa in ((gripper_setup.RUBBER_FOAM, 0.4e6), (strip_law.REFERENCE_FOAM, 67.5e3)):
        low, high = law.elastic_stress_Pa(np.array([0.0, 1e-4]))
        assert (high - low) / 1e-4 == pytest.approx(slope_Pa, rel=0.04)
