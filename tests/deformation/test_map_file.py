from __future__ import annotations

import base64
import re
import struct
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import InputError, StiffnessMap
from visuohaptic.deformation.maps import colours, load_map, object_map, plot_map, save_map
from visuohaptic.deformation.maps.confidence_band import nearest_value
from visuohaptic.deformation.nonlinear import Contents
from visuohaptic.deformation.shapes import ShellObject, load_container, mesh_container


@pytest.fixture(scope="module")
def cup() -> ShellObject:
    return mesh_container(load_container("cup").middle(), around=24)


@pytest.fixture(scope="module")
def found(cup: ShellObject) -> StiffnessMap:
    return object_map(cup)


def test_npz_round_trip(tmp_path: Path, found: StiffnessMap) -> None:
    save_map(tmp_path / "map.npz", found)
    again = load_map(tmp_path / "map.npz")
    for name in ("vertices_m", "faces", "stiffness_N_per_m", "stiffness_sigma_N_per_m"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


def test_vtu_holds_the_arrays(tmp_path: Path, found: StiffnessMap) -> None:
    save_map(tmp_path / "map.vtu", found)
    text = (tmp_path / "map.vtu").read_text()
    arrays = dict(re.findall(r'Name="(\w+)"[^>]*>([^<]*)<', text))
    data = base64.b64decode(arrays["stiffness_N_per_m"])
    assert struct.unpack("<Q", data[:8])[0] == len(data) - 8
    np.testing.assert_array_equal(np.frombuffer(data[8:], "<f8"), found.stiffness_N_per_m)
    assert len(base64.b64decode(arrays["connectivity"])) == 8 + 8 * found.faces.size


def test_glb_is_read_by_others_with_y_up(tmp_path: Path, found: StiffnessMap) -> None:
    trimesh = pytest.importorskip("trimesh")
    save_map(tmp_path / "map.glb", found)
    mesh = trimesh.load_scene(tmp_path / "map.glb").to_mesh()
    np.testing.assert_allclose(
        np.ptp(mesh.vertices, axis=0), np.ptp(found.vertices_m, axis=0)[[0, 2, 1]], rtol=1e-5
    )
    assert len(mesh.faces) == len(found.faces)


def test_soft_is_blue_and_stiff_is_red() -> None:
    shade = colours(np.array([100.0, 1000.0, 1e4, np.inf, np.nan]))
    assert shade[0, 2] > shade[0, 0]
    assert shade[2, 0] > shade[2, 2]
    np.testing.assert_array_equal(shade[2], shade[3])


def test_picture(tmp_path: Path, found: StiffnessMap) -> None:
    plot_map(tmp_path / "map.png", found, "cup")
    assert (tmp_path / "map.png").read_bytes()[:4] == b"\x89PNG"


def test_bad_names_and_damaged_files_are_refused(tmp_path: Path, found: StiffnessMap) -> None:
    with pytest.raises(InputError, match=r"\.npz, \.vtu or \.glb"):
        save_map(tmp_path / "map.stl", found)
    save_map(tmp_path / "map.npz", found)
    data = (tmp_path / "map.npz").read_bytes()
    rng = np.random.default_rng(0)
    for cut in rng.integers(0, len(data), 20):
        (tmp_path / "cut.npz").write_bytes(data[:cut])
        with pytest.raises(InputError):
            load_map(tmp_path / "cut.npz")
    np.savez(tmp_path / "other.npz", vertices_m=np.zeros((3, 3)))
    with pytest.raises(InputError, match="faces"):
        load_map(tmp_path / "other.npz")


def test_sigma_is_the_spread_of_maps_with_other_walls_and_moduli(cup: ShellObject) -> None:
    """Monte Carlo over wall and modulus against the declared band."""
    from dataclasses import replace

    from visuohaptic.deformation.shells import IsotropicMaterial, ShellMesh

    small = replace(cup, wall_spread=0.05, youngs_modulus_spread=0.04)
    for contents in (None, Contents(fill=0.9)):
        declared = object_map(small, contents)
        rng = np.random.default_rng(5)
        drawn = []
        for _ in range(40):
            wall, modulus = 1 + 0.05 * rng.normal(), 1 + 0.04 * rng.normal()
            mesh = small.mesh
            other = replace(
                small,
                mesh=ShellMesh(
                    mesh.vertices_m, mesh.faces, np.asarray(mesh.thickness_m) * wall, mesh.fraction
                ),
                material=IsotropicMaterial(
                    small.material.youngs_modulus_Pa * modulus, small.material.poisson_ratio
                ),
            )
            drawn.append(object_map(other, contents, band=False).stiffness_N_per_m)
        use = np.isfinite(declared.stiffness_N_per_m)
        ratio = (
            np.std(np.log(np.array(drawn)[:, use]), axis=0)
            / (declared.stiffness_sigma_N_per_m / declared.stiffness_N_per_m)[use]
        )
        # A standard deviation from 40 draws is known to 11 % (one sigma); all points share the draws.
        assert np.median(ratio) == pytest.approx(1.0, abs=0.27)
        assert np.ptp(ratio) < 0.1


def test_a_ten_percent_wall_is_a_fifth_in_stiffness(found: StiffnessMap) -> None:
    use = np.isfinite(found.stiffness_N_per_m) & (found.vertices_m[:, 2] > 0.03)
    relative = (found.stiffness_sigma_N_per_m / found.stiffness_N_per_m)[use]
    # k ~ t^2.07 in the middle of a tube, between t^2 and t^3 elsewhere; the modulus adds 7 % of PP.
    assert 0.19 < np.median(relative) < 0.27


def test_the_nearest_point_is_on_the_surface(found: StiffnessMap) -> None:
    vertex = 10 * 24 + 5
    value, place = nearest_value(
        found.vertices_m, found.faces, found.stiffness_N_per_m, found.vertices_m[vertex] * [1.1, 1.1, 1]
    )
    assert value == pytest.approx(found.stiffness_N_per_m[vertex], rel=0.05)
    np.testing.assert_allclose(place, found.vertices_m[vertex], atol=1e-3)


def test_on_the_held_base_the_stiffness_is_infinite() -> None:
    vertices = np.array([[0.03, 0, 0], [0, 0.03, 0], [0.03, 0, 0.01], [0, 0.03, 0.01]])
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    stiffness = np.array([np.inf, np.inf, 2000.0, 2000.0])
    value, place = nearest_value(vertices, faces, stiffness, np.array([0.03, 0, 0]))
    assert value == np.inf
    np.testing.assert_allclose(place, vertices[0], atol=1e-12)


def test_a_map_with_negative_stiffness_is_refused(found: StiffnessMap, tmp_path: Path) -> None:
    path = tmp_path / "negative.npz"
    np.savez(
        path,
        vertices_m=found.vertices_m,
        faces=found.faces,
        stiffness_N_per_m=-np.abs(found.stiffness_N_per_m),
        stiffness_sigma_N_per_m=found.stiffness_sigma_N_per_m,
    )
    with pytest.raises(InputError, match=r"stiffness_N_per_m: found -.*, expected no number below 0"):
        load_map(path)
