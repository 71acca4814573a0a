"""Published compressions: designs are held out, forecasts are those of a Gaussian, and bands hold on the real prints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
from tests.recognition.test_compressions import written

from benchmarks import gcs_compressions
from visuohaptic.recognition import Compression, HapticClassifier, read_compressions
from visuohaptic.recognition.touch import evidence


def printed(name: int, material: str, taper: float) -> Compression:
    return Compression(str(name), material, (0.0,) * 7 + (taper,), 0.02, 6e-4, 2e-3, 0.015)


def test_all_prints_of_a_design_are_learned_or_held_out() -> None:
    prints = [printed(k, "ab"[k % 2], 1 + k // 4) for k in range(400)]  # four of each of a hundred designs
    learned, asked = gcs_compressions.split(prints, 3)
    designs = [{one.design for its in some.values() for one in its} for some in (learned, asked)]
    assert not designs[0] & designs[1]
    assert (len(designs[0]), len(designs[1])) == (70, 30)
    assert sum(len(its) for its in asked.values()) == 120


def test_a_forecast_is_that_of_the_joint_gaussian(tmp_path: Path) -> None:
    """With a single row, by the precision matrix: the conditional mean and variance without a solve of the others."""
    prints = read_compressions(written(tmp_path, forces=False))
    model = HapticClassifier().fit([one.squeezed() for one in prints]).model()
    (row, *others) = np.flatnonzero(model.answer_of == 0)
    model.log_prior[others] = -1e9
    place, value, noise = evidence(model, prints[0].readings())
    k = int(np.flatnonzero(place == gcs_compressions.WAY)[0])
    covariance = model.covariance[row][np.ix_(place, place)] + np.diag(noise)
    precision, away = np.linalg.inv(covariance), value - model.mean[row][place]
    rest = np.arange(len(place)) != k
    for given, mean, variance in (
        (False, model.mean[row][place[k]], covariance[k, k]),
        (
            True,
            model.mean[row][place[k]] - precision[k, rest] @ away[rest] / precision[k, k],
            1 / precision[k, k],
        ),
    ):
        middle, quantile, width = gcs_compressions.forecast(model, 0, prints[0], given=given)
        sigma = np.sqrt(variance)
        assert middle == pytest.approx(np.exp(mean), rel=1e-4)
        assert quantile == pytest.approx(norm.cdf((value[k] - mean) / sigma), abs=1e-6)
        assert width == pytest.approx(2 * np.sinh(norm.ppf(0.95) * sigma), rel=1e-3)


@pytest.mark.data
def test_materials_of_published_prints_and_the_bands_of_their_compression(data: Path) -> None:
    folder = data / "deformation" / "gcs"
    if not folder.is_dir():
        pytest.skip(f"published compressions not found: {folder}")
    prints = read_compressions(folder)
    assert len(prints) == 12_705
    assert sorted({one.material for one in prints}) == [
        "Armadillo", "Cheetah", "Chinchilla", "NinjaFlex", "PETG", "PLA",
    ]  # fmt: skip
    rows = gcs_compressions.figures(20, [gcs_compressions.fold(prints, 0, 20, 10)])
    right, _, readings, alone, given, error = (row["ours"] for row in rows)
    assert right > 1 / 6 + 2 * np.sqrt(
        5 / 36 / 60
    )  # more than a guess, with two standard errors of 60 prints
    # Not below 0.9 by three standard errors of 60 prints: the bands are known to be wide.
    assert min(readings, alone, given) >= 0.9 - 3 * np.sqrt(0.09 / 60)
    assert error < 0.1
