"""Colours of stiffness maps are a published sequential scale."""

from __future__ import annotations

import matplotlib
import numpy as np

from visuohaptic.viewer.stage import scale_colours


def test_the_scale_is_colorbrewers_orange_to_red() -> None:
    """Five of its nine colours, with equal steps between them; matplotlib has the same ones."""
    fraction = np.linspace(0.0, 1.0, 5)
    expected = 255.0 * matplotlib.colormaps["OrRd"](fraction)[:, :3]
    assert np.abs(scale_colours(fraction, 0.0, 1.0).astype(float) - expected).max() <= 2.0
