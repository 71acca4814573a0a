"""Contacts on the visible surface determine the pose error of the haptic frame."""

from __future__ import annotations

import json

import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.core import CalibrationError, InputError
from visuohaptic.core.camera import Pose
from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.reconstruction.completion import register_touches
from visuohaptic.simulation.tabletop import random_bottle

SIGMA_M = 0.0003


def touched(rng, count=24):
    """An elliptic bottle's lower half and contacts on it."""
    bottle = random_bottle(rng, "elliptic")
    surface = SurfaceMesh(*bottle.mesh(0.0, 0.5 * bottle.height_m))
    theta = rng.uniform(0, 2 * np.pi, count)
    z = rng.uniform(0.05, 0.48, count) * bottle.height_m
    rho = bottle.radius_m(theta, z)
    contacts = np.column_stack([rho * np.cos(theta), rho * np.sin(theta), z])
    contacts[: count // 4, 2] = 0.0  # some on the floor, else the height stays open
    contacts[: count // 4, :2] *= 0.6
    return bottle, surface, contacts + SIGMA_M * rng.standard_normal((count, 3))


@pytest.mark.parametrize("seed", range(4))
def test_a_pose_that_is_off_is_found(seed):
    rng = np.random.default_rng([3, seed])
    _, surface, contacts = touched(rng)
    off = Pose.from_rotation_vector(np.radians(3) * rng.standard_normal(3), 0.006 * rng.standard_normal(3))
    pose, rms_m = register_touches(off.inverse().apply(contacts), surface)
    left = np.linalg.norm(pose.apply(off.inverse().apply(contacts)) - contacts, axis=1)
    # Noise of 0.3 mm and triangles of 3 mm; the turn about the axis is told by a flattening of 10-40 % only.
    assert np.sqrt(np.mean(left**2)) < 0.002
    assert rms_m < 0.0008


def test_one_contact_elsewhere_is_borne():
    rng = np.random.default_rng(8)
    bottle, surface, contacts = touched(rng)
    contacts[-2:] += [0.02, 0.0, 0.3 * bottle.height_m]  # on the part that is not seen
    off = Pose.from_rotation_vector([0.0, 0.03, 0.0], [0.006, -0.004, 0.003])
    pose, _ = register_touches(off.inverse().apply(contacts), surface)
    left = np.linalg.norm((pose @ off.inverse()).apply(contacts[:-2]) - contacts[:-2], axis=1)
    assert np.sqrt(np.mean(left**2)) < 0.003


def test_what_cannot_be_fitted_is_told():
    _, surface, contacts = touched(np.random.default_rng(1))
    with pytest.raises(InputError, match="n >= 6"):
        register_touches(contacts[:5], surface)
    with pytest.raises(CalibrationError, match="half of the contacts"):
        register_touches(contacts + 1.0, surface)


def test_the_verb_fits_the_frame(tmp_path, capsys):
    rng = np.random.default_rng(2)
    bottle, surface, contacts = touched(rng)
    off = Pose.from_rotation_vector([0.02, 0.0, 0.0], [0.004, 0.005, -0.003])
    surface.save(tmp_path / "model.ply")
    hull = bottle.mesh(0.55 * bottle.height_m, 0.9 * bottle.height_m, caps=False)[0][::7]
    (tmp_path / "regions.json").write_text(json.dumps({"clusters": [{"hull": hull.tolist()}]}))
    lines = [",".join(map(str, point)) for point in off.inverse().apply(contacts)]
    (tmp_path / "known.csv").write_text("\n".join(["x_m,y_m,z_m", *lines]) + "\n")
    words = ["complete", str(tmp_path / "model.ply"), "--region", str(tmp_path / "regions.json"), "--json"]
    assert main([*words, "--out", str(tmp_path / "c.ply"), "--register", str(tmp_path / "known.csv")]) == 0
    told = json.loads(capsys.readouterr().out)["registration"]
    assert told["rms_m"] < 0.001
    np.testing.assert_allclose(told["matrix_visual_haptic"], off.matrix, atol=0.05)
