"""A run beside a reference with a clock and a noise of its own, made by formulas."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core.errors import InputError
from visuohaptic.io.sinks import read_reference_table
from visuohaptic.report import ForceRecord, compare_forces, write_comparison


def press_N(t_s):
    """Two pushes of a hand."""
    return 3.0 * np.exp(-(((t_s - 1.5) / 0.5) ** 2)) + 2.0 * np.exp(-(((t_s - 3.6) / 0.3) ** 2))


def records(seed=0, *, offset_s=0.0, gain=1.0, sigma_N=0.05, declared=0.05):
    rng = np.random.default_rng(seed)
    t_s, scale_s = np.arange(150) / 30.0, np.arange(400) / 70.0
    force_N = gain * press_N(t_s) + rng.normal(0.0, sigma_N, len(t_s))
    run = ForceRecord("foam", t_s, force_N, np.full(len(t_s), declared), np.ones(len(t_s), bool))
    scale = ForceRecord(
        "scale", scale_s + offset_s, press_N(scale_s), np.zeros(len(scale_s)), np.ones(len(scale_s), bool)
    )
    return run, scale


def test_the_offset_of_the_clocks_is_found_with_its_sigma() -> None:
    errors, sigmas = [], []
    for seed in range(40):
        found = compare_forces(*records(seed, offset_s=0.83))
        errors.append(found.offset_s - 0.83)
        sigmas.append(found.offset_sigma_s)
    # 40 normal draws: the root of the mean of their squares is within a third of the truth in 99.7 %.
    ratio = np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(sigmas)))
    assert 0.65 < ratio < 1.4
    assert np.mean(sigmas) < 0.005  # 150 samples, 0.05 N of noise beside slopes of 5 N/s


def test_bias_gain_and_an_honest_sigma() -> None:
    found = compare_forces(*records(gain=1.05), offset_s=0.0)
    # Noise of 0.05 N beside a reference of 1.2 N rms in 150 samples: the gain is good to 0.4 %.
    assert found.gain == pytest.approx(1.05, abs=0.015)
    assert found.offset_sigma_s == 0.0
    honest = compare_forces(*records(1), offset_s=0.0)
    assert honest.rms_over_sigma == pytest.approx(1.0, abs=0.2)  # 3 sigma of 150 samples
    assert honest.coverage_90 == pytest.approx(0.9, abs=0.08)
    assert honest.bias_N == pytest.approx(0.0, abs=0.015)
    bold = compare_forces(*records(1, declared=0.02), offset_s=0.0)
    assert bold.rms_over_sigma == pytest.approx(2.5, abs=0.4)


def test_the_band_of_90_percent_ends_at_1_64_sigma_and_the_search_at_250_000_steps() -> None:
    run, scale = records(sigma_N=0.0)
    # The truth between the scale's samples is a few millinewtons off: 0.03 sigma of 0.1 N.
    off = np.where(np.arange(len(run.t_s)) % 2, 1.55, -1.75) * 0.1
    run = ForceRecord("foam", run.t_s, run.force_N + off, np.full(len(off), 0.1), run.valid)
    assert compare_forces(run, scale, offset_s=0.0).coverage_90 == pytest.approx(0.5, abs=0.03)
    with pytest.raises(InputError, match=r"at most 4166\.67 s"):  # half a period of 30 Hz each
        compare_forces(run, scale, max_offset_s=1e5)


def test_unread_frames_are_not_compared_and_counted() -> None:
    run, scale = records()
    valid = run.valid.copy()
    valid[30:60] = False
    force_N = np.where(valid, run.force_N, np.nan)
    found = compare_forces(ForceRecord("foam", run.t_s, force_N, run.sigma_N, valid), scale, offset_s=0.0)
    assert found.compared == 120
    assert found.read == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("offset_s", "max_offset_s", "words"),
    [(0.0, 2.0, "does not change|end of the search"), (50.0, 2.0, "less than half|ten or more")],
)
def test_what_cannot_be_compared_is_one_line(offset_s, max_offset_s, words) -> None:
    run, scale = records(offset_s=offset_s)
    if offset_s == 0.0:
        scale = ForceRecord("scale", scale.t_s, np.ones(len(scale.t_s)), scale.sigma_N, scale.valid)
        run = ForceRecord("foam", run.t_s, np.ones(len(run.t_s)), run.sigma_N, run.valid)
    with pytest.raises(InputError, match=words) as caught:
        compare_forces(run, scale, max_offset_s=max_offset_s)
    assert "\n" not in str(caught.value)


def test_the_page_stands_alone(tmp_path) -> None:
    page = write_comparison(compare_forces(*records()), tmp_path / "compare.html").read_text()
    assert page.count("<figure") == 2
    assert "inside the declared 90 % interval" in page


@pytest.mark.parametrize(
    ("head", "row", "force_N"),
    [
        ("t_s,mass_g", "1,100", 0.980665),
        ("mass_kg,t_s,battery", "0.1,1,full", 0.980665),
        ("t_s,force_N,force_sigma_N", "1,2.5,0.1", 2.5),
    ],
)
def test_a_scale_is_read_in_its_unit(tmp_path, head, row, force_N) -> None:
    path = tmp_path / "scale.csv"
    path.write_text(f"{head}\n{row}\n")
    found = read_reference_table(path)
    assert found["t_s"] == pytest.approx([1.0])
    assert found["force_N"] == pytest.approx([force_N])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time,weight\n0,1\n", "found columns time, weight"),
        ("t_s,mass_g\n1,5\n0,5\n", "line 3"),
        ("t_s,mass_g\n1,heavy\n", "line 2"),
        ("mass_g\n1\n", "missing: t_s"),
    ],
)
def test_what_is_no_reference_is_told(tmp_path, text, words) -> None:
    path = tmp_path / "scale.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_reference_table(path)
