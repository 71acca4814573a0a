"""The nearest variant of a class is the one from which the outline was generated."""

from __future__ import annotations

import numpy as np

from visuohaptic.deformation.shapes import container_outline, draw_variants, load_container, nearest_variant


def test_a_variant_is_found_by_its_own_outline() -> None:
    base = load_container("bottle")
    chosen = draw_variants(base, 6, 0)[4]
    outline = container_outline(chosen)
    assert np.all(np.diff(outline[:, 1]) > 0)
    assert nearest_variant(base, outline, count=6) == chosen
