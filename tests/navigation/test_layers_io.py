"""Layers survive a round trip: exactly where promised, to half a step otherwise, including infinities and gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from visuohaptic.core import InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.files import load_layer, save_layer

GRID = OccupancyMap(np.zeros((7, 11), np.int8), 0.05, (1.0, -2.0, 3.14))


@settings(max_examples=40, deadline=None)
@given(
    values=hnp.arrays(
        np.float32,
        (7, 11),
        elements=st.floats(-1e6, 1e6, width=32) | st.sampled_from([np.nan, np.inf, -np.inf]),
    )
)
def test_floats_to_half_a_step(tmp_path_factory: pytest.TempPathFactory, values: np.ndarray) -> None:
    path = tmp_path_factory.mktemp("layer") / "cost.yaml"
    save_layer(path, values, GRID, unit="s/m")
    back = load_layer(path)
    finite = values[np.isfinite(values)].astype(np.float64)
    step = (finite.max() - finite.min()) / 65532 if finite.size else 0.0
    np.testing.assert_array_equal(np.isfinite(back.values), np.isfinite(values))
    # Half a step, and the rounding of the result to float32.
    np.testing.assert_allclose(back.values, values, rtol=1e-6, atol=0.5 * step + 1e-6)
    assert (back.origin, back.unit, back.name) == (GRID.origin, "s/m", "cost")
    assert back.resolution_m == pytest.approx(0.05)


@pytest.mark.parametrize(
    "values",
    [
        np.random.default_rng(0).random((7, 11)) > 0.5,
        np.random.default_rng(0).integers(-1, 40, (7, 11)).astype(np.int32),
        np.random.default_rng(0).integers(-1, 60_000, (7, 11)).astype(np.int32),
        np.full((7, 11), 42, np.int8),
    ],
    ids=["bool", "8 bit", "16 bit", "constant"],
)
def test_whole_numbers_exactly(tmp_path: Path, values: np.ndarray) -> None:
    save_layer(tmp_path / "regions.yaml", values, GRID)
    back = load_layer(tmp_path / "regions.yaml").values
    np.testing.assert_array_equal(back, values)
    assert (back.dtype == bool) == (values.dtype == bool)


def test_bad_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected \(7, 11\)"):
        save_layer(tmp_path / "a.yaml", np.zeros((3, 3)), GRID)
    with pytest.raises(InputError, match="range of 16 bits"):
        save_layer(tmp_path / "a.yaml", np.arange(77).reshape(7, 11) * 1000, GRID)
    with pytest.raises(InputError, match=r"ends in \.yaml"):
        save_layer(tmp_path / "a.png", np.zeros((7, 11)), GRID)
    save_layer(tmp_path / "a.yaml", np.zeros((7, 11)), GRID)
    text = (tmp_path / "a.yaml").read_text()
    (tmp_path / "b.yaml").write_text(text.replace("a.png", "../a.png"))
    with pytest.raises(InputError, match="next to it"):
        load_layer(tmp_path / "b.yaml")
    (tmp_path / "c.yaml").write_text(text.replace("linear16", "linear8"))
    with pytest.raises(InputError, match="expected a linear8 image"):
        load_layer(tmp_path / "c.yaml")
    picture = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(picture[:-20])
    with pytest.raises(InputError, match=r"is truncated|is damaged"):
        load_layer(tmp_path / "a.yaml")
