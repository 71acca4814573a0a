from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import grasp_curve, object_stiffness, side_vertex
from visuohaptic.deformation.shapes import (
    ContainerDescription,
    ShellObject,
    class_names,
    is_round,
    load_container,
    mesh_container,
    ring_lid,
    symmetric_part,
    with_elastic_base,
)
from visuohaptic.deformation.shells import dual_tip_map, enclosed_volume, opposing_points


def tube(**more: object) -> ContainerDescription:
    return ContainerDescription.model_validate(
        {
            "base": {"radius": "35 mm"},
            "sections": [{"height": "200 mm"}],
            "wall": "0.5 mm",
            "youngs_modulus": "2.5 GPa",
            **more,
        }
    )


#: Stiffness of that tube by height: Fourier series of the Koiter shell, 400 harmonics.
SERIES = {0.02: 15_547.0, 0.05: 10_062.0, 0.10: 6_164.0, 0.15: 3_486.0, 0.20: 1_230.0}


def rings(container: ShellObject) -> tuple[np.ndarray, list[np.ndarray]]:
    """Heights of a tube's rings above the foot, and the stiffness of their vertices."""
    stiffness = dual_tip_map(container.model())
    z = container.mesh.vertices_m[:, 2]
    heights = np.unique(z)[1:]
    return heights, [stiffness[z == height] for height in heights]


@pytest.mark.parametrize(
    ("around", "within"), [(48, {0.02: 0.03, 0.05: 0.015, 0.20: 0.012}), (64, {0.02: 0.01, 0.20: 0.01})]
)
def test_the_tube_is_as_stiff_as_the_series_says_and_equally_all_round(
    around: int, within: dict[float, float]
) -> None:
    z, stiffness = rings(mesh_container(tube(), around=around))
    mean = [ring.mean() for ring in stiffness]
    for height, wanted in SERIES.items():
        assert np.interp(height, z, mean) == pytest.approx(wanted, rel=within.get(height, 0.0075))
    scatter = np.array([np.ptp(ring) / ring.mean() for ring in stiffness])
    # Rings are doubled twice towards the rim: the two kinds of vertices there differ a little; the
    # crossed diagonals of all other rings are symmetric to rounding.
    assert scatter.max() < 2e-3
    assert scatter[z < 0.15].max() < 2e-5
    assert scatter[-1] < 2e-5


def test_a_narrow_neck_is_not_finer_than_the_wall_needs() -> None:
    neck = tube(sections=[{"height": "100 mm"}, {"height": "60 mm", "radius": "18 mm"}])
    z = mesh_container(neck, around=32).mesh.vertices_m[:, 2]
    assert np.unique(z, return_counts=True)[1].max() == 64
    even = mesh_container(neck, around=32, even=True).mesh.vertices_m[:, 2]
    assert set(np.unique(even, return_counts=True)[1]) == {32}


@pytest.mark.parametrize("name", class_names())
def test_every_class_is_closed_by_its_lid_and_looks_outwards(name: str) -> None:
    container = mesh_container(load_container(name).middle(), around=32)
    faces = np.concatenate([container.surface_faces, container.lid])
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)
    edges, times = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    open_edges = edges[times == 1]
    assert (container.mesh.vertices_m[open_edges, 2] == 0).all()  # the foot, which the plane z = 0 closes
    assert 5e-5 < container.volume_m3 < 3e-3
    # Both ways to halve the cells enclose about the same.
    assert enclosed_volume(container.mesh.vertices_m, faces) == pytest.approx(container.volume_m3, rel=0.01)
    assert container.fixed.sum() == 32


def test_volume_of_a_tube() -> None:
    for top in ("open", "closed"):
        container = mesh_container(tube(top={"kind": top}), around=96, even=True)
        # A polygon of n corners has the area n / 2 sin(2 pi / n) r^2.
        area = 48 * np.sin(2 * np.pi / 96) * 0.035**2
        assert container.volume_m3 == pytest.approx(0.2 * area, rel=1e-9)


def test_symmetry_is_detected_and_lost_by_a_dent_or_a_shift() -> None:
    ellipse = tube(base={"shape": "ellipse", "radius": "45 mm", "radius_y": "25 mm"})
    dent = [{"z": "100 mm", "angle": "20 deg", "depth": "4 mm", "width": "30 mm", "height": "30 mm"}]
    shifted = tube(sections=[{"height": "200 mm", "radius": "30 mm", "shift": "8 mm"}])
    for description, copies in ((tube(), 4), (ellipse, 4), (tube(dents=dent), 1), (shifted, 2)):
        container = mesh_container(description, around=32)
        assert symmetric_part(container).copies == copies
        assert is_round(container) == (description == tube())


def test_a_rim_stiffens_the_mouth() -> None:
    cup, rim = (load_container(name).middle() for name in ("cup", "cup-rim"))
    soft, stiff = (dual_tip_map(mesh_container(what, around=32).model()) for what in (cup, rim))
    assert np.nanmin(stiff[32:]) > 3 * np.nanmin(soft[32:])


@pytest.mark.parametrize("count", [3, 4, 5, 8, 9, 30])
def test_lids_cover_a_ring_once(count: int) -> None:
    faces = ring_lid(np.arange(count))
    angle = 2 * np.pi * np.arange(count) / count
    points = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)[:, 2] / 2
    assert (area > 0).all()
    assert area.sum() == pytest.approx(count / 2 * np.sin(2 * np.pi / count))


@pytest.mark.parametrize("around", [0, 6, 30, 5000])
def test_bad_resolution_is_refused(around: int) -> None:
    with pytest.raises(InputError, match="multiple of 4"):
        mesh_container(tube(), around=around)


def test_an_elastic_base_is_between_a_free_and_a_clamped_one() -> None:
    container = mesh_container(load_container("elliptic").middle(), around=16)
    vertex = side_vertex(container, "y+", 0.02)
    tips = opposing_points(container.mesh, np.array([vertex]))
    stiff = [
        float(object_stiffness(body, tips, band=False)[0][0])
        for body in (
            with_elastic_base(container, 1e4),
            with_elastic_base(container, 1e6),
            with_elastic_base(container, 1e12),
            container,
        )
    ]
    assert stiff == sorted(stiff)
    # Only the foot's rotation is left free: near the foot a few percent.
    assert stiff[2] == pytest.approx(stiff[3], rel=0.1)
    # Pushed sideways as a whole, it moves by force / stiffness, and tilts on top.
    soft = with_elastic_base(container, 1.0)
    model = soft.model()
    load = np.zeros((model.nodes, 6))
    load[:16, 0] = 1 / 16
    moved = model.solve(load)
    assert moved[:16, 0].mean() == pytest.approx(1.0, rel=0.02)


def test_an_elastic_base_keeps_the_symmetry() -> None:
    container = with_elastic_base(mesh_container(load_container("elliptic").middle(), around=16), 2e4)
    steps = [0.001, 0.003]
    part = grasp_curve(container, side="y+", height_m=0.03, deformation_m=steps)
    whole = grasp_curve(container, side="y+", height_m=0.03, deformation_m=steps, symmetric=False)
    assert (part.copies, whole.copies) == (4, 1)
    np.testing.assert_allclose(part.force_N, whole.force_N, rtol=1e-4)


@pytest.mark.parametrize("stiffness", [0.0, -1.0, float("inf"), float("nan")])
def test_a_base_without_stiffness_is_refused(stiffness: float) -> None:
    with pytest.raises(InputError, match="expected more than 0"):
        with_elastic_base(mesh_container(load_container("cup").middle(), around=16), stiffness)
