"""A simulated rod with templates, seen by a noisy tracker."""

from __future__ import annotations

import numpy as np
import pytest
from tests.sensing.beam.pose_noise import POSE_NOISE, noisy_pose

from visuohaptic.sensing.beam import Beam, BeamSensor, BeamSetup, TemplateMeasurement
from visuohaptic.simulation.beam import RodRig


class Bench:
    """The rig of Alt 2016, Sec. 3.6.1, with a sensor that reads it."""

    def __init__(self, rig=None, beam=None, noise=None, **setup):
        self.rig = rig or RodRig()
        self.beam = beam or Beam()
        self.covariance = (noise or POSE_NOISE[0.3]).covariance
        self.setup = BeamSetup(
            {name: xi for name, (xi, _) in self.rig.mounts.items()},
            self.rig.T_sensor_reference.inverse(),
            self.beam,
            **setup,
        )

    def bend(self, wrench):
        wrench = np.asarray(wrench, dtype=float)
        return self.rig.rod.bend(wrench[:3], wrench[3:])

    def templates(self, wrench, rng=None, *, view=None, reference_sigma=1.0):
        """Poses of all templates under a wrench; without a generator free of noise."""
        found = []
        for name, pose in self.rig.poses(self.bend(wrench), view).items():
            covariance = self.covariance
            if name == self.rig.reference:
                covariance = covariance * reference_sigma**2
            seen = pose if rng is None else noisy_pose(pose, covariance, rng)
            found.append(TemplateMeasurement(name, seen, covariance))
        return found

    def sensor(self, rng=None, frames=100):
        """Zeroed with noise if there is a generator."""
        sensor = BeamSensor(self.setup)
        rest = self.templates(np.zeros(6))
        sensor.zero(
            (
                k / 30,
                rest
                if rng is None
                else [
                    TemplateMeasurement(
                        t.name, noisy_pose(t.T_camera_template, t.covariance, rng), t.covariance
                    )
                    for t in rest
                ],
            )
            for k in range(frames)
        )
        return sensor


def full(wrench):
    return np.concatenate([wrench.force_N, wrench.moment_Nm])


@pytest.fixture(scope="session")
def make_bench():
    return Bench


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture(scope="session")
def vector():
    """Six numbers of a wrench."""
    return full
