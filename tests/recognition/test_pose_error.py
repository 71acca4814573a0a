from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.recognition.data import HEIGHTS, pose_error_changes

RADIUS_m, HEIGHT_m = 0.04, 0.16


def _cylinder(rate_per_m: float, ridge: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, stiffness exp(rate z) with a ridge at one height, and the places of the features."""
    turn, z = np.meshgrid(np.linspace(0, 2 * np.pi, 64, endpoint=False), np.linspace(0, HEIGHT_m, 81))
    vertices = np.stack([RADIUS_m * np.cos(turn), RADIUS_m * np.sin(turn), z], axis=-1).reshape(-1, 3)
    log_k = rate_per_m * vertices[:, 2] + ridge * np.exp(-0.5 * ((vertices[:, 2] - 0.085) / 0.003) ** 2)
    places = np.zeros((HEIGHTS, 4, 3))
    places[..., 2] = ((np.arange(HEIGHTS) + 0.5) / HEIGHTS * HEIGHT_m)[:, None]
    for column, direction in enumerate(([1, 0], [-1, 0], [0, 1], [0, -1])):
        places[:, column, :2] = RADIUS_m * np.array(direction)
    return vertices, np.exp(log_k), places


def test_a_slope_turns_a_shift_and_a_tilt_into_a_change() -> None:
    rate = 30.0
    changes = pose_error_changes(*_cylinder(rate), np.random.default_rng(0), copies=400)
    inner = changes[:, 3:13]
    both = inner.mean(axis=2)  # the shift; of both axes and all heights alike
    assert both.std() == pytest.approx(rate * 0.002, rel=0.15)  # 800 samples: 4 %
    assert np.abs(inner[:, :1, 0] - inner[..., 0]).max() < 0.01
    # Both tips are on one line: what one gains the other loses, by half the width times the tilt.
    for first, second in ((0, 1), (2, 3)):
        half = 0.5 * (inner[..., first] - inner[..., second])
        assert half.std() == pytest.approx(rate * RADIUS_m * 0.05, rel=0.15)
    assert abs(np.corrcoef(inner[:, 5, 0] - inner[:, 5, 1], inner[:, 5, 2] - inner[:, 5, 3])[0, 1]) < 0.2


def test_a_ridge_between_the_heights_is_seen_only_beside_it() -> None:
    changes = pose_error_changes(*_cylinder(0.0, ridge=1.0), np.random.default_rng(0), copies=200)
    spread = changes.std(axis=(0, 2))
    assert spread[8] > 0.2  # on the ridge itself
    assert spread[:6].max() < 0.05
    assert spread[12:].max() < 0.05


def test_no_pose_error_is_no_change_and_no_wall_is_none_either() -> None:
    vertices, stiffness, places = _cylinder(30.0)
    still = pose_error_changes(
        vertices, stiffness, places, np.random.default_rng(0), pose_m=0.0, tilt_rad=0.0
    )
    np.testing.assert_allclose(still, 0.0, atol=1e-9)
    stiffness[vertices[:, 0] > 0.01] = np.nan
    assert (pose_error_changes(vertices, stiffness, places, np.random.default_rng(0))[..., 0] == 0).all()
