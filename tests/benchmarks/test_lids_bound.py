"""The observer that bounds what squeezes tell of a lid, against integrals over the stiffness of the wall."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.lids_bound import DEFORMATION_M, FORCE_N, STIFFER, Observer
from scipy.stats import norm

from visuohaptic.recognition.touch.contents import SqueezeSamples

#: Stiffness with a free mouth and with a cap, and the force of the gas by the third power of the deformation.
K_N_m, CAPPED_N_m, GAS_N_m3 = 2000.0, 2600.0, 2e6
DEPTHS_M = np.array([1e-3, 2e-3, 3e-3, 4e-3, 5e-3])


def container() -> SimpleNamespace:
    """A wall that is as stiff everywhere, and a gas that does not care for the filling."""
    z = np.array([0.0, 0.2])
    return SimpleNamespace(
        wall_of=lambda closed: (z, np.full(2, CAPPED_N_m if closed else K_N_m)),
        contents_N=lambda state, height_m, depth_m: state[0] * GAS_N_m3 * depth_m**3,
        stiffer=1.0, wall_kg=0.02, below_m3=np.array([0.0, 5e-4]),
    )  # fmt: skip


@pytest.mark.parametrize(("uneven", "rim"), [(0.0, "held"), (0.2, "unknown"), (3.0, "held")])
def test_one_squeeze_is_integrated_over_the_stiffness(uneven: float, rim: str) -> None:
    one, rng = container(), np.random.default_rng(5)
    force_N = 2300.0 * DEPTHS_M + 0.2 * GAS_N_m3 * DEPTHS_M**3
    force_N += FORCE_N * rng.standard_normal(len(DEPTHS_M))
    observer = Observer(one, 0.3)
    observer.feel(SqueezeSamples(0.1, DEPTHS_M, force_N))
    k, evidence = np.geomspace(2000.0, 2600.0, 2001), []
    scale = math.hypot(math.log(STIFFER[1] / STIFFER[0]) / math.sqrt(12.0), uneven)
    for closed in (False, True):
        gas_N = closed * GAS_N_m3 * DEPTHS_M**3
        rise = 2300.0 + 3.0 * gas_N / DEPTHS_M
        sigma = np.hypot(FORCE_N, DEFORMATION_M * rise)
        fit = norm.logpdf(force_N, k[:, None] * DEPTHS_M + gas_N, sigma).sum(axis=1)
        holds = np.linspace(0.0, 1.0, 51) if closed and rim == "unknown" else np.array([float(closed)])
        held = np.log(K_N_m) + math.log(CAPPED_N_m / K_N_m) * holds
        prior = norm.pdf(np.log(k)[:, None], held, scale).mean(axis=1)
        evidence.append(np.trapezoid(np.exp(fit) * prior, np.log(k)))
    assert observer.closed(uneven, rim) == pytest.approx(evidence[1] / sum(evidence), abs=0.01)
    assert 0.01 < observer.closed(uneven, rim) < 0.99
