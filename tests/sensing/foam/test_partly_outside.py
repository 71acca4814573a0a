"""Strips whose end is outside the image: hidden in every frame, as far as it may bear force."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.worlds import foam_disturbances as disturbances

from benchmarks import foam_evidence
from visuohaptic.core import CalibrationError, Frame, InputError
from visuohaptic.sensing.foam import FoamSensor
from visuohaptic.sensing.foam.strip.geometry import StripGeometry


class Cut:
    """A press whose images, and their camera, end before the last points of the strip."""

    def __init__(self, folder: Path, seed: int, outside: int) -> None:
        self.sequence = disturbances.forces(seed)
        sensor = foam_evidence.sensor_for(self.sequence.world, folder)
        setup = sensor.setup
        geometry, plane = setup.geometry, sensor.optics.plane
        ends = np.maximum(*(plane.project(points)[:, 0] for points in (geometry.back_m, geometry.front_m)))
        self.columns = int(np.sort(ends)[-outside]) if outside else setup.camera.width
        setup.camera = replace(setup.camera, width=self.columns)
        self.sensor = FoamSensor(setup)

    def frame(self, shot, index: int) -> Frame:
        return Frame(np.ascontiguousarray(shot.image[:, : self.columns]), shot.t_s, index)

    def zero(self) -> None:
        self.sensor.zero([self.frame(shot, k) for k, shot in enumerate(self.sequence.zero())])


def test_a_press_is_read_while_three_points_of_the_strip_are_outside_the_image(tmp_path) -> None:
    cut = Cut(tmp_path, 2, 3)
    assert cut.sensor.optics.outside.sum() == 3
    cut.zero()
    cut.sequence.moments = cut.sequence.moments[2:16:2]
    for k, shot in enumerate(cut.sequence.shots()):
        profile = cut.sensor.read(cut.frame(shot, 100 + k))
        assert profile.valid
        assert not profile.point_valid[cut.sensor.optics.outside].any()
        assert abs(profile.force_N - shot.force_N) < 3.0 * profile.force_sigma_N + foam_evidence.PHANTOM_N


def test_more_outside_than_could_bear_no_force_is_told_while_zeroing(tmp_path) -> None:
    cut = Cut(tmp_path, 2, 20)
    with pytest.raises(CalibrationError, match="20 of them outside the image"):
        cut.zero()


def test_most_of_the_strip_outside_is_a_wrong_pose(tmp_path) -> None:
    with pytest.raises(InputError, match="outside the image, expected less than half"):
        Cut(tmp_path, 2, 60)


@pytest.mark.parametrize(("longer_m", "told"), [(0.0, False), (0.014, True)])
def test_a_strip_that_is_declared_too_long_is_told_while_zeroing(tmp_path, caplog, longer_m, told) -> None:
    """Behind both ends of the foam there is floor, where the sensor expects a front."""
    cut = Cut(tmp_path, 2, 0)
    setup = cut.sensor.setup
    length_m = len(setup.geometry.s_m) * float(setup.geometry.cell_m[0]) + longer_m
    setup.geometry = StripGeometry.straight(length_m, setup.geometry.width_m)
    cut.sensor = FoamSensor(setup)
    cut.zero()
    assert ("mm from an end of the strip" in caplog.text) == told
