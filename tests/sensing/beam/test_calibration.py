"""The compliance from known loads: recovered with calibrated sigmas, or rejected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visuohaptic.core import CalibrationError
from visuohaptic.sensing.beam import (
    Beam,
    Correction,
    LoadRecord,
    calibrate_beam,
    compliance,
    prior_correction,
    read_loads,
)
from visuohaptic.simulation.beam import ElasticRod, RodRig

BEAM = Beam()
#: Half a millimetre longer, 0.7 % thinner, softer: compliant by 1.3 % + 2.7 % + 1.5 % more.
OTHER_ROD = ElasticRod(
    length_m=0.1205, diameter_m=0.00149, youngs_Pa=203e9, spring_N_per_m=530, spring_Nm_per_rad=0.19
)
REACH = np.array([3.0, 1.5, 1.5, 0.06, 0.12, 0.12])


def session(axes=range(6), steps=(-1, -0.5, 0, 0.5, 1)):
    """Loads of each axis, both ways."""
    loads = []
    for axis in axes:
        for fraction in steps:
            load = np.zeros(6)
            load[axis] = fraction * REACH[axis]
            loads.append(load)
    return np.array(loads)


def record_of(bench, sensor, loads, vector, rng, noise=1.0):
    """Dead weights on the simulated rod, read by the sensor without calibration."""
    sigma = noise * np.array([0.7, 1.3, 3.7, 0.02, 0.23, 0.09]) * 1e-3
    read = [vector(sensor.read(1 + k, bench.templates(load)).wrench) for k, load in enumerate(loads)]
    read = np.array(read) + rng.normal(0, 1, (len(loads), 6)) * sigma
    return LoadRecord(loads, read, "wrench", np.arange(2, 2 + len(loads)))


@pytest.fixture(scope="module")
def calibrated(make_bench, vector):
    bench = make_bench(RodRig(rod=OTHER_ROD))
    record = record_of(bench, bench.sensor(), session(), vector, np.random.default_rng(1))
    return bench, calibrate_beam(record, BEAM)


def test_a_calibrated_sensor_reads_another_rod(calibrated, make_bench, vector):
    """Figure 3.8 with parts that are not those of the data sheet."""
    bench, found = calibrated
    sensor = make_bench(RodRig(rod=OTHER_ROD), correction=found.correction).sensor()
    plain = bench.sensor()
    top = 2.5
    full = np.minimum(BEAM.full_scale, top * np.array([1, 1, 1, 0.12, 0.12, 0.12]))
    worst, before = np.zeros(6), 0.0
    for k, force in enumerate([*np.linspace(0, top, 6), *np.linspace(top, 0, 6)]):
        wrench = np.array([0, force, 0, 0, 0, 0])
        templates = bench.templates(wrench)
        error = np.abs(vector(sensor.read(1 + k, templates).wrench) - wrench) / full
        worst = np.maximum(worst, error)
        before = max(before, abs(plain.read(1 + k, templates).wrench.force_N[1] - force) / top)
    assert worst[1] < 0.02  # owed; the aim of 0.005 is tested by the benchmark
    assert np.delete(worst, 1).max() < 0.01
    assert worst[1] < 0.2 * before


def test_the_session_leaves_small_residuals(calibrated):
    _, found = calibrated
    assert (found.residual_rms < 0.01 * REACH).all()
    assert (found.uncalibrated_rms[[1, 2]] > 3 * found.residual_rms[[1, 2]]).all()
    assert (found.explained > 0.999).all()
    assert (found.correction.place_left < 0.02).all()


def test_the_prior_knows_what_a_millimetre_is_worth():
    exact = dict.fromkeys(("diameter_tolerance", "youngs_tolerance", "alignment_tolerance_rad"), 0.0)
    one = prior_correction(replace(BEAM, length_tolerance_m=1e-3, **exact))
    # F = (12 w - 6 w' L) EI / L^3 with w growing by 3 dL/L of a third, w' by 2 dL/L of a half: 6 dL/L.
    assert np.sqrt(one.row_covariance[1, 1, 1]) == pytest.approx(6e-3 / 0.12, rel=0.03)
    # With the moment known it is 3 dL/L, the compliance itself.
    longer = compliance(replace(BEAM, length_m=0.121), 1.0)
    assert longer[1, 1] / compliance(BEAM, 1.0)[1, 1] - 1 == pytest.approx(0.025, rel=0.02)


def test_parts_that_are_known_exactly_leave_three_per_mille():
    exact = dict.fromkeys(
        (
            "length_tolerance_m",
            "diameter_tolerance",
            "youngs_tolerance",
            "spring_tolerance",
            "alignment_tolerance_rad",
        ),
        0.0,
    )
    rows = prior_correction(replace(BEAM, **exact)).row_covariance
    # Glue, clamp, a rod that is not round: of each force, and of each moment by the length.
    assert np.sqrt([rows[k, k, k] for k in range(6)]) == pytest.approx([0.003] * 6, rel=1e-6)


def test_declared_sigmas_cover_many_calibrations():
    rng = np.random.default_rng(3)
    loads = session(axes=(1, 2, 5))
    pulls = []
    for _ in range(200):
        true = np.diag(rng.normal(0, 0.01, 6))
        scatter = np.array([0.01, 0.02, 0.02, 2e-4, 1e-3, 1e-3])
        read = loads @ (np.eye(6) + true).T + rng.normal(0, 1, loads.shape) * scatter
        found = calibrate_beam(LoadRecord(loads, read, "wrench", np.arange(15)), BEAM, load_tolerance=0.0)
        for k in (1, 2, 5):
            error = found.correction.matrix[k, k] - true[k, k]
            pulls.append(error / np.sqrt(found.correction.row_covariance[k, k, k]))
    # 600 pulls; the noise is estimated from 15 rows, and the prior is wider than the truth here.
    assert 0.8 < np.std(pulls) < 1.2
    assert abs(np.mean(pulls)) < 0.2


def test_axes_that_were_not_loaded_keep_the_data_sheet():
    loads = session(axes=(1, 2))
    found = calibrate_beam(LoadRecord(loads, loads * 1.02, "wrench", np.arange(10)), BEAM)
    prior = prior_correction(BEAM)
    for k in (0, 3):
        assert found.correction.row_covariance[k, k, k] == pytest.approx(
            prior.row_covariance[k, k, k] + 0.002**2, rel=1e-6
        )
    assert any(note.startswith("fx was not loaded") for note in found.notes)
    assert found.correction.matrix[1, 1] == pytest.approx(0.02, abs=2e-3)


def test_a_calibration_again_starts_from_the_one_before():
    """A rod that is known to read 30 % more is no surprise, and an axis that is not loaded now keeps what was found."""
    rng = np.random.default_rng(8)
    data_sheet = prior_correction(BEAM)
    known = Correction(0.3 * np.eye(6) + 1.5 * np.eye(6, k=4), data_sheet.row_covariance)
    loads = session(axes=(1, 2))
    read = loads @ (np.eye(6) + known.matrix).T + rng.normal(0, 1, loads.shape) * 1e-4
    record = LoadRecord(loads, read, "wrench", np.arange(10))
    with pytest.raises(CalibrationError, match=r"times as far along f[yz] as its data sheet states"):
        calibrate_beam(record, BEAM)
    found = calibrate_beam(record, BEAM, prior=known).correction.matrix
    # Loads of 1.5 N with a noise of 0.1 mN: 1e-4 of the force; what was not loaded is not touched at all.
    assert found[[1, 2], [1, 2]] == pytest.approx([0.3, 0.3], abs=1e-3)
    assert found[[0, 0, 3], [0, 4, 3]] == pytest.approx(known.matrix[[0, 0, 3], [0, 4, 3]], rel=1e-6)


@pytest.mark.parametrize(("fraction", "counts"), [(0.04, False), (0.06, True)])
@pytest.mark.parametrize("reach_N", [0.2, 3.0])
def test_an_axis_counts_as_loaded_from_a_twentieth_of_the_largest_load(reach_N, fraction, counts):
    rng = np.random.default_rng(9)
    loads = (
        session(axes=(1,)) * reach_N / REACH[1] / 2
    )  # from -reach / 2 to reach / 2: the largest load is half of it
    loads = np.vstack([loads, loads])
    loads[:, 2] = np.where(np.arange(10) < 5, 0.0, 0.5 * fraction * reach_N)
    read = loads + rng.normal(0, 1, loads.shape) * 1e-6 * reach_N
    found = calibrate_beam(LoadRecord(loads, read, "wrench", np.arange(10)), BEAM)
    assert any(note.startswith("fz was not loaded") for note in found.notes) is not counts


def test_motions_of_the_tip_do_as_well_as_readings():
    loads = session()
    moved = []
    for load in loads:
        pose = OTHER_ROD.bend(load[:3], load[3:]).pose(1.0)
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_matrix(pose.rotation).as_rotvec()
        moved.append(np.concatenate([pose.translation_m - [OTHER_ROD.length_m, 0, 0], turn]))
    found = calibrate_beam(LoadRecord(loads, np.array(moved), "motion", np.arange(30)), BEAM)
    assert (found.residual_rms < 0.01 * REACH).all()
    # The tip itself was observed: the compliance is that of the other rod, large loads bend it by 1 %.
    other = replace(
        BEAM, length_m=0.1205, diameter_m=0.00149, youngs_Pa=203e9, spring_N_per_m=530, spring_Nm_per_rad=0.19
    )
    assert np.diag(found.compliance) == pytest.approx(np.diag(compliance(other, 1.0)), rel=0.01)


def test_misplaced_templates_are_in_the_calibration_once(make_bench, vector):
    """Places on the rod are off by what the data sheet declares: the loads measure that, and it is not counted twice."""
    rng = np.random.default_rng(21)
    pulls, fractions = [], []
    for _ in range(6):
        rig, places = RodRig(), {}
        for name, (xi, pose) in rig.mounts.items():
            slip = rng.normal(0, BEAM.place_tolerance_m) / BEAM.length_m
            places[name] = (min(xi + slip, 1.0), pose)
        bench = make_bench(replace(rig, mounts=places))
        bench.setup = replace(bench.setup, xi={name: xi for name, (xi, _) in rig.mounts.items()})
        plain = bench.sensor()
        found = calibrate_beam(record_of(bench, plain, session(), vector, rng), BEAM).correction
        bench.setup = replace(bench.setup, correction=found)
        sensor = bench.sensor(rng)
        for k in range(4):
            wrench = rng.uniform(-0.6, 0.6, 6) * REACH
            templates = bench.templates(wrench, rng)
            reading, before = sensor.read(100.0 + k, templates), plain.read(100.0 + k, templates)
            pulls.append((vector(reading.wrench) - wrench) / np.sqrt(np.diag(reading.wrench.covariance)))
            fractions.append(reading.setup[1, 1] / before.setup[1, 1])
    assert np.abs(pulls).max() < 4
    assert (np.sqrt(np.mean(np.square(pulls), axis=0)) < 1.3).all()
    # .2 % of the tip's motion stays, of which half a millimetre of place is .5 mm / (2 / 3 L) of it: .09 of the sum.
    assert np.median(fractions) == pytest.approx(0.09, abs=0.05)


def test_only_readings_under_load_contain_the_places(vector):
    loads = session(axes=(1, 2))
    scatter = np.random.default_rng(4).normal(0, 1e-3, loads.shape)
    readings = LoadRecord(loads, loads + scatter, "wrench", np.arange(10))
    once = calibrate_beam(readings, BEAM).correction
    again = calibrate_beam(readings, BEAM, prior=once).correction
    assert once.place_left[[0, 3]] == pytest.approx([1, 1])
    # The scale's variance before is 4 % squared, after 1 mN / 3.4 N squared.
    assert (once.place_left[[1, 2]] < 1e-3).all()
    assert (again.place_left[[1, 2]] < 0.5 * once.place_left[[1, 2]]).all()
    small = 0.02 * loads
    motions = LoadRecord(small, small @ compliance(BEAM, 1.0).T, "motion", np.arange(10))
    assert calibrate_beam(motions, BEAM).correction.place_left == pytest.approx(np.ones(6))


def test_correction_and_covariance_go_together():
    rng = np.random.default_rng(4)
    prior = prior_correction(BEAM)
    wrench = np.array([1.0, 0.8, -0.5, 0.02, 0.05, 0.04])
    roots = np.sqrt(np.array([np.diag(row) for row in prior.row_covariance]))
    draws = np.array(
        [np.linalg.solve(np.eye(6) + rng.normal(0, 1, (6, 6)) * roots, wrench) for _ in range(3000)]
    )
    assert draws.std(axis=0) == pytest.approx(np.sqrt(np.diag(prior.covariance(wrench))), rel=0.1)
    matrix = np.diag([0.1, 0.05, 0, 0, 0, 0])
    correction = Correction(matrix, prior.row_covariance)
    assert correction.apply((np.eye(6) + matrix) @ wrench) == pytest.approx(wrench)


def alternating(fraction):
    """Residuals that no line through the loads has, of this size at the largest load; unloaded rows have none."""
    return fraction * REACH[1] * np.tile([1.0, -1.0, 0.0, -1.0, 1.0], 2)


def drifted(fraction):
    """One of the two unloaded rows is off; their scatter is their difference by the root of 2."""
    return np.eye(10)[2] * fraction * np.sqrt(2) * REACH[1]


def unexplained(fraction):
    """Size of the same residuals, with three parameters fitted to ten rows, that leave a fraction of the variance."""
    loads = session(axes=(1, 2))[:, 1]
    return np.sqrt(fraction * (loads @ loads) / (80 / 7 - 8 * fraction)) / REACH[1]


def single(sigmas):
    """One row of ninety that is off by so many robust sigmas, of which the least is half a percent of the largest load."""
    design = np.column_stack([np.tile(session(axes=(1, 2))[:, 1:3], (9, 1)), np.ones(90)])
    kept = 1 - (design @ np.linalg.pinv(design))[4, 4]
    return np.eye(90)[4] * sigmas * 0.005 * REACH[1] / (kept * np.sqrt(90 / 87))


def softer(sigmas):
    """Readings as of a beam that is softer than stated, by so many sigmas of its data sheet."""
    return sigmas * np.sqrt(prior_correction(BEAM).row_covariance[1, 1, 1]) * session(axes=(1, 2))[:, 1]


@pytest.mark.parametrize(
    ("inside", "outside", "said"),
    [
        (drifted(0.047), drifted(0.053), "the unloaded sensor reads fy"),
        (alternating(0.047 * np.sqrt(7 / 8)), alternating(0.053 * np.sqrt(7 / 8)), "fy scatters by 5 %"),
        (alternating(unexplained(0.047)), alternating(unexplained(0.053)), "the loads explain only 95 %"),
        (single(6.6), single(7.4), "fy deviates by 7 standard deviations"),
        (softer(4.7), softer(5.3), "times as far along fy"),
    ],
)
def test_a_session_is_refused_beyond_its_limit(inside, outside, said):
    for error, refused in ((inside, False), (outside, True)):
        loads = np.tile(session(axes=(1, 2)), (len(error) // 10, 1))
        try:
            calibrate_beam(
                LoadRecord(loads, loads + np.outer(error, np.eye(6)[1]), "wrench", np.arange(10)), BEAM
            )
            text = ""
        except CalibrationError as found:
            text = str(found)
        assert (said in text) is refused, text


@pytest.mark.parametrize(("rows", "loaded", "enough"), [(8, 4, True), (7, 4, False), (8, 3, False)])
def test_eight_rows_and_four_loads_are_the_least(rows, loaded, enough):
    loads = np.zeros((rows, 6))
    loads[:loaded, 1] = np.array([-1.0, 1.0, -0.5, 0.5])[:loaded]
    record = LoadRecord(loads, loads, "wrench", np.arange(rows))
    if enough:
        assert len(calibrate_beam(record, BEAM).residual) == rows
    else:
        with pytest.raises(CalibrationError, match="expected 8 and 4 or more"):
            calibrate_beam(record, BEAM)


def test_a_load_that_never_changes_is_refused():
    loads = np.tile([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (10, 1))
    with pytest.raises(CalibrationError, match="no load changes"):
        calibrate_beam(LoadRecord(loads, loads, "wrench", np.arange(10)), BEAM)


class TestRefusals:
    def record(self, change=lambda loads, read: read, steps=(-1, -0.5, 0, 0.5, 1)):
        loads = session(axes=(1, 2), steps=steps)
        rng = np.random.default_rng(5)
        read = loads + rng.normal(0, 1, loads.shape) * [0.002, 0.002, 0.004, 1e-4, 3e-4, 3e-4]
        return LoadRecord(loads, change(loads, read), "wrench", np.arange(2, 2 + len(loads)), "loads.csv")

    def refused(self, record, text):
        with pytest.raises(CalibrationError, match=text):
            calibrate_beam(record, BEAM)

    def test_good_data_pass(self):
        calibrate_beam(self.record(), BEAM)

    def test_too_few_rows(self):
        self.refused(self.record(steps=(0, 1)), "loads.csv: found 4 rows, 2 of them with a load")

    def test_a_zero_that_wanders(self):
        def wander(loads, read):
            read = read.copy()
            read[2, 1] += 0.3
            return read

        self.refused(self.record(wander), "the unloaded sensor reads fy with a scatter of 14 %")

    def test_noise(self):
        rng = np.random.default_rng(6)
        self.refused(
            self.record(
                lambda loads, read: np.where(loads.any(axis=1)[:, None], rng.normal(0, 1, read.shape), read)
            ),
            "the loads explain only .* of what f. reads",
        )

    def test_a_row_that_was_mistyped(self):
        def mistype(loads, read):
            read = read.copy()
            read[4, 1] *= 0.8
            return read

        self.refused(self.record(mistype, steps=np.linspace(-1, 1, 21)), "line .*: f. deviates by")

    @pytest.mark.parametrize(
        ("factor", "text"),
        [
            (1e-3, "moves 0.001 times as far along fy"),
            (-1.0, "moves -1 times as far along fy"),
            (1.5, "1.5 times"),
        ],
    )
    def test_units_signs_and_another_beam(self, factor, text):
        self.refused(self.record(lambda loads, read: read * factor), text)

    def test_axes_that_are_swapped(self):
        self.refused(
            self.record(lambda loads, read: read[:, [0, 2, 1, 3, 4, 5]]), "moves .* along fy|shows as"
        )


@pytest.mark.data
@pytest.mark.parametrize(
    "name", ["stiffness_data.csv", "stiffness_data_.csv", "stiffness_data_2024-05-03_21-31-44.csv"]
)
def test_real_dead_weights_that_must_be_refused(data, name):
    """A webcam, a tag on a flexure, weights of 1-20 mN: the zero wanders by a quarter of the range."""
    record = read_loads(data / "sensing" / "fiducialforcesensor" / name, angles="deg")
    assert record.load.shape == (len(record.line), 6)
    with pytest.raises(CalibrationError, match=f"{name}.*(scatter|explain)"):
        calibrate_beam(record, BEAM)
    # Not because it is another beam: a prior that allows any compliance refuses it as well.
    loose = Correction(np.zeros((6, 6)), np.stack([np.eye(6) * 1e8] * 6))
    with pytest.raises(CalibrationError, match=f"{name}.*(scatter|explain)"):
        calibrate_beam(record, BEAM, prior=loose)
