"""The wrench from the motion of the rod, against loads on the simulated rod."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.camera import Pose
from visuohaptic.sensing.beam import Beam, SectionMotion, estimate_wrench, relative_poses, section_motion
from visuohaptic.simulation.beam import RodRig

BEAM = Beam()
#: Largest load of each axis that this file puts on: below 0.9 of the yield stress.
LOADS = np.array([4.0, 2.8, 2.8, 0.09, 0.33, 0.33])


def observe(bench, wrench, rng=None, names=None):
    def relative(templates):
        reference, *others = templates
        chosen = [t for t in others if names is None or t.name in names]
        return relative_poses(reference.T_camera_template, reference.covariance, chosen)

    rest = relative(bench.templates(np.zeros(6)))
    # A zero that is far better than a frame.
    rest = type(rest)(rest.names, rest.poses, 1e-4 * rest.covariance, rest.shared)
    setup = bench.setup
    return section_motion(
        relative(bench.templates(wrench, rng)), rest, setup.xi, setup.T_reference_sensor, BEAM.length_m
    )


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("fraction", [-1.0, 0.3, 1.0])
def test_each_axis_alone_reads_itself_and_nothing_else(bench, axis, fraction):
    wrench = np.zeros(6)
    wrench[axis] = fraction * LOADS[axis]
    found = estimate_wrench(BEAM, observe(bench, wrench))
    # The simulated rod shears, this one does not: 8e-5 of the bending.
    assert (np.abs(found.wrench - wrench) < 5e-4 * LOADS).all()


def test_all_axes_together(bench):
    rng = np.random.default_rng(5)
    for _ in range(10):
        wrench = rng.uniform(-0.35, 0.35, 6) * LOADS
        found = estimate_wrench(BEAM, observe(bench, wrench))
        assert (np.abs(found.wrench - wrench) < 1e-3 * LOADS).all()


def test_the_linear_beam_is_used_while_it_is_good_enough(bench):
    small, large = np.zeros(6), np.zeros(6)
    small[1], large[1] = 0.02, 1.0
    assert not estimate_wrench(BEAM, observe(bench, small)).exact
    assert estimate_wrench(BEAM, observe(bench, large)).exact
    # Where it is used it is off by less than its sigma, and by construction near the exact reading.
    for force in (0.02, 0.05, 0.1, 0.2):
        small[1] = force
        motion = observe(bench, small)
        auto, exact = estimate_wrench(BEAM, motion), estimate_wrench(BEAM, motion, model="exact")
        sigma = np.sqrt(np.diag(auto.noise + auto.zero))
        assert (np.abs(auto.wrench - exact.wrench) <= 0.25 * sigma + 1e-12).all()


def test_the_published_beam_errs_where_the_exact_one_does_not(bench):
    wrench = np.array([0, 2.5, 0, 0, 0, 0])
    motion = observe(bench, wrench)
    linear = estimate_wrench(BEAM, motion, model="linear").wrench
    assert abs(linear[1] - 2.5) > 0.05  # beyond the 2 % that are owed
    assert abs(estimate_wrench(BEAM, motion).wrench[1] - 2.5) < 1e-3


def test_taking_the_shortening_out_keeps_fx_clean(bench):
    wrench = np.array([0, 0.5, 0, 0, 0, 0])
    motion = observe(bench, wrench)
    drawn = motion.translation_m[-1, 0] * BEAM.spring_N_per_m
    left = estimate_wrench(BEAM, motion, model="linear").wrench[0]
    assert drawn < -0.07  # what Hooke alone would read as F_X
    assert abs(left) < 0.1 * abs(drawn)


@pytest.mark.parametrize("names", [["middle"], ["tip"], None])
def test_any_template_is_enough_and_more_are_better(bench, names):
    wrench = np.array([0.5, 1.0, -0.8, 0.02, 0.03, 0.04])
    found = estimate_wrench(BEAM, observe(bench, wrench, names=names))
    assert (np.abs(found.wrench - wrench) < 2e-3 * LOADS).all()
    if names:
        both = estimate_wrench(BEAM, observe(bench, wrench))
        assert (np.diag(both.noise) < np.diag(found.noise)).all()


def test_five_templates_anywhere(make_bench):
    places = [0.25, 0.4, 0.65, 0.8, 1.0]
    mounts = {
        f"t{k}": (xi, Pose.from_rotation_vector([0, 0, 0.1 * k], [0, 0, 0.005]))
        for k, xi in enumerate(places)
    }
    bench = make_bench(RodRig(mounts=mounts))
    wrench = np.array([0.5, -1.0, 0.8, 0.02, 0.03, -0.04])
    found = estimate_wrench(BEAM, observe(bench, wrench))
    assert found.freedom == 24
    assert (np.abs(found.wrench - wrench) < 1e-3 * LOADS).all()


@pytest.mark.parametrize("wrench", [np.zeros(6), np.array([0.5, 1.2, -0.9, 0.02, 0.05, 0.05])])
def test_declared_covariance_against_many_frames(bench, wrench):
    rng = np.random.default_rng(8)
    found = [estimate_wrench(BEAM, observe_fast(bench, wrench, rng)) for _ in range(400)]
    wrenches = np.array([one.wrench for one in found])
    sigma = np.sqrt(np.diag(found[0].noise))
    # 400 draws: 3.5 % at one standard deviation, the largest of six axes twice.
    assert wrenches.std(axis=0, ddof=1) == pytest.approx(sigma, rel=0.12)
    # The mean of 400 is within 4 sigma / 20, and the model's error of a few hundredths of a sigma.
    assert (np.abs(wrenches.mean(axis=0) - wrench) < 0.25 * sigma + 5e-4 * LOADS).all()
    normal = np.array([one.chi2 for one in found])
    # 12 observations, 6 unknowns; under load the tolerance of the setup makes it less.
    assert normal.mean() == pytest.approx(6, rel=0.2) if not wrench.any() else normal.mean() < 6


_BENT = {}


def observe_fast(bench, wrench, rng):
    """As observe with noise, bending the rod only once."""
    from tests.sensing.beam.pose_noise import noisy_pose

    from visuohaptic.sensing.beam import TemplateMeasurement

    key = tuple(wrench)
    if key not in _BENT:
        _BENT[key] = bench.templates(wrench), bench.templates(np.zeros(6))
    now, rest = _BENT[key]
    reference, *others = [
        TemplateMeasurement(t.name, noisy_pose(t.T_camera_template, t.covariance, rng), t.covariance)
        for t in now
    ]
    still = relative_poses(rest[0].T_camera_template, rest[0].covariance, rest[1:])
    still = type(still)(still.names, still.poses, 1e-6 * still.covariance, still.shared)
    setup = bench.setup
    return section_motion(
        relative_poses(reference.T_camera_template, reference.covariance, others),
        still,
        setup.xi,
        setup.T_reference_sensor,
        BEAM.length_m,
    )


def test_what_can_not_be_estimated_is_refused():
    nothing = SectionMotion(
        np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 0)), np.zeros((0, 0))
    )
    with pytest.raises(InputError, match="no cross section"):
        estimate_wrench(BEAM, nothing)
    flat = SectionMotion(np.ones(1), np.zeros((1, 3)), np.eye(3)[None], np.zeros((6, 6)), np.zeros((6, 6)))
    with pytest.raises(InputError, match="not positive definite"):
        estimate_wrench(BEAM, flat)
