"""Boundary laws compared with independent continuum solutions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.worlds import foam_mechanics

from benchmarks import foam_tension
from visuohaptic.core import CalibrationError
from visuohaptic.sensing.foam import FoamContour, read_profile
from visuohaptic.sensing.foam.material import (
    PlateRecord,
    StrainStress,
    Tension,
    calibrate_foam,
    calibrate_tension,
    contour_force,
    read_plate,
    read_strain_stress,
    softening,
)
from visuohaptic.sensing.foam.strip import StripGeometry

SPACING, NOISE = 0.003, 1e-5  #: as the camera sees it


def mirrored(step):
    """Full contour of a half strip: (force, s, delta)."""
    _, force, s, delta = step
    return force, np.concatenate([-s[:0:-1], s]), np.concatenate([delta[:0:-1], delta])


def read(force, s, delta, material, phase, rng, boundary="tension"):
    """Relative error of the force from a sparse, noisy contour."""
    at = np.arange(s[0] + phase * SPACING, s[-1], SPACING)
    seen = np.interp(at, s, delta) + rng.normal(0, NOISE, at.size)
    contour = FoamContour(at, seen, np.full(at.size, NOISE), np.ones(at.size, bool))
    reading = read_profile(contour, material, boundary=boundary)
    return reading.force_N / force - 1, reading


def shear_modulus(strain, stress_Pa):
    """Of a compressed column, from its stress; ``test_shear_modulus_against_a_sheared_block`` shows it."""
    return stress_Pa * (1 - strain) / (strain * (2 - strain))


def test_softening_is_the_derivative_of_the_shear_modulus(material):
    strain, step = np.linspace(0.01, 0.55, 30), 1e-6
    g = [shear_modulus(x, material.stress(x)) for x in (strain + step, strain - step)]
    np.testing.assert_allclose(
        softening(material.loading, strain),
        -(g[0] - g[1]) / (2 * step) / 6 * (1 + 2.5 * np.exp(-strain / 0.027)),
        rtol=1e-4,
    )


def test_shear_modulus_against_a_sheared_block(continuum, material):
    """Energy of a compressed and sheared block of the exact law, by its principal stretches."""
    foam = continuum.Foam((33600, 150), (12, -2))

    def energy(strain, shear):
        stretches = np.linalg.svd(np.array([[1.0, 0.0], [shear, 1 - strain]]), compute_uv=False)
        return sum(
            2 * m / a**2 * (x**a - 1 - a * np.log(x))
            for x in stretches
            for m, a in zip(foam.mu, foam.alpha, strict=True)
        )

    for strain in (0.05, 0.2, 0.4):
        shear = 1e-3  # the energy is quadratic to 1e-6
        found = 2 * (energy(strain, shear) - energy(strain, 0.0)) / shear**2
        np.testing.assert_allclose(found, shear_modulus(strain, foam.stress(strain)), rtol=1e-3)


@pytest.mark.slow
def test_other_foams_and_bodies_without_any_tension_calibration(continuum, make_log):
    """The default ratio must serve foams and bodies that it was not chosen on."""
    rng = np.random.default_rng(2)
    foams = (continuum.Foam((25000, 500), (10, -1)), continuum.Foam((40000, 200), (15, -2)))
    depths = (0.002, 0.005, 0.009)
    enlarged, tension = [], []
    for foam in foams:
        material = calibrate_foam(make_log(foam.stress), width_m=0.02, height_m=0.01).material
        for body, fine in ((continuum.cylinder(0.04), 7e-4), (continuum.cylinder(0.1), 7e-4)):
            for step in continuum.press(foam, body, depths, length=0.075, fine=fine, rows=8):
                force, s, delta = mirrored(step)
                for phase in (0.1, 0.6):
                    enlarged.append(read(force, s, delta, material, phase, rng, "enlarged")[0])
                    tension.append(read(force, s, delta, material, phase, rng)[0])
    # The enlarged law over-reads by 2 to 6 % here; what stays must be a third of that and below 2.5 %.
    assert len(tension) == 24
    assert np.abs(tension).max() < 0.025
    assert np.sqrt(np.mean(np.square(tension))) < 0.4 * np.sqrt(np.mean(np.square(enlarged)))


@pytest.mark.data
@pytest.mark.parametrize("source", ["default", "plate_4cm", "cylinder_12cm"])
def test_delivered_continuum_cross_calibrated(data, source):
    """Calibrate with one body (a few depths), read the other: 2.5 % owed at each depth beyond 1 mm."""
    folder = data / "foam_continuum"
    rng = np.random.default_rng(4)
    material = calibrate_foam(
        read_strain_stress(folder / "strain_stress.csv"), width_m=0.02, height_m=0.01
    ).material
    if source != "default":
        records = read_plate(folder / f"{source}.csv")
        material = replace(material, tension=calibrate_tension(records[3:8:2], material))
        assert material.tension.calibrated
        assert 0.15 < material.tension.ratio < 0.4
    for body in ("plate_4cm", "cylinder_12cm"):
        if body == source:
            continue
        for record in read_plate(folder / f"{body}.csv"):
            if record.depth_m <= 0.0011:
                continue
            errors, sampling = zip(
                *(
                    read(record.force_N, record.s_m, record.delta_m, material, phase, rng)
                    for phase in np.arange(8) / 8
                ),
                strict=True,
            )
            # Law: mean over the phases of the points. 1.2 % at the deepest plate, 1 % elsewhere.
            assert abs(np.mean(errors)) < 0.012, (body, record.depth_m)
            # One frame: a plate's edge lies anywhere between two points, which the budget declares.
            for error, reading in zip(errors, sampling, strict=True):
                assert abs(error) < 0.025 + 1e-3, (body, record.depth_m)
                assert abs(error) * record.force_N < 4 * reading.budget.total_N


@pytest.mark.data
def test_touch_interval(data, material):
    """The part that bears load ends within two points of the plate's edge up to 8 mm."""
    rng = np.random.default_rng(0)
    for record in read_plate(data / "foam_continuum" / "plate_4cm.csv")[1:9]:
        _, reading = read(record.force_N, record.s_m, record.delta_m, material, 0.3, rng)
        (contact,) = reading.contacts
        assert contact.touch_start_m == pytest.approx(0.105, abs=2 * SPACING)
        assert contact.touch_end_m == pytest.approx(0.145, abs=2 * SPACING)
        assert contact.s_start_m < 0.096
        assert contact.s_end_m > 0.154


def test_wide_plate_and_wrong_force_are_refused(material):
    s = np.linspace(0, 0.25, 500)
    wide = [PlateRecord(d, 1.0, s, np.full(500, d)) for d in (0.002, 0.004)]
    with pytest.raises(CalibrationError, match="use a plate narrower"):
        calibrate_tension(wide, material)
    bump = [0.004 * np.exp(-(((s - 0.125) / 0.02) ** 2)), 0.006 * np.exp(-(((s - 0.125) / 0.02) ** 2))]
    forces = [2 * contour_force(s, delta, material)[0] for delta in bump]
    records = [PlateRecord(0.004, f, s, delta) for f, delta in zip(forces, bump, strict=True)]
    with pytest.raises(CalibrationError, match="the forces differ by 50 %"):
        calibrate_tension(records, material)
    with pytest.raises(CalibrationError, match="found 0 usable depths"):
        calibrate_tension([], material)


def test_tension_calibration_recovers_its_own_ratio(material):
    s = np.linspace(0, 0.25, 1001)
    records = []
    for depth in (0.003, 0.005, 0.008):
        delta = depth * np.exp(-(((s - 0.125) / 0.015) ** 2))
        enlarged, relief = contour_force(s, delta, material)
        records.append(PlateRecord(depth, enlarged - 0.35 * relief, s, delta))
    # Sparse sampling of a smooth bump changes the slopes by about (3 mm / 15 mm)^2 / 6.
    assert calibrate_tension(records, material).ratio == pytest.approx(0.35, rel=0.02)


def test_the_plate_is_a_press_of_its_own(material):
    """It differs from the calibrating presses by as much as these do: 3 %, which is no tension of 0.2."""
    common, s = 0.03 * material.loading.parameters, np.linspace(0, 0.25, 1001)
    loading = replace(material.loading, covariance=material.loading.covariance + np.outer(common, common))
    scattered = replace(material, loading=loading)
    bumps = [depth * np.exp(-(((s - 0.125) / 0.015) ** 2)) for depth in (0.003, 0.005, 0.008)]
    forces = [contour_force(s, delta, material) for delta in bumps]
    rng, z = np.random.default_rng(12), []
    for _ in range(60):
        gain = 1.0 + 0.03 * rng.standard_normal()
        records = [
            PlateRecord(float(delta.max()), gain * (enlarged - 0.35 * relief), s, delta)
            for delta, (enlarged, relief) in zip(bumps, forces, strict=True)
        ]
        found = calibrate_tension(records, scattered)
        z.append((found.ratio - 0.35) / found.sigma)
    # 60 draws know their scatter to 9 %; the law's own error, which is declared as well, is not drawn.
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.2


def test_what_a_plate_leaves_open_of_tension_and_expansion_cancels_in_forces(material) -> None:
    """Forces of a calibrating plate that scatter by 0.2 %, and by the law's error, which its depths share."""
    exact = replace(material.loading, covariance=0.0 * material.loading.covariance)
    known = replace(material, loading=exact, tension=Tension(ratio=0.23, lateral=0.0, lateral_sigma=0.0))
    s = np.arange(-0.1, 0.1, 2e-4)

    def flank(depth_m: float, half_m: float):
        return depth_m * np.exp(-np.maximum(np.abs(s) - half_m, 0.0) / 0.006)

    plates = [flank(depth_m, 0.02) for depth_m in (0.0015, 0.003, 0.005, 0.0075)]
    true_N = [e - 0.23 * r for e, r in (contour_force(s, delta, known) for delta in plates)]
    sheared_N = np.array([borne(s, delta, known) for delta in plates])
    points = np.arange(-0.099, 0.099, 0.003)
    body = np.interp(points, s, flank(0.007, 0.01))
    contour = FoamContour(points, body, np.full(len(body), 1e-9), np.ones(len(body), bool))
    rng, found, declared = np.random.default_rng(11), [], []
    for _ in range(60):
        weighed = true_N * (1.0 + 0.002 * rng.standard_normal(4)) + 0.05 * rng.standard_normal() * sheared_N
        records = [PlateRecord(float(d.max()), float(f), s, d) for f, d in zip(weighed, plates, strict=True)]
        reading = read_profile(contour, replace(known, tension=calibrate_tension(records, known)))
        found.append(reading.force_N)
        declared.append(reading.budget.calibration_N)
    # 60 draws tell a standard deviation to a tenth; the fit adds the residuals, as large as the scatter, to its variance.
    # 1.3; without the correlation 1.7.
    assert 0.9 < np.median(declared) / np.std(found) < 1.5


def borne(s, delta, material):
    """Force that sheared foam bears, ``h * integral m sin(theta)^2 ds`` [N]."""
    sine2 = np.sin(np.arctan(np.gradient(delta, s))) ** 2
    return material.height_m * np.trapezoid(material.loading.stress(delta / material.width_m) * sine2, s)


def test_foam_that_spreads_sideways_is_right_after_a_plate_was_weighed() -> None:
    """A Poisson ratio of 0.12: 7 % too much by a curve under a plate that covers the strip, which its sigma covers."""
    foam = foam_mechanics.Foam(beta=0.15, length_m=0.12)
    only, depths = calibrated(foam), np.array([0.0015, 0.003, 0.005, 0.0075])
    bodies = [
        (foam_mechanics.bar(0.017, 0.003), [(-0.024, -0.014), (0.014, 0.024)]),
        (foam_mechanics.cylinder(0.03), [(-0.02, 0.02)]),
    ]
    plate, cylinder = (
        foam_mechanics.press(foam, shape, depths, spans_m=spans, fine_m=1.5e-3, layers=3)
        for shape, spans in bodies
    )
    records = [PlateRecord(p.depth_m, p.force_N, p.y_m, p.delta_m) for p in plate]
    weighed = replace(only, tension=calibrate_tension(records, only))
    error = {}
    for name, material in (("only", only), ("weighed", weighed)):
        error[name], sigma = foam_tension.errors(cylinder[-1], material)
        assert abs(error[name]) < 3.0 * sigma
    assert error["only"] > 0.05
    # Both meshes are 0.3 % stiffer than their limit, bodies scatter by as much.
    assert abs(error["weighed"]) < 0.012


def test_foam_expands_less_under_a_wide_body() -> None:
    """Plates of 4 and 20 cm on foam with a Poisson ratio of 0.12: one lambda for both, which the law's sigma knows to 5 %.

    Without the decay from the flanks, the wide plate was read 8 % too low.
    """
    foam = foam_mechanics.Foam(beta=0.15, length_m=0.3)
    only, depths = calibrated(foam), np.array([0.0015, 0.003, 0.005, 0.0075])
    narrow, wide = (
        foam_mechanics.press(
            foam, foam_mechanics.bar(half - 0.003, 0.003), depths, fine_m=1.5e-3, layers=3,
            spans_m=[(-half - 0.008, -half + 0.006), (half - 0.006, half + 0.008)],
        )
        for half in (0.02, 0.1)
    )  # fmt: skip
    found = [
        calibrate_tension([PlateRecord(p.depth_m, p.force_N, p.y_m, p.delta_m) for p in plate], only)
        for plate in (narrow, wide)
    ]
    assert found[1].lateral / found[0].lateral == pytest.approx(1.0, abs=0.08)
    weighed = replace(only, tension=found[0])
    for state in wide[1:]:
        error, sigma = foam_tension.errors(state, weighed)
        # Both meshes are 0.3 % stiffer than their limit.
        assert abs(error) < 0.012
        assert abs(error) < 3.0 * sigma


def calibrated(foam):
    """Material of a continuum foam whose curve alone is known."""
    strain = np.linspace(0.0, 0.6, 61)
    log = StrainStress(strain, foam.plate_stress_Pa(strain), np.ones(61, dtype=np.int64))
    return calibrate_foam(log, width_m=foam.width_m, height_m=foam.height_m).material


def test_foam_beside_a_free_end_gives_way() -> None:
    """A plate 10 mm from the end of the strip: its outer flank loses nothing by shear, 1.5 % of the force."""
    foam = foam_mechanics.Foam(length_m=0.16)
    material, depths = calibrated(foam), np.array([0.0015, 0.003, 0.0045])
    shape, spans = foam_mechanics.bar(0.012, 0.003, 0.055), [(0.034, 0.047), (0.063, 0.08)]
    strip = StripGeometry.straight(foam.length_m, foam.width_m)
    for state in foam_mechanics.press(foam, shape, depths, spans_m=spans, fine_m=1e-3, layers=4):
        delta = np.interp(strip.s_m, state.y_m, state.delta_m)
        seen = strip.s_m, delta, np.full(len(delta), NOISE), np.ones(len(delta), bool)
        error = [
            read_profile(FoamContour(*seen, end_cells_m=cells), material).force_N / state.force_N - 1.0
            for cells in ((0.0, 0.0), strip.end_cells_m)
        ]
        # Two standard deviations: a tenth of what shear takes from the inner flank, 2 %, and a fifth of a percent.
        assert abs(error[1]) < 0.008
        assert error[0] < error[1] - 0.007


def test_shallow_and_curved_bodies_are_right_by_the_curve_alone() -> None:
    """Cylinders of 2 and 6 cm at strains of 0.05 to 0.2: foam that is hardly compressed is hardly relieved of its shear."""
    foam = foam_mechanics.Foam(length_m=0.12)
    material, depths = calibrated(foam), np.array([0.001, 0.002, 0.004])
    for radius in (0.02, 0.06):
        spans = [(-0.6 * radius, 0.6 * radius)]
        for state in foam_mechanics.press(
            foam, foam_mechanics.cylinder(radius), depths, spans_m=spans, fine_m=1.5e-3, layers=4
        ):
            error, sigma = foam_tension.errors(state, material)
            assert abs(error) < 0.008
            assert abs(error) < 2.5 * sigma


def test_tension_bounds():
    with pytest.raises(ValueError, match=r"ratio: found -1\.0, expected 0 to 5"):
        Tension(-1.0, 0.1)
