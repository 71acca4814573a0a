"""Limits that separate what may be measured from what cannot: each holds on both sides, a tenth or less apart."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy import constants
from scipy.special import ndtri

from visuohaptic.core import Camera, Estimate, HapticTag, InputError, normal_sigmas
from visuohaptic.core.errors import brief_list
from visuohaptic.core.files import parse_yaml, regular
from visuohaptic.core.measurement import AIR_PA, GRAVITY_M_S2
from visuohaptic.core.objects import NOMINAL_N, LOW_m, NOMINAL_m


@pytest.mark.parametrize("probability", [0.5, 0.1, 1e-3, 1e-9])
def test_a_normal_error_is_beyond_its_limit_with_the_given_probability(probability: float) -> None:
    """Against the tail integral of the error function."""
    assert math.erfc(normal_sigmas(probability) / math.sqrt(2.0)) == pytest.approx(probability, rel=1e-9)


def test_a_magnitude_is_negative_by_noise_once_in_a_thousand_million() -> None:
    for tail, valid in ((1.1e-9, True), (0.9e-9, False)):
        tag = HapticTag(static_friction_N=Estimate(0.1 * float(ndtri(tail)), 0.1))
        if valid:
            tag.check_read()
            continue
        with pytest.raises(InputError, match="expected >= 0"):
            tag.check_read()


def test_a_focal_length_that_no_lens_of_this_kind_has_is_told(
    tmp_path, caplog: pytest.LogCaptureFixture
) -> None:
    """A field of view of 137 degrees is the limit: the tangent of half of it is 2.54."""
    for degrees, told in ((133.0, False), (141.0, True)):
        focal = 320.0 / math.tan(math.radians(0.5 * degrees))
        matrix = np.array([[focal, 0.0, 319.5], [0.0, focal, 239.5], [0.0, 0.0, 1.0]])
        path = tmp_path / f"{degrees}.yaml"
        Camera(640, 480, matrix, np.zeros(5)).save(path)
        caplog.clear()
        Camera.load(path)
        assert ("is it in millimetres?" in caplog.text) == told


def test_a_list_in_a_message_has_600_characters() -> None:
    """As many names as fit, and a line of a path, the list and a remedy that stays below a thousand characters."""
    names = [f"name_{k:03d}" for k in range(200)]
    text = brief_list(names)
    listed = text.partition(", and ")[0]
    assert len(listed) <= 600 < len(listed) + 2 * len(", name_000")
    assert len(str(InputError("x" * 200, f"found {text}", remedy="y" * 150))) < 1000


def test_every_integer_of_64_bits_is_read_and_longer_text_is_none() -> None:
    """In binary, with an underscore after each digit, it has 130 characters less the last underscore and sign."""
    bits = "0b" + "_".join(["1111"] * 16)
    assert parse_yaml(f"a: {bits}", "a.yaml") == {"a": 2**64 - 1}
    with pytest.raises(InputError, match="a number of 105 characters"):
        parse_yaml("a: " + "1" * 105, "a.yaml")


def test_gravity_and_the_pressure_of_the_air_are_those_of_the_earth() -> None:
    """Standard values; gravity differs by a quarter of a per cent between the equator and the poles."""
    assert pytest.approx(constants.atm, rel=0.002) == AIR_PA
    assert pytest.approx(constants.g, rel=0.002) == GRAVITY_M_S2


def test_the_largest_files_are_those_of_the_security_page() -> None:
    """Each reader is held against the same table by files that are larger, apart from here."""
    page = (Path(__file__).parents[2] / "SECURITY.md").read_text(encoding="utf-8")
    size = {
        row[1]: int(row[2]) << (20 if row[3] == "MiB" else 30)
        for row in re.finditer(r"^\| ([^|]+) \| (\d+) (MiB|GiB) \|$", page, re.MULTILINE)
    }
    assert size["YAML"] == regular.MAX_HAND_BYTES
    assert size["JSON, trajectory"] == regular.MAX_TEXT_BYTES
    assert size["image, table of forces"] == regular.MAX_DATA_BYTES
    assert size["PLY, network"] == regular.MAX_FILE_BYTES


def test_stiffness_features_have_the_units_of_the_dissertation() -> None:
    """Alt 2016, Sec. 6.1.6: low deformations up to 3 mm; nominal 50 N and 10 mm."""
    assert (LOW_m, NOMINAL_N, NOMINAL_m) == pytest.approx((0.003, 50.0, 0.010))
