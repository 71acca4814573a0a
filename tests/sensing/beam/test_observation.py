"""From template poses to motions of cross sections, with propagated covariance."""

from __future__ import annotations

import numpy as np
import pytest
from tests.sensing.beam.pose_noise import noisy_pose

from visuohaptic.core import InputError, Reason
from visuohaptic.core.camera import Pose
from visuohaptic.sensing.beam import TemplateMeasurement, relative_poses, section_motion

WRENCH = np.array([1.0, 1.5, -0.7, 0.03, 0.02, 0.05])


def relative(templates):
    reference, *others = templates
    return relative_poses(reference.T_camera_template, reference.covariance, others)


def motion(bench, templates, rest):
    setup = bench.setup
    return section_motion(relative(templates), rest, setup.xi, setup.T_reference_sensor, setup.beam.length_m)


def test_sections_move_as_the_rod_does_whatever_the_mount_and_the_view(bench):
    rest = relative(bench.templates(np.zeros(6)))
    state = bench.bend(WRENCH)
    view = Pose.from_rotation_vector([0.4, -0.2, 1.0], [0.05, -0.02, 0.4]) @ bench.rig.T_camera_sensor
    for seen_from in (None, view):
        found = motion(bench, bench.templates(WRENCH, view=seen_from), rest)
        for k, xi in enumerate(found.xi):
            pose = state.pose(xi)
            assert found.translation_m[k] == pytest.approx(pose.translation_m - [xi * 0.12, 0, 0], abs=1e-12)
            assert found.rotation[k] == pytest.approx(pose.rotation, abs=1e-12)


def test_an_unloaded_sensor_has_not_moved(bench):
    rest = relative(bench.templates(np.zeros(6)))
    assert np.abs(motion(bench, bench.templates(np.zeros(6)), rest).vector).max() < 1e-14


def test_the_declared_covariance_is_that_of_many_frames(bench):
    rng = np.random.default_rng(11)
    true, still = bench.templates(WRENCH), bench.templates(np.zeros(6))

    def shaken(templates):
        return [
            TemplateMeasurement(t.name, noisy_pose(t.T_camera_template, t.covariance, rng), t.covariance)
            for t in templates
        ]

    draws = [motion(bench, shaken(true), relative(shaken(still))) for _ in range(1500)]
    declared = draws[0].covariance
    exact = motion(bench, true, relative(still))
    # Turns are compared as small rotations from the true frame, as the covariance says.
    spin = np.array([draw.rotation for draw in draws]) @ exact.rotation.transpose(0, 2, 1)
    turns = np.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], axis=-1)
    moves = np.array([draw.translation_m for draw in draws]) - exact.translation_m
    offsets = np.concatenate([moves, turns], axis=-1).reshape(len(draws), -1)
    spread = offsets.T @ offsets / (len(offsets) - 1)
    sigma = np.sqrt(np.diag(declared))
    # 1500 draws: 1.8 % of a sigma, 2.6 % of a correlation, at one standard deviation.
    assert np.sqrt(np.diag(spread)) == pytest.approx(sigma, rel=0.08)
    assert np.abs((spread - declared) / np.outer(sigma, sigma)).max() < 0.12


def test_templates_can_be_taken_out(bench):
    both = relative(bench.templates(np.zeros(6)))
    one = both.select(["tip"])
    assert one.names == ("tip",)
    assert one.covariance == pytest.approx(both.covariance[6:, 6:])


def test_a_pose_without_covariance_is_refused(bench):
    reference, tip, _ = bench.templates(np.zeros(6))
    with pytest.raises(InputError, match="no pose; leave it out"):
        relative_poses(
            reference.T_camera_template, reference.covariance, [TemplateMeasurement.missing("tip")]
        )
    bad = TemplateMeasurement("tip", tip.T_camera_template, np.full((6, 6), np.nan))
    with pytest.raises(InputError, match="not 6 x 6 numbers"):
        relative_poses(reference.T_camera_template, reference.covariance, [bad])
    assert TemplateMeasurement.missing("tip").reason is Reason.LOST
