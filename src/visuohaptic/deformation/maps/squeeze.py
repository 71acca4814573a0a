"""Squeeze of a container: force-deformation curve, and the limits of linearity, yield and stability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.errors import InputError
from ...core.files import literal, new_figure, save_figure, write_text
from ...core.ranges import POSITIVE, check_numbers, within
from ..nonlinear.contents import Contents
from ..shapes.mesher import ShellObject
from ..shells.shell_material import YIELD_Pa
from .confidence_band import stiffness_band
from .grasp_curves import GraspCurve, PinchPlane, nearest_vertex, side_vertex

#: Relative deviation of the secant stiffness from the initial stiffness, above which the curve is not linear.
LINEAR_FRACTION = 0.1
#: Default number of points of a curve.
POINTS = 8
_COLUMNS = ("deformation_m", "force_N", "first_m", "second_m", "gauge_Pa", "stress_Pa")


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeResult:
    """A force-deformation curve and its limits; NaN for a limit that does not occur within the curve."""

    curve: GraspCurve
    stiffness_N_per_m: float  #: undeformed: force of one tip per mean deformation of both
    stiffness_sigma_N_per_m: float  #: from wall thickness and modulus together
    linear_to_N: float  #: largest computed force at which the secant is within a tenth of that stiffness
    yield_stress_Pa: float  #: strength of the material; NaN if unknown
    yield_force_N: float  #: force at which the stress reaches the strength, interpolated between two points
    buckling_force_N: float  #: above it the wall buckles: the next state is at a lower force, or unstable
    distance_m: float  #: distance from the requested point to the pinched vertex

    @property
    def remarks(self) -> tuple[str, ...]:
        """Summary for display."""
        curve, found = self.curve, []
        if not len(curve.force_N):
            return ("no point of the curve was reached", f"ends early: {curve.reason}")
        if np.isfinite(self.linear_to_N):
            found.append(f"linear to {self.linear_to_N:.3g} N (within {100 * LINEAR_FRACTION:.0f} %)")
        else:
            found.append("not linear at the smallest deformation")
        if np.isfinite(self.buckling_force_N):
            found.append(f"buckles at {self.buckling_force_N:.3g} N")
        if np.isfinite(self.yield_force_N):
            found.append(f"yields at {self.yield_force_N:.3g} N: beyond it a dent stays")
        elif np.isnan(self.yield_stress_Pa):
            found.append("the yield strength of its material is not known")
        else:
            peak = 1e-6 * float(np.max(curve.stress_Pa, initial=0.0))
            found.append(f"stays elastic: {peak:.3g} of {1e-6 * self.yield_stress_Pa:.3g} MPa")
        if not curve.complete:
            found.append(f"ends early: {curve.reason}")
        return tuple(found)


def squeeze(
    container: ShellObject,
    *,
    point_m: Sequence[float] | None = None,
    side: str = "x+",
    height_m: float | None = None,
    force_N: float | None = None,
    deformation_m: float | None = None,
    points: int = POINTS,
    contents: Contents | None = None,
) -> SqueezeResult:
    """Pinch a container up to a force or a deformation.

    Parameters
    ----------
    container
        Parametric or imported container, see :func:`.load_object`.
    point_m
        Location of the first tip [m]: the nearest vertex is pinched, the second tip is opposite.
    side, height_m
        Alternative: side x+, x-, y+ or y-, and height above the foot [m]; half the height by default.
    force_N
        Largest force of one tip [N].
    deformation_m
        Alternative: largest mean deformation of both tips [m]; 5 mm by default.
    points
        Number of points of the curve, equally spaced.
    contents
        Contents; open by default.

    Returns
    -------
    SqueezeResult
        The resolution of the forces is the spacing of the points; yield is interpolated.

    Raises
    ------
    InputError
        Both limits given, a limit that is not positive, or a location that is fixed or has no opposite wall.

    Examples
    --------
    >>> from visuohaptic.deformation.shapes import load_object
    >>> found = squeeze(load_object("cup", around=16), deformation_m=1e-3, points=2)
    >>> bool(found.curve.force_N[1] > found.curve.force_N[0] > 0)
    True
    """
    if force_N is not None and deformation_m is not None:
        raise InputError("squeeze", "found a force and a deformation, expected one of them")
    limit = force_N if force_N is not None else 0.005 if deformation_m is None else deformation_m
    check_numbers("squeeze", POSITIVE, force_N=force_N, deformation_m=deformation_m)
    check_numbers("squeeze", within(2, 100), points=points)
    vertex = side_vertex(container, side, height_m) if point_m is None else nearest_vertex(container, point_m)
    place = container.mesh.vertices_m[vertex]
    steps = [limit * step / points for step in range(1, points + 1)]
    plane = PinchPlane.through(container, vertex)
    curve = (
        plane.curve(vertex, deformation_m=steps, contents=contents)
        if force_N is None
        else plane.curve(vertex, force_N=steps, contents=contents)
    )

    def initial(body: ShellObject) -> np.ndarray:
        of_body = plane
        if body is not container:
            part = plane.part.with_wall(body, plane.angle_rad)
            of_body = PinchPlane(body, plane.angle_rad, part=part)
        return 1.0 / of_body.linear(vertex, contents).mean(keepdims=True)

    stiffness, sigma = (float(value[0]) for value in stiffness_band(container, initial, contents))
    strength = YIELD_Pa.get(container.material.name, float("nan"))
    secant = np.abs(curve.force_N / (stiffness * curve.deformation_m) - 1) <= LINEAR_FRACTION
    straight = len(secant) if secant.all() else int(np.argmin(secant))
    return SqueezeResult(
        curve,
        stiffness,
        sigma,
        float(curve.force_N[straight - 1]) if straight else float("nan"),
        strength,
        _crossing(curve, strength),
        _limit_force(curve),
        0.0 if point_m is None else float(np.linalg.norm(place - np.asarray(point_m, dtype=float))),
    )


def _crossing(curve: GraspCurve, strength: float) -> float:
    """Force at which the stress first reaches a strength, NaN if it does not."""
    stress, force = np.r_[0.0, curve.stress_Pa], np.r_[0.0, curve.force_N]
    over = np.flatnonzero(stress > strength)
    if not len(over):
        return float("nan")
    last = int(over[0])
    return float(np.interp(strength, stress[last - 1 : last + 1], force[last - 1 : last + 1]))


def _limit_force(curve: GraspCurve) -> float:
    """Force before the first drop, snap-through or unstable state; NaN if there is none."""
    force = np.r_[0.0, curve.force_N]
    lost = np.flatnonzero((np.diff(force) < 0) | ~curve.stable)
    return float(force[: lost[0] + 1].max()) if len(lost) else float("nan")


def save_squeeze(path: Path | str, found: SqueezeResult) -> None:
    """Write the curve as CSV, including the undeformed state.

    Parameters
    ----------
    path
        CSV to write.
    found
        Result of a squeeze.
    """
    table = np.stack([getattr(found.curve, name) for name in _COLUMNS], axis=1)
    rows = [",".join(_COLUMNS), ",".join(["0"] * len(_COLUMNS))]
    rows += [",".join(f"{value:.9g}" for value in row) for row in table]
    write_text(path, "\n".join(rows) + "\n")


def plot_squeeze(path: Path | str, found: SqueezeResult, title: str = "") -> None:
    """Plot force against deformation, with the initial stiffness and its standard deviation.

    Parameters
    ----------
    path
        Figure to write, .png, .pdf or .svg.
    found
        Result of a squeeze.
    title
        Title of the figure.
    """
    figure, (axes,) = new_figure(1, 1, size=(6, 4), layout="constrained")
    depth = np.r_[0.0, found.curve.deformation_m]
    force = np.r_[0.0, found.curve.force_N]
    spread = found.stiffness_sigma_N_per_m / found.stiffness_N_per_m
    axes.fill_between(
        1e3 * depth, force * (1 - spread), force * (1 + spread), alpha=0.2, label="1 sigma of the wall"
    )
    axes.plot(1e3 * depth, force, "o-", label="force")
    axes.plot(1e3 * depth, found.stiffness_N_per_m * depth, "--", label="linear")
    for value, name in ((found.yield_force_N, "yields"), (found.buckling_force_N, "buckles")):
        if np.isfinite(value):
            axes.axhline(value, linestyle=":", label=f"{name} at {value:.3g} N")
    axes.set(xlabel="deformation of one side [mm]", ylabel="force of one tip [N]", title=literal(title))
    axes.set_ylim(0, 1.1 * max(float(force.max()) * (1 + spread), 1e-3))
    axes.legend()
    save_figure(path, figure)
