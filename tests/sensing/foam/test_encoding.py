"""Cameras that encode light as grey levels make the bright side of a blurred edge look larger."""

from __future__ import annotations

from dataclasses import replace
from math import erf

import numpy as np
import pytest
from tests.worlds import foam
from tests.worlds import foam_disturbances as disturbances
from tests.worlds.foam import draw_world
from tests.worlds.foam_scene import Moment

from benchmarks import foam_evidence
from visuohaptic.core.camera import Frame
from visuohaptic.sensing.foam import FoamSensor
from visuohaptic.sensing.foam.edges import _SHIFT_ERROR
from visuohaptic.sensing.foam.strip.encoding import edge_skew, encoded_shift_px, encoding_probability
from visuohaptic.tracking import ConstraintLines, ContourTracker

#: Place of the edge from the lines' origins [px].
PLACE = 20.3


def tracked(behind: float, before: float, blur_px: float, exponent: float):
    """Image of an edge between two grey levels that a lens has blurred in linear light, and its contour."""
    rows = np.arange(60.0)[:, None] + (np.arange(10) + 0.5) / 10 - 0.5  # a pixel collects ten samples
    part = np.vectorize(erf)((rows - 10.0 - PLACE) / (np.sqrt(2.0) * blur_px)) * 0.5 + 0.5
    levels = (np.array([behind, before]) / 255.0) ** exponent
    light = (levels[0] + (levels[1] - levels[0]) * part).mean(axis=1)
    noise = np.random.default_rng(0).normal(0.0, 0.5, (60, 160))
    image = np.clip(255.0 * light[:, None] ** (1.0 / exponent) + noise, 0, 255).round().astype(np.uint8)
    x = np.arange(10.0, 150.0, 7.0)
    start = np.stack([x, np.full(len(x), 10.0)], 1)
    down = np.tile([0.0, 1.0], (len(x), 1))
    lines = ConstraintLines(start, down, np.zeros(len(x)), np.full(len(x), 40.0))
    return image, ContourTracker().track(image, lines)


@pytest.mark.parametrize(("behind", "before"), [(180.0, 60.0), (180.0, 100.0), (50.0, 170.0)])
@pytest.mark.parametrize("blur_px", [0.6, 1.0, 2.0])
def test_the_bright_side_looks_larger_by_what_the_encoding_says(behind, before, blur_px):
    _, contour = tracked(behind, before, blur_px, 2.2)
    found = np.median(contour.position_px) - PLACE
    expected = float(np.median(encoded_shift_px(contour)))
    assert np.sign(expected) == np.sign(behind - before)
    # The blur of the light is taken from that of the encoded edge by its slope half way; its tails leave a few hundredths.
    assert abs(found - expected) < 0.06 * abs(expected) + 0.005
    _, linear = tracked(behind, before, blur_px, 1.0)
    assert abs(np.median(linear.position_px) - PLACE) < 0.02


def test_the_declared_error_of_the_shift_is_that_of_other_exponents():
    """Cameras encode with 2.2, more or less; six per cent of it are a tenth of the shift."""
    error = []
    for exponent in (2.07, 2.33):
        for behind, before in ((180.0, 60.0), (180.0, 100.0), (50.0, 170.0)):
            _, contour = tracked(behind, before, 1.0, exponent)
            found = np.median(contour.position_px) - PLACE
            error.append(found / float(np.median(encoded_shift_px(contour))) - 1.0)
    assert np.sqrt(np.mean(np.square(error))) == pytest.approx(_SHIFT_ERROR, rel=0.15)


def test_a_strip_that_looks_too_wide_is_not_read_as_too_little_pressed(tmp_path):
    """An encoding camera with 43 pixels over the width: both edges are 0.4 px outwards, 1.9 % of every deflection."""
    sequence = disturbances.forces(112)
    sensor = foam_evidence.sensor_for(sequence.world, tmp_path)
    sensor.zero([Frame(shot.image, shot.t_s, i) for i, shot in enumerate(sequence.zero())])
    shot, moments = sequence.moments[-4]
    profile = sensor.read(Frame(sequence.world.image(*moments), shot.t_s, 99))
    press, (first, last) = moments[0].press, shot.contact_m
    inside = (profile.s_m > first + 0.003) & (profile.s_m < last - 0.003)
    error = np.median((profile.delta_m - np.interp(profile.s_m, press.y_m, press.delta_m))[inside])
    assert shot.depth_m > 0.008
    # Its zero tells that the camera encodes: a tenth of the shift is left, which is declared, and the error of the zero.
    assert sensor.zero_reference is not None
    assert sensor.zero_reference.encoding > 0.95
    assert abs(error) < 0.005 * shot.depth_m
    # One frame of so deep a contact is not valid, as it has no history; its contour has been read.
    assert sensor.reading is not None
    assert abs(sensor.reading.force_N - shot.force_N) < 2.0 * sensor.reading.budget.total_N


@pytest.mark.parametrize("exponent", [1.0, 2.2])
@pytest.mark.parametrize(("behind", "before"), [(180.0, 40.0), (30.0, 170.0)])
@pytest.mark.parametrize("blur_px", [1.0, 2.0])
def test_the_blur_of_an_encoded_edge_is_skewed(behind, before, blur_px, exponent):
    encoded = exponent > 1.0
    q, error, *_ = skew = edge_skew(*tracked(behind, before, blur_px, exponent))
    # The blur of the encoded edge is larger than that of the light by a tenth, which is in the skewed shape.
    assert abs(q - encoded) < 0.1 + 3.0 * error
    assert error < 0.1
    assert abs(encoding_probability([skew] * 3) - encoded) < 0.05


def test_edges_that_are_too_narrow_or_too_few_decide_nothing():
    image, contour = tracked(180.0, 40.0, 0.3, 1.0)
    # All pixels meet the edge at the same place: their shape is that of the pixel, not that of the lens.
    assert 0.2 < encoding_probability([edge_skew(image, contour)]) < 0.8
    few = replace(contour, valid=np.arange(len(contour.valid)) < 5)
    assert encoding_probability([edge_skew(image, few)]) == pytest.approx(0.5)


@pytest.mark.parametrize(("seed", "encodes"), [(2, False), (88, False), (44, True), (114, True)])
def test_zeroing_tells_whether_a_camera_encodes(seed, encodes, tmp_path):
    """Another renderer's light, lens, texture, noise and sharpening; what the camera's file says goes before."""
    world = draw_world(seed)
    assert (world.sensor.gamma > 1.0) == encodes
    sensor = foam_evidence.sensor_for(world, tmp_path)
    zero = sensor.zero([Frame(world.image(Moment()), i / 30, i) for i in range(3)])
    assert abs(zero.encoding - encodes) < 0.05
    zero.save(sensor.setup.zero_path)
    again = FoamSensor.load(tmp_path / "sensor.yaml").zero_reference
    assert again is not None
    assert again.encoding == pytest.approx(zero.encoding, rel=1e-5)
    sensor.setup.camera = replace(sensor.camera, transfer_function="linear" if encodes else "srgb")
    told = FoamSensor(sensor.setup, zero).zero_reference
    assert told is not None
    assert told.encoding == pytest.approx(1 - encodes)


def test_a_shadow_beside_a_part_of_the_base_shifts_nothing(tmp_path):
    """Its penumbra of 5 px lies along the base's edge there, whose blur it doubles; the base is where it was."""
    sequence = foam.shadows(236)
    sensor = foam_evidence.sensor_for(sequence.world, tmp_path)
    zero = sensor.zero([Frame(shot.image, shot.t_s, i) for i, shot in enumerate(sequence.zero())])
    assert zero.encoding > 0.9
    shot, moments = sequence.moments[14]
    sensor.read(Frame(sequence.world.image(*moments), shot.t_s, 99))
    assert sensor.strip is not None
    width = sensor.strip.width_m - zero.encoding * (sensor.strip.encoded_m - zero.encoded_m)
    # Texture and noise are a few hundredths of a pixel of 0.4 mm; the shift would be 1.1 mm.
    assert np.abs(width - zero.width_m).max() < 1e-4
