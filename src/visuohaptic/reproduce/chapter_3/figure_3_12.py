"""Front contour while a bottle is squeezed (Fig. 3.12).

The contour of the foam on the finger in the fixed frame at five forces, measured (dots) and true (lines)
(simulated gripper, foam and bottle).
"""

from __future__ import annotations

import tempfile

import numpy as np

from ...rigs import squeeze_rig as squeezing
from ...rigs.virtual_gripper import GripperSensor
from ..output import Columns, Output


def run(out: Output) -> None:
    """Squeeze, draw the contours, and compare them with ground truth.

    Parameters
    ----------
    out
        Receives the table ``contours``, picture ``squeeze``, and the comparisons; its seed and size are used.
    """
    rng = out.rng()
    rig = GripperSensor(stripe=True)
    with tempfile.TemporaryDirectory() as folder:
        sensor = rig.build(folder, rng, zero_frames=8 if out.quick else 20)
        sensor.reset()
        forces = squeezing.FORCES_N[:2] if out.quick else squeezing.FORCES_N
        found = squeezing.squeeze(sensor, rig.gripper(squeezing.BOTTLE, rng=rng), forces)
    out.drawn("squeeze", lambda path: squeezing.plot_squeeze(found, path))
    rows = Columns("target_N measured_N true_N x_m y_m")
    for one in found:
        for point in one.reading.contour_m:
            rows.add(one.target_N, one.reading.profile.force_N, one.truth.force_N, *point)
    out.table("contours", rows)
    errors = np.concatenate([one.contour_error_m for one in found])
    out.compare(
        "contour where it touches: error, root mean square", 1e3 * float(np.sqrt(np.mean(errors**2))), "mm"
    )
    force = [abs(one.reading.profile.force_N / one.truth.force_N - 1) for one in found]
    out.compare("force: largest error", 100 * max(force), "%")
    stiffness = squeezing.stiffness_N_per_m(found)
    truth = squeezing.BOTTLE.stiffness_N_per_m
    out.compare("stiffness of the bottle: error", 100 * (stiffness / truth - 1), "%")
