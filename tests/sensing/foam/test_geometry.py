"""The strip's back contour: lengths, normals and the middle line, against plane geometry."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.sensing.foam.strip import StripGeometry


def test_straight_strip_runs_along_y() -> None:
    strip = StripGeometry.straight(0.25, 0.02, 0.003)
    assert np.allclose(np.diff(strip.s_m), np.diff(strip.s_m)[0])
    assert np.allclose(strip.back_m[:, 0], 0.0)
    assert np.allclose(strip.back_m[:, 1], strip.s_m)
    assert np.allclose(strip.front_m - strip.back_m, [0.02, 0.0])
    # Half a spacing is left on both ends: the trapezoids of all points cover the whole strip.
    spacing = np.diff(strip.s_m)[0]
    assert strip.s_m[-1] - strip.s_m[0] + spacing == pytest.approx(0.25)


def test_bent_strip_lies_on_its_circle_and_counts_along_the_middle() -> None:
    radius, width, length = 0.17, 0.02, 0.25
    strip = StripGeometry.bent(length, radius, width)
    centre = np.array([-radius, 0.0])
    assert np.allclose(np.linalg.norm(strip.back_m - centre, axis=1), radius)
    assert np.allclose(np.linalg.norm(strip.front_m - centre, axis=1), radius + width)
    angle = np.arctan2(strip.back_m[:, 1], strip.back_m[:, 0] + radius)
    assert np.allclose(angle * (radius + width / 2), strip.s_m)


def test_general_curve_agrees_with_the_circle() -> None:
    radius, width = 0.17, 0.02
    angle = np.linspace(-0.8, 0.8, 60)
    points = np.column_stack([radius * np.cos(angle) - radius, radius * np.sin(angle)])
    general = StripGeometry.along(points, width)
    circle = StripGeometry.bent(1.6 * radius, radius, width)
    assert general.s_m == pytest.approx(circle.s_m, abs=2e-6)
    # A cubic spline through 60 points of the arc (2.7 degrees apart) is good to well under a micrometre
    # inside; its not-a-knot ends are the worst place.
    assert np.abs(general.back_m - circle.back_m).max() < 2e-6
    assert np.abs(general.outward - circle.outward).max() < 1e-3


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: StripGeometry.straight(-0.1, 0.02), "length_m: found -0.1, expected a positive length"),
        (lambda: StripGeometry.straight(0.25, 0.02, 0.1), "gives 2 points, expected 8 to 2000"),
        (lambda: StripGeometry.bent(0.25, 0.01, 0.02), "radius_m: found 0.01, expected more than width_m"),
        (lambda: StripGeometry.bent(0.9, 0.1, 0.02), "covers more than half of the circle"),
        (lambda: StripGeometry.along(np.zeros((5, 2)), 0.02), "two neighbouring points are the same"),
    ],
)
def test_impossible_strips_are_refused(make, said) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert said in str(caught.value)
