"""The true foam against a continuum simulation, against its own law, and against thermodynamics."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.simulation.foam import (
    REFERENCE_FOAM,
    SOFT_FOAM,
    FoamStrip,
    FoamStripGeometry,
    Outline,
    StripLaw,
)
from visuohaptic.simulation.foam.strip_law import write_calibration_csv

COARSE = FoamStripGeometry(spacing_m=0.001)


def plate(depth_m: float, y_m: float = 0.0, length_m: float = 0.04, yaw_rad: float = 0.0) -> Outline:
    half = 0.05
    return (
        Outline.box((half, 0.0), (2 * half, length_m), 0.0, 0.0005)
        .moved(0, 0, yaw_rad)
        .moved(0.02 - depth_m, y_m)
    )


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "force_rel", "rms_m"),
    [
        # The columns move along their normals only; what is left of the continuum's sideways motion
        # shows at the plate's edges. Measured: 2.1 %, 0.16 mm; 0.9 %, 0.05 mm; 0, 0.
        ("plate_4cm", 0.025, 0.2e-3),
        ("cylinder_12cm", 0.012, 0.06e-3),
        ("large_plate", 1e-4, 1e-5),
    ],
)
def test_continuum(data: Path, name: str, force_rel: float, rms_m: float) -> None:
    table = np.genfromtxt(data / "foam_continuum" / f"{name}.csv", delimiter=",", names=True).reshape(12, 500)
    strip = FoamStrip(FoamStripGeometry(), REFERENCE_FOAM)
    for rows in table:
        depth, s = float(rows["depth_m"][0]), rows["s_m"] - 0.125
        body = {
            "plate_4cm": plate(depth),
            "cylinder_12cm": Outline.disc((0.02 - depth + 0.06, 0.0), 0.06),
            "large_plate": plate(depth, length_m=0.5),
        }[name]
        state = strip.press([body])
        # 3 mN: what the continuum's penalty contact leaves open at the smallest depth.
        assert state.force_N[0] == pytest.approx(rows["force_N"][0], rel=force_rel, abs=3e-3)
        # At the one sample on the plate's edge the contour is vertical and delta means nothing.
        away = np.abs(np.abs(s) - 0.02) > 0.0007 if name == "plate_4cm" else np.ones(500, bool)
        error = np.interp(s, state.s_m, state.delta_m) - rows["delta_m"]
        assert np.sqrt(np.mean(error[away] ** 2)) < rms_m
        far = np.abs(np.abs(s) - 0.02) > 0.0035 if name == "plate_4cm" else away
        assert np.abs(error[far]).max() < 0.65e-3


@pytest.mark.data
def test_law_is_that_of_the_continuum(data: Path) -> None:
    table = np.genfromtxt(
        data / "foam_continuum" / "strain_stress.csv", delimiter=",", skip_header=1, usecols=(0, 1)
    )
    assert REFERENCE_FOAM.uniaxial(table[:, 0]) == pytest.approx(table[:, 1], rel=1e-4, abs=0.06)


def energy_density_Pa(law: StripLaw, strain: np.ndarray) -> np.ndarray:
    """Integral of the loading branch over the strain [J/m^3], in closed form."""
    stretch = 1.0 - strain
    parts = zip(law.mu_Pa, law.alpha, strict=True)
    return sum(2 * mu / a**2 * (stretch**a - 1 - a * np.log(stretch)) for mu, a in parts)


def path_stress_Pa(law: StripLaw, path: np.ndarray) -> np.ndarray:
    """Stress along an infinitely slow path of strains above zero that begins at rest [Pa]."""
    xi, stress = np.ones(len(law.loss)), law.elastic_stress_Pa(path)
    for i, step in enumerate(np.diff(path, prepend=0.0)):
        xi = np.clip(xi + step / np.array(law.loss_strain), -1.0, 1.0)
        stress[i] *= 1.0 - np.array(law.loss) @ (1.0 - xi)
    return stress


def test_law_derivatives() -> None:
    strain = np.linspace(-0.2, 0.7, 19)
    step = 1e-6
    slope = (energy_density_Pa(SOFT_FOAM, strain + step) - energy_density_Pa(SOFT_FOAM, strain - step)) / (
        2 * step
    )
    assert slope == pytest.approx(SOFT_FOAM.elastic_stress_Pa(strain), rel=1e-6, abs=1e-3)
    # At rest the tangent shear modulus is sum mu, whatever the mix.
    assert SOFT_FOAM.shear_modulus_Pa(np.array([0.0]))[0] == pytest.approx(
        SOFT_FOAM.shear_factor * sum(SOFT_FOAM.mu_Pa), rel=1e-5
    )


def test_soft_foam_has_the_slope_it_says() -> None:
    low, high = SOFT_FOAM.uniaxial(np.array([0.1, 0.5]))
    assert (high - low) / 0.4 == pytest.approx(10e3, rel=0.1)


@pytest.mark.parametrize("geometry", [COARSE, FoamStripGeometry(spacing_m=0.001, radius_m=0.17)])
def test_large_plate_or_ring_is_the_uniaxial_law(geometry: FoamStripGeometry) -> None:
    """Every column alike: nothing pulls sideways. On a bent strip the ring is a concave polygon."""
    strip, law = FoamStrip(geometry, SOFT_FOAM), SOFT_FOAM
    path = [0.001 * i for i in (*range(1, 11), *range(9, 2, -1))]
    truth = path_stress_Pa(law, np.array(path) / 0.02)
    for depth, stress in zip(path, truth, strict=True):
        if np.isinf(geometry.radius_m):
            state = strip.press([plate(depth, length_m=0.5)])
            assert state.force_N[0] == pytest.approx(stress * 0.25 * 0.01, rel=1e-4)
            assert state.pressure_Pa[5] == pytest.approx(stress, rel=1e-4)
        else:
            angle = np.linspace(-0.9, 0.9, 721)
            inner = geometry.radius_m + 0.02 - depth
            arc = np.column_stack([np.cos(angle), np.sin(angle)])
            ring = np.concatenate([inner * arc[::-1], (inner + 0.05) * arc]) - (geometry.radius_m, 0.0)
            state = strip.press([Outline(ring)])
            # Layers of different length share one force: the stress at the front is lower than
            # the law's at the mean strain by about w / 2 R = 6 %, times slope; 12 % bounds it.
            assert state.pressure_Pa[100] == pytest.approx(stress, rel=0.12)
            # The polygon's corners lie 0.1 um off the circle.
            assert np.ptp(state.pressure_Pa[30:-30]) < 0.02 * stress


def test_force_is_the_integral_of_pressure_and_the_sum_over_bodies() -> None:
    strip = FoamStrip(COARSE, SOFT_FOAM)
    state = strip.press([plate(0.004, 0.05), Outline.disc((0.02 - 0.006 + 0.03, -0.06), 0.03)])
    weight = np.gradient(state.s_m)
    weight[[0, -1]] *= 0.5
    assert state.pressure_Pa @ weight * 0.01 == pytest.approx(state.force_N[0], rel=1e-12)
    assert state.body_force_N.sum(axis=0) == pytest.approx(state.force_N, rel=1e-12)
    assert (state.body_force_N[:, 0] > 0.1).all()
    assert state.body_moment_Nm.sum() == pytest.approx(state.moment_Nm, rel=1e-12)
    # On a straight strip the force has no part along s, and its moment is that of its centre:
    # the corner columns' share of the profile bounds the difference.
    assert state.force_N[1] == 0.0
    assert -state.body_moment_Nm[0] / state.body_force_N[0, 0] == pytest.approx(0.05, abs=1e-4)
    assert state.centre_m(1) == pytest.approx(-0.06, abs=1e-4)


def test_contact_is_unilateral() -> None:
    strip = FoamStrip(COARSE, SOFT_FOAM)
    state = strip.press([plate(0.005)])
    assert (state.pressure_Pa >= 0).all()
    inside = np.abs(state.s_m) < 0.0194
    assert state.delta_m[inside] == pytest.approx(0.005, abs=1e-9)
    assert (state.pressure_Pa[np.abs(state.s_m) > 0.0215] == 0).all()
    assert state.delta_m[np.searchsorted(state.s_m, 0.023)] > 0.5e-3, "the flank follows the plate"
    assert np.abs(state.delta_m[[0, -1]]).max() < 1e-5
    free = strip.press([])
    assert free.force_N == pytest.approx([0, 0])
    assert np.abs(free.delta_m).max() < 1e-7


def test_mirror_symmetry() -> None:
    left, right = FoamStrip(COARSE, SOFT_FOAM), FoamStrip(COARSE, SOFT_FOAM)
    for depth in (0.002, 0.004, 0.006, 0.004):
        a = left.press([plate(depth, 0.0313, 0.05, 0.1)])
        b = right.press([plate(depth, -0.0313, 0.05, -0.1)])
        # 2e-8 m is the solver's tolerance; the slope of the force is below 4 kN/m.
        assert a.force_N[0] == pytest.approx(b.force_N[0], abs=1e-4)
        assert a.delta_m == pytest.approx(b.delta_m[::-1], abs=1e-7)


@pytest.mark.parametrize("law", [REFERENCE_FOAM, SOFT_FOAM])
def test_closed_loops_create_no_energy(law: StripLaw) -> None:
    """Random walks of depth, place and yaw back to the start: the foam never gives more than it got."""
    rng = np.random.default_rng(3)
    strip = FoamStrip(FoamStripGeometry(length_m=0.12, spacing_m=0.001), law)
    knots = np.column_stack(
        [rng.uniform(0.001, 0.008, 6), rng.uniform(-0.01, 0.01, 6), rng.uniform(-0.05, 0.05, 6)]
    )
    knots[-1] = knots[0]
    path = [knots[0]]
    for a, b in itertools.pairwise(knots):
        path += [a + (b - a) * x for x in np.linspace(0, 1, 81)[1:]]
    work, before, size = 0.0, None, 0.0
    for depth, y, yaw in path:
        state = strip.press([plate(depth, y, 0.04, yaw)])
        # The body's reference point is (0.02 - depth, y): moment about it.
        x = 0.02 - depth
        wrench = np.array([state.force_N[0], state.force_N[1], state.moment_Nm + y * state.force_N[0]])
        wrench[2] -= x * state.force_N[1]
        pose = np.array([x, y, yaw])
        if before is not None:
            step = 0.5 * (wrench + before[0]) @ (pose - before[1])  # work of the foam on the body
            work, size = work + step, size + abs(step)
        before = (wrench, pose)
    # Without friction the columns cannot push sideways although a corner slides along them, which
    # leaves a few percent of the turnover open; dissipation must exceed it.
    assert work < 0.02 * size
    if law is SOFT_FOAM:
        assert work < -0.05 * size


def test_hysteresis_loop_and_memory() -> None:
    up, down = SOFT_FOAM.uniaxial(np.array([0.3])), SOFT_FOAM.uniaxial(np.array([0.3]), "unloading")
    assert down[0] / up[0] == pytest.approx(1 - 2 * sum(SOFT_FOAM.loss), rel=1e-9)
    strip = FoamStrip(COARSE, SOFT_FOAM)
    first = [strip.press([plate(d)]).force_N[0] for d in np.linspace(0.0005, 0.008, 16)]
    for d in np.linspace(0.008, -0.001, 16):
        strip.press([plate(d)])
    again = [strip.press([plate(d)]).force_N[0] for d in np.linspace(0.0005, 0.008, 16)]
    assert again == pytest.approx(first, rel=1e-6), "a free foam is as new"


def test_relaxation() -> None:
    law = StripLaw(relaxation=0.2, relaxation_strain=0.2, relaxation_time_s=10.0)
    strip = FoamStrip(COARSE, law)
    fast = strip.press([plate(0.004, length_m=0.5)], 1e-3).force_N[0]
    slow = [strip.press([plate(0.004, length_m=0.5)], 1.0).force_N[0] for _ in range(60)]
    elastic = float(law.uniaxial(np.array([0.2]))[0]) * 0.25 * 0.01
    assert fast == pytest.approx(1.2 * elastic, rel=1e-3)
    assert slow[-1] == pytest.approx(elastic * (1 + 0.2 * np.exp(-6)), rel=1e-3)
    assert np.all(np.diff(slow) < 0)


def test_force_is_smooth_while_a_plate_slides_between_columns() -> None:
    strip = FoamStrip(COARSE, REFERENCE_FOAM)
    forces = [strip.press([plate(0.005, y)]).force_N[0] for y in np.linspace(0, 0.002, 21)]
    # A jump by one column would be 9.2 kPa x 1 mm x 10 mm = 92 mN of 3.7 N.
    assert np.ptp(forces) < 0.02


def test_columns_agree_with_finer_ones() -> None:
    force = {}
    for spacing in (0.001, 0.0005, 0.00025):
        strip = FoamStrip(FoamStripGeometry(length_m=0.15, spacing_m=spacing), REFERENCE_FOAM)
        force[spacing] = strip.press([plate(0.006)]).force_N[0]
    assert force[0.001] == pytest.approx(force[0.00025], rel=0.004)
    assert force[0.0005] == pytest.approx(force[0.00025], rel=0.002)


def test_round_bodies_and_outlines() -> None:
    polygon = Outline.box((0.0, 0.0), (0.04, 0.02), 0.3, 0.004).polygon_m()
    shifted = np.roll(polygon, -1, axis=0)
    area = 0.5 * float(np.sum(polygon[:, 0] * shifted[:, 1] - shifted[:, 0] * polygon[:, 1]))
    assert area == pytest.approx(0.04 * 0.02 - (4 - np.pi) * 0.004**2, rel=2e-3)
    many = Outline(Outline.disc((0.0, 0.0), 0.03).polygon_m(np.pi / 400))
    disc = Outline.disc((0.0, 0.0), 0.03)
    a = FoamStrip(COARSE, SOFT_FOAM).press([disc.moved(0.045, 0.01)])
    b = FoamStrip(COARSE, SOFT_FOAM).press([many.moved(0.045, 0.01)])
    assert a.force_N[0] == pytest.approx(b.force_N[0], rel=1e-3)


@pytest.mark.parametrize("radius_m", [0.17, float("inf")])
def test_a_long_wall_behind_the_robot_is_not_touched(radius_m: float) -> None:
    geometry = FoamStripGeometry(radius_m=radius_m, spacing_m=0.001)
    behind = Outline.box((-0.45, 0.0), (0.1, 4.0), 0.0, 0.0)
    assert not FoamStrip(geometry, SOFT_FOAM).press([behind]).force_N.any()
    # ... and changes nothing for what is touched in front.
    disc = Outline.disc((0.045, 0.01), 0.03)
    alone = FoamStrip(geometry, SOFT_FOAM).press([disc])
    both = FoamStrip(geometry, SOFT_FOAM).press([behind, disc])
    np.testing.assert_allclose(both.force_N, alone.force_N, rtol=1e-3)


def test_bent_strip_pushes_along_its_normals() -> None:
    geometry = FoamStripGeometry(radius_m=0.17, spacing_m=0.001)
    strip = FoamStrip(geometry, SOFT_FOAM)
    s = 0.06
    direction = np.array([np.cos(s / 0.17), np.sin(s / 0.17)])
    centre = direction * (0.17 + 0.02 - 0.005 + 0.03) - (0.17, 0.0)
    state = strip.press([Outline.disc((float(centre[0]), float(centre[1])), 0.03)])
    # Symmetric about the ray: the force points along it and passes through the disc's centre.
    assert state.force_N / np.linalg.norm(state.force_N) == pytest.approx(direction, abs=2e-3)
    about = state.moment_Nm - (centre[0] * state.force_N[1] - centre[1] * state.force_N[0])
    assert about == pytest.approx(0.0, abs=1e-4 * float(np.linalg.norm(state.force_N)))
    assert state.centre_m(0) == pytest.approx(s, abs=2e-4)


def test_bad_constants_are_refused() -> None:
    with pytest.raises(InputError, match=r"sum below 0\.5"):
        StripLaw(loss=(0.3, 0.3), loss_strain=(0.01, 0.01))
    with pytest.raises(InputError, match="expected lengths > 0"):
        FoamStripGeometry(width_m=-1.0)
    with pytest.raises(InputError, match="direction 'up'"):
        SOFT_FOAM.uniaxial(np.array([0.1]), "up")


def test_calibration_csv(tmp_path: Path) -> None:
    write_calibration_csv(tmp_path / "foam.csv", [(0.0, 0.0, "loading"), (0.1, 1234.5678, "unloading")])
    lines = (tmp_path / "foam.csv").read_text().splitlines()
    assert lines[0] == "strain,stress_Pa,direction"
    assert lines[1:] == ["0.000000,0.000,loading", "0.100000,1234.568,unloading"]


def energy_J(u: np.ndarray, s_m: np.ndarray, law: StripLaw, width_m: float, height_m: float) -> float:
    """Twin of the kernel's equilibrium: the energy it must minimise, in plain NumPy, without tables."""
    thickness = np.asarray(law.layers) * width_m
    cell = np.gradient(s_m)
    cell[[0, -1]] *= 0.5
    faces = np.column_stack([np.zeros(len(s_m)), u])
    strain = np.diff(faces, axis=1) / thickness
    slope = np.diff(faces, axis=0) / np.diff(s_m)[:, None]
    a, b = slope[:, :-1], slope[:, 1:]
    square = (a * a + a * b + b * b) / 3
    limit = law.shear_limit
    shear = (
        law.shear_modulus_Pa(0.5 * (strain[1:] + strain[:-1]))
        * limit**2
        * (np.sqrt(1 + square / limit**2) - 1)
    )
    column = (energy_density_Pa(law, strain) * thickness).sum(axis=1) @ cell
    tie = (shear * thickness).sum(axis=1) @ np.diff(s_m)
    return float(height_m * (column + tie))


def test_kernel_minimises_the_energy_of_its_twin() -> None:
    geometry = FoamStripGeometry(length_m=0.12, spacing_m=0.002)
    radius, depth, change = 0.03, 0.004, 2e-5

    def solve(d: float) -> tuple[float, np.ndarray, float]:
        strip = FoamStrip(geometry, REFERENCE_FOAM)
        state = strip.press([Outline.disc((0.02 - d + radius, 0.0), radius)])
        u = strip._memory[:, :3].copy()
        return energy_J(u, strip.s_m, REFERENCE_FOAM, 0.02, 0.01), u, state.load_N

    energy, u, load = solve(depth)
    # The force is the slope of the energy: 1e-3 covers the second-order rest of the difference.
    slope = (solve(depth + change)[0] - solve(depth - change)[0]) / (2 * change)
    assert load == pytest.approx(slope, rel=1e-3)
    s = geometry.positions_m()
    limit = depth - radius + np.sqrt(np.maximum(radius**2 - s**2, 0.0))
    rng = np.random.default_rng(5)
    for size in (1e-6, 1e-5, 1e-4):
        for _ in range(20):
            other = u + size * rng.standard_normal(u.shape)
            other[:, -1] = np.maximum(other[:, -1], np.where(np.abs(s) < radius, limit, -1.0))
            assert energy_J(other, s, REFERENCE_FOAM, 0.02, 0.01) > energy
