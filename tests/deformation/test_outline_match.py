"""The nearest variant of a class is the one from which the outline was generated."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.deformation.shapes import container_outline, draw_variants, load_container, nearest_variant
from visuohaptic.deformation.shapes.container import Base, ContainerDescription, WallSection
from visuohaptic.deformation.shapes.variants import axis_ratio


def test_a_variant_is_found_by_its_own_outline() -> None:
    base = load_container("bottle")
    chosen = draw_variants(base, 6, 0)[4]
    outline = container_outline(chosen)
    assert np.all(np.diff(outline[:, 1]) > 0)
    assert nearest_variant(base, outline, count=6) == chosen


def test_the_ratio_of_the_axes_is_that_of_the_whole_wall() -> None:
    assert axis_ratio(load_container("bottle").middle()) == pytest.approx(1.0)
    foot = Base(shape="ellipse", radius=(0.04, 0.04), radius_y=(0.02, 0.02))
    even = ContainerDescription(base=foot, sections=[WallSection(height=(0.1, 0.1))])
    assert axis_ratio(even) == pytest.approx(0.5, rel=1e-3)
    # From 0.5 at the foot to 1 at the top, evenly over the height; without foot and closure, their mean is at 0.475 of it.
    widens = WallSection(height=(0.1, 0.1), radius=(0.04, 0.04), radius_y=(0.04, 0.04))
    assert axis_ratio(even.model_copy(update={"sections": [widens]})) == pytest.approx(
        0.5 + 0.5 * 0.475, rel=0.02
    )
