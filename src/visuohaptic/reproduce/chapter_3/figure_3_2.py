"""Strain-stress relation of two foams (Fig. 3.2).

Points while the stress increases and decreases, and the polynomial m_P fitted to the increasing ones
(simulated foams; the dissertation pressed real ones with a robot arm).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.errors import CalibrationError
from ...report.style import draw_axes
from ...sensing.foam import StrainStress, calibrate_foam
from ...sensing.foam.material.material_plots import draw_strain_stress
from .._press import FOAMS, pressed
from ..output import Output


def run(out: Output) -> None:
    """Press, fit, draw; and test a foam with decreasing stress.

    Parameters
    ----------
    out
        Receives the table ``points_*``, picture ``strain_stress``, and the comparisons; its seed and size are used.
    """
    found = {name: pressed(out, law, number) for number, (name, law) in enumerate(FOAMS.items())}

    def draw(*both: Any) -> None:
        for axes, (name, calibration) in zip(both, found.items(), strict=True):
            draw_strain_stress(axes, calibration)
            axes.set_title(name)

    figure = draw_axes(1, 2, draw)
    out.picture("strain_stress", figure)
    for name, calibration in found.items():
        data = calibration.data
        key = name.split()[0]
        out.table(
            f"points_{key}", {"strain": data.strain, "stress_Pa": data.stress_Pa, "direction": data.direction}
        )
        largest = float(np.max(data.loading[1]))
        out.compare(
            f"{name}: residual of the cubic by the largest stress",
            100 * calibration.material.residual_Pa / largest,
            "%",
            note='printed: "fits the datapoints well, except for the densification region"',
        )
        out.compare(f"{name}: work lost in a loop", 100 * calibration.hysteresis_loss, "%")
        low, high = calibration.material.working_strain
        out.compare(f"{name}: plateau begins at strain", low, dissertation=0.1)
        out.compare(f"{name}: plateau ends at strain", high, dissertation=0.5)
    out.compare(
        "foams that are not monotonic, refused", 100.0 * _refused(), "%", dissertation=100.0,
        note='(d): "unsuited for the proposed sensor"',
    )  # fmt: skip


def _refused() -> bool:
    """Whether a foam with a range of decreasing stress is rejected."""
    strain = np.linspace(0.0, 0.6, 60)
    stress = 4e3 * (strain + 0.12 * np.sin(2 * np.pi * strain / 0.4))
    falling = StrainStress(strain, stress, np.ones(len(strain), dtype=np.int64), "a falling foam")
    try:
        calibrate_foam(falling, width_m=0.02, height_m=0.01)
    except CalibrationError:
        return True
    return False
