"""Maps with obstacles: our own office, and third-party real maps."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.files import load_yaml
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.simulation.mobile import ApproachPath, furnished_office, obstacles_for_map


def read_map(path: Path) -> tuple[np.ndarray, float, tuple[float, float, float]]:
    """A small reader of its own: truth made another way than the package's."""
    import cv2

    about = load_yaml(path)
    grey = cv2.imread(str(path.parent / about["image"]), cv2.IMREAD_GRAYSCALE)
    dark = (255 - grey[::-1].astype(float)) / 255
    cells = np.full(grey.shape, -1, np.int8)
    cells[dark > about["occupied_thresh"]] = 100
    cells[dark < about["free_thresh"]] = 0
    x, y, yaw = about["origin"]
    return cells, float(about["resolution"]), (float(x), float(y), float(yaw))


def check(
    paths: tuple[ApproachPath, ...], cells: np.ndarray, resolution: float, origin: tuple[float, float, float]
) -> None:
    """Every disc of the platform along every way lies on free cells; brute force, cell by cell."""
    radius = 0.2
    c, s = math.cos(origin[2]), math.sin(origin[2])
    grid = np.arange(-radius, radius + 1e-9, resolution / 2)
    disc = np.array([(u, v) for u in grid for v in grid if math.hypot(u, v) <= radius])
    assert [path.obstacle.fixed for path in paths] == [False, False, True]
    for path in paths:
        x, y, heading = path.start
        assert path.obstacle.x_m == pytest.approx(x + path.distance_m * math.cos(heading))
        assert path.obstacle.y_m == pytest.approx(y + path.distance_m * math.sin(heading))
        assert path.obstacle.yaw_rad == pytest.approx(heading)
        for way in np.arange(0, path.distance_m, 0.05):
            centre = (x + way * math.cos(heading) - origin[0], y + way * math.sin(heading) - origin[1])
            points = disc + np.array(centre)
            column = np.floor((c * points[:, 0] + s * points[:, 1]) / resolution).astype(int)
            row = np.floor((c * points[:, 1] - s * points[:, 0]) / resolution).astype(int)
            assert (cells[row, column] == 0).all()
    centres = np.array([(p.obstacle.x_m, p.obstacle.y_m) for p in paths])
    gaps = [float(np.hypot(*(centres[i] - centres[j]))) for i in range(3) for j in range(i)]
    assert min(gaps) > 2 * radius


def test_own_office(tmp_path: Path) -> None:
    office = furnished_office()
    check(office.paths, office.map.cells, office.map.resolution_m, office.map.origin)
    assert len(office.furniture) == 4
    path = tmp_path / "map.yaml"
    office.map.save(path)
    cells, resolution, origin = read_map(path)
    assert np.array_equal(cells, office.map.cells)
    assert (resolution, origin) == (office.map.resolution_m, office.map.origin)


@pytest.mark.data
@pytest.mark.parametrize(
    "name",
    [
        "aws_small_house/map",
        "cob_ipa_apartment/map",
        "mit_stata/stata_basement",
        "nav2/depot",
        "wpi_rail/rail_lab",
    ],
)
def test_real_maps(data: Path, name: str) -> None:
    cells, resolution, origin = read_map(data / "navigation" / "dev" / "maps" / f"{name}.yaml")
    check(obstacles_for_map(OccupancyMap(cells, resolution, origin)), cells, resolution, origin)


def test_turned_map_is_the_same_place_turned() -> None:
    cells = furnished_office().map.cells
    turned = obstacles_for_map(OccupancyMap(cells, 0.05, (1.0, 2.0, 0.5)))
    check(turned, cells, 0.05, (1.0, 2.0, 0.5))
    flat = obstacles_for_map(OccupancyMap(cells, 0.05))
    c, s = math.cos(0.5), math.sin(0.5)
    for a, b in zip(turned, flat, strict=True):
        x, y = b.obstacle.x_m, b.obstacle.y_m
        assert (a.obstacle.x_m, a.obstacle.y_m) == pytest.approx((1.0 + c * x - s * y, 2.0 + s * x + c * y))


def test_maps_without_room_are_refused() -> None:
    with pytest.raises(InputError, match="no free place wider than"):
        obstacles_for_map(OccupancyMap(np.full((20, 20), 100, np.int8), 0.05))
    with pytest.raises(InputError, match="no room for obstacle"):
        obstacles_for_map(OccupancyMap(np.zeros((16, 16), np.int8), 0.05))
