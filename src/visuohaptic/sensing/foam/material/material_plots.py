"""Plots of a calibration: strain and stress as in Fig. 3.2, sensitivity as in Fig. 3.4."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ....core.files import new_figure, save_figure
from .section import Section, section_material, sensitivity

if TYPE_CHECKING:
    from .calibration import FoamCalibration


LOADING, UNLOADING, CURVE = "#e07b00", "#2c6fbb", "#b3122a"


def draw_strain_stress(axes: Any, calibration: FoamCalibration) -> None:
    """Draw calibration points by direction, the fitted curve with its two-sigma band, and the working range.

    Parameters
    ----------
    axes
        Axes of matplotlib.
    calibration
        Result of the calibration, with its data.
    """
    material, data = calibration.material, calibration.data
    up, down = data.loading, data.unloading
    size = float(np.clip(4000 / max(len(up[0]), 1), 4, 24))
    axes.axvspan(*material.working_strain, color="0.93", label="working range", zorder=0)
    axes.scatter(up[0], up[1] / 1e3, s=size, color=LOADING, label="loading", zorder=2, linewidths=0)
    if len(down[0]):
        axes.scatter(down[0], down[1] / 1e3, s=size, color=UNLOADING, label="unloading", linewidths=0)
    strain = np.linspace(0.0, material.loading.max_strain, 300)
    stress, sigma = material.loading.stress(strain), material.loading.stress_sigma(strain)
    axes.plot(strain, stress / 1e3, color=CURVE, lw=1.5, label=f"{material.loading.kind} fit", zorder=3)
    axes.fill_between(
        strain, (stress - 2 * sigma) / 1e3, (stress + 2 * sigma) / 1e3, color=CURVE, alpha=0.25, lw=0
    )
    if material.unloading is not None:
        back = np.linspace(0.0, material.unloading_peak_strain, 300)
        axes.plot(back, material.unloading.stress(back) / 1e3, color=UNLOADING, lw=1.2)
    if material.densification_strain < material.loading.max_strain:
        axes.axvline(material.densification_strain, color="0.4", ls="--", lw=1, label="densification limit")
    axes.set_xlim(0, material.loading.max_strain * 1.02)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("strain")
    axes.set_ylabel("stress [kPa]")
    axes.legend(frameon=False, fontsize=8)


def draw_sensitivity(axes: Any, calibration: FoamCalibration) -> None:
    """Draw the change of pressure per pixel of three cross sections at d = 0.3 m, gamma = 70 deg, f = 1800 px.

    Parameters
    ----------
    axes
        Axes of matplotlib.
    calibration
        Result of the calibration.
    """
    sections: tuple[Section, ...] = ("rectangle", "trapezoid", "triangle")
    material = calibration.material
    if material.section != "rectangle":
        sections = ()
    colours = ("#b3122a", "#2c6fbb", "#3f8f3f")
    for section, colour in zip(sections, colours, strict=False):
        rod = section_material(material, section)
        strain = np.linspace(0.0, rod.loading.max_strain, 300)
        axes.plot(strain, sensitivity(rod, strain), color=colour, lw=1.5, label=section)
    if not sections:
        strain = np.linspace(0.0, material.loading.max_strain, 300)
        axes.plot(strain, sensitivity(material, strain), color=colours[0], lw=1.5, label=material.section)
    axes.set_xlabel("strain")
    axes.set_ylabel("pressure per pixel [Pa/px]")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=8)


def save_calibration_plot(calibration: FoamCalibration, path: Path | str) -> None:
    """Write both plots side by side; the file extension determines the format.

    Parameters
    ----------
    calibration
        Result of the calibration, with its data.
    path
        File to write; its extension determines the format.
    """
    figure, (left, right) = new_figure(1, 2, size=(10, 4), layout="constrained")
    draw_strain_stress(left, calibration)
    left.set_title("Strain and stress", fontsize=10)
    draw_sensitivity(right, calibration)
    right.set_title("Sensitivity to the image (d = 0.3 m, 70°, f = 1800 px)", fontsize=10)
    save_figure(path, figure, dpi=130)
