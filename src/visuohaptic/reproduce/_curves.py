"""Force-deformation curves at several locations on a bottle, open and closed, as read by the gripper (Sec. 6.4.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..deformation import Contents, load_container
from ..recognition.data.readings import CurveCoefficients, fit_curve
from ..recognition.touch.state import StateCurve, simulate_state_curves
from .worlds.virtual_containers import NOISE_N, NOISE_m, RATE_Hz, SPEED_m_per_s

#: Distance of the gripper's readings.
STEP_m = SPEED_m_per_s / RATE_Hz


def curves_of(name: str, places: Sequence[str], around: int) -> dict[tuple[str, str], StateCurve]:
    """(state, location) -> curve of the nominal object of a class; "open" is without its cap.

    Parameters
    ----------
    name
        Of the class.
    places
        Names of locations, as ``x+5``.
    around
        Vertices of a ring of the mesh.
    """
    found = simulate_state_curves(
        load_container(name).middle(), {"open": None, "closed": Contents()}, places,
        variants=1, spread=0.0, around=around,
    )  # fmt: skip
    return {(one.state, one.place): one for one in found}


def read_curve(
    curve: StateCurve, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, CurveCoefficients]:
    """Readings of deformation [m] and force [N] while the finger closes, and the fitted features.

    Parameters
    ----------
    curve
        Simulated curve of one location.
    rng
        For the noise.
    """
    from scipy.interpolate import PchipInterpolator

    way = np.r_[0.0, curve.deformation_m]
    force = PchipInterpolator(way, np.r_[0.0, curve.force_N])
    at = np.arange(STEP_m, way[-1], STEP_m)
    d = at + rng.normal(0, NOISE_m, len(at))
    f = force(at) + rng.normal(0, NOISE_N, len(at))
    return d, f, fit_curve(d, f, from_contact=True)
