"""Memory of the foam: which points are unloading, and what they still press with.

A foam gives back less than it took (Alt 2016, Sec. 3.2 and Fig. 3.2). The
dissertation measures only while the force rises. Here every point remembers the
largest strain since its last release; below it the point is on the unloading
branch. Without an unloading curve such points are flagged; with one the loading
stress is scaled,

    stress(eps; peak) = m(eps) * R(eps / peak),    R(x) = m_unload(x * peak_c) / m(x * peak_c),

where ``peak_c`` is the strain at which the calibration turned round. The law is
exact for the calibrated loop and assumes that smaller loops have its shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...errors import InputError
from .material import FoamMaterial

__all__ = ["HysteresisState", "unloading_factor"]

#: A point below this strain has been released and forgets.
RELEASE_STRAIN = 0.005
#: Unloading is flagged when the strain is below its peak by this much, relative to the peak.
RELATIVE_DROP = 0.02
#: ... or by this many standard deviations of the difference, whichever is more.
DROP_SIGMAS = 4.0


@dataclass(slots=True, eq=False)
class HysteresisState:
    """Largest strain of every point of one strip since its last release; changed by ``update``."""

    peak_strain: Float[np.ndarray, "K"]

    @classmethod
    def at_rest(cls, points: int) -> HysteresisState:
        """Memory of a strip of K points that nothing has touched yet."""
        return cls(np.zeros(points))

    def update(
        self,
        strain: Float[np.ndarray, "K"],
        strain_sigma: Float[np.ndarray, "K"],
        valid: Bool[np.ndarray, "K"],
    ) -> Bool[np.ndarray, "K"]:
        """Take one frame in; returns which points are unloading. Invalid points keep their memory.

        The peak of a noisy signal creeps up by a few sigma while a contact rests;
        the margin below the peak is wider than that.
        """
        if strain.shape != self.peak_strain.shape:
            raise InputError(
                "memory",
                f"has {len(self.peak_strain)} points, the contour has {len(strain)}",
                remedy="start a new HysteresisState with the strip",
            )
        released = valid & (strain < np.maximum(RELEASE_STRAIN, 3 * strain_sigma))
        self.peak_strain[released] = 0.0
        rising = valid & (strain > self.peak_strain)
        self.peak_strain[rising] = strain[rising]
        margin = np.maximum(RELATIVE_DROP * self.peak_strain, DROP_SIGMAS * np.sqrt(2.0) * strain_sigma)
        unloading: Bool[np.ndarray, "K"] = valid & ~released & (strain < self.peak_strain - margin)
        return unloading


def unloading_factor(
    material: FoamMaterial, strain: Float[np.ndarray, "k"], peak_strain: Float[np.ndarray, "k"]
) -> Float[np.ndarray, "k"]:
    """Stress on the unloading branch as a fraction of the loading stress at the same strain, 0..1."""
    if material.unloading is None:
        raise InputError("material", "has no unloading curve", remedy="calibrate with unloading points")
    peak = np.maximum(peak_strain, 1e-9)
    # The quotient of two curves through zero is taken a little away from it.
    at = np.clip(strain / peak, 0.02, 1.0) * material.unloading_peak_strain
    up, down = material.loading.stress(at), material.unloading.stress(at)
    turn = float(material.loading.stress(np.array(material.unloading_peak_strain)))
    turn_down = float(material.unloading.stress(np.array(material.unloading_peak_strain)))
    # Both fits must meet at the turning point, or a small unloading would jump.
    meet = turn / turn_down if turn_down > 0 else 1.0
    blend = 1.0 + (meet - 1.0) * (at / material.unloading_peak_strain)
    return np.clip(down / np.maximum(up, 1e-9) * blend, 0.0, 1.0)
