"""Flat panes of glass: rectangles that show from the side only; opaque boards that read nothing are none."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.reconstruction import reconstruct
from visuohaptic.reconstruction.completion import load_glass_hulls
from visuohaptic.reconstruction.fusion import SpaceGrid
from visuohaptic.reconstruction.transparency.panes import pane_fit

from .glass_caster import Table, _pane_light, cast, ring

GRID = SpaceGrid.around((-0.35, -0.35, 0.0), (0.35, 0.35, 0.28), 0.01)
CAN = ((0.1, 0.17, 0.03, 0.0, 0.12),)
#: Length, height, direction and foot of the middle of the upright pane [m, rad].
LENGTH_M, HEIGHT_M, TURN_RAD, FOOT_M = 0.3, 0.2, 0.5, np.array([0.02, -0.01, 0.01])
ALONG = np.array([np.cos(TURN_RAD), np.sin(TURN_RAD), 0.0])
UPRIGHT = (tuple(FOOT_M - 0.5 * LENGTH_M * ALONG), tuple(LENGTH_M * ALONG), (0.0, 0.0, HEIGHT_M))


def seen(table: Table, count: int = 24) -> list:
    rng = np.random.default_rng([21, count])
    return cast(table, ring(count, turn_rad=0.1), rng, pose_sigma=(0.001, 0.002))


def test_light_that_passes_twice_follows_fresnel():
    # At right angles a face reflects ((1.5 - 1) / (1.5 + 1))^2 = 4 %, a pane 2 * 4 / 104.
    eye, rays = np.array([0.0, 0.0, 1.0]), np.array([[0.0, 0.0, -1.0], [3.0, 0.0, -1.0]])
    light = _pane_light(eye, rays, ((-1.0, -1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0)))
    assert light == pytest.approx([(1 - 0.08 / 1.04) ** 2, 1.0], abs=1e-6)


def test_a_view_is_oblique_where_the_weakest_patches_lose_their_reading():
    """A patch has .7 to 1.3 of the mean contrast, and half of the mean is needed."""

    def passed(angle_rad: float) -> float:
        rays = np.array([[np.tan(angle_rad), 0.0, -1.0]])
        pane = ((-1.0, -1.0, 0.0), (20.0, 0.0, 0.0), (0.0, 2.0, 0.0))
        return float(_pane_light(np.array([0.0, 0.0, 1.0]), rays, pane)[0])

    assert 0.7 * passed(np.arccos(pane_fit._OBLIQUE)) == pytest.approx(0.5, abs=0.02)
    # Up to the first angle at which a pane may show, it takes 2 to 3 % more than at right angles.
    assert 0.02 < passed(0.0) - passed(pane_fit._ANGLES[0]) < 0.03


def test_starts_are_two_first_steps_apart_at_most_and_panes_are_12_cm_at_least():
    """Beyond two steps a simplex has to grow first; twice as near, each start would be searched twice."""
    farthest_rad = 0.5 * np.pi / pane_fit._DIRECTIONS
    assert farthest_rad == pytest.approx(2 * pane_fit._STEPS[3], rel=0.1)
    # A rectangle that ends within the first step of the smallest one is what is left beside another part (the documented size).
    assert 2 * (pane_fit._MIN_HALF_M + pane_fit._STEPS[4]) == pytest.approx(0.12, rel=0.05)


def test_an_upright_pane_is_found_with_its_corners(tmp_path):
    found = reconstruct(seen(Table(cylinders=CAN, panes=(UPRIGHT,))), grid=GRID)
    (pane,) = found.panes
    assert found.regions == ()
    corner, along, up = map(np.array, UPRIGHT)
    truth = corner + np.array([0 * up, along, along + up, up])
    # Half of a matching window is 8 to 10 mm, and the foot is as near to the floor as a reading's tolerance.
    away = np.linalg.norm(pane.corners_m[:, None] - truth, axis=-1)
    assert away.min(axis=0).max() < 0.03
    normal = np.array([-ALONG[1], ALONG[0], 0.0])
    assert abs((pane.corners_m.mean(axis=0) - corner) @ normal) < 4 * pane.sigma_m < 0.02
    sheet = pane.points_m(0.01)
    assert len(found.points_m) == len(found.scores) == len(sheet)
    assert found.scores.min() > 0.9
    found.save(tmp_path)
    (told,) = json.loads((tmp_path / "regions.json").read_text())["panes"]
    assert np.array(told["corners"]) == pytest.approx(pane.corners_m, abs=1e-4)


def test_the_search_ends_when_a_rectangle_has_no_rays_of_its_own(monkeypatch):
    """The likeliest rectangle remains the same although its rays are explained: it is found once."""
    find, told = pane_fit._find, []

    def same(*args: object) -> object:
        told.append(told[0] if told else find(*args))
        assert len(told) < 4, "the search does not end"
        return told[-1]

    monkeypatch.setattr(pane_fit, "_find", same)
    found = reconstruct(seen(Table(cylinders=CAN, panes=(UPRIGHT,))), grid=GRID)
    assert len(found.panes) == 1
    assert len(told) == 2


def test_an_opaque_board_that_reads_nothing_is_no_pane():
    table = Table(cylinders=CAN, panes=(UPRIGHT,))
    dark = []
    for frame in seen(replace(table, panes=())):
        rows, columns = np.mgrid[: frame.camera.height, : frame.camera.width].astype(float)
        rays = frame.camera.rays(np.stack([columns, rows], axis=-1)) @ frame.T_world_camera.rotation.T
        on = _pane_light(frame.T_world_camera.translation_m, rays, UPRIGHT) < 1
        dark.append(replace(frame, depth_m=np.where(on, np.float32(np.nan), frame.depth_m)))
    assert reconstruct(dark, grid=GRID).panes == ()


def test_without_enough_views_from_the_side_a_pane_is_not_claimed():
    found = reconstruct(seen(Table(cylinders=CAN, panes=(UPRIGHT,)), 8), grid=GRID)
    assert found.panes == ()
    assert "60 degrees from its normal" in found.search.text


@pytest.mark.parametrize(
    ("pane", "said"),
    [
        ({"sigma": "1e999"}, "panes.0.sigma: found inf, expected a finite number"),
        ({"sigma": "1e308"}, "panes.0.corners: found NaN or infinity"),
        (
            {"corners": "[[2, 1, 0], [2, 1, 0], [2, 1, 0], [2, 1, 0]]"},
            "panes.0.corners: its points span no volume",
        ),
        (
            {"corners": "[[1e300, 0, 0], [1e300, 1, 0], [1e300, 1, 1], [1e300, 0, 1]]"},
            "panes.0.corners: found 1e+300",
        ),
        ({"corners": "[[2, 1, 0], [2, 2, 0], [2, 2, 1]]"}, "panes.0.corners"),
    ],
)
def test_a_pane_that_is_none_is_refused_by_its_file_and_number(tmp_path, pane, said):
    corners = "[[2, 1, 0], [2, 2, 0], [2, 2, 1], [2, 1, 1]]"
    fields = ", ".join(
        f'"{name}": {text}' for name, text in ({"corners": corners, "sigma": "0.01"} | pane).items()
    )
    path = tmp_path / "regions.json"
    path.write_text(f'{{"clusters": [], "panes": [{{{fields}}}]}}')
    with pytest.raises(InputError) as caught:
        load_glass_hulls(path)
    assert str(caught.value).startswith(f"{path}: {said}")
