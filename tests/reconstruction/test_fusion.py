"""The volume against a plain twin, and its surface against spheres and planes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthFrame
from visuohaptic.io.meshes import read_ply
from visuohaptic.reconstruction.fusion import TsdfVolume
from visuohaptic.reconstruction.fusion.depth_fusion import _as_bricks

from .scenes import SPHERES, ring, surface_error_m, view

CAMERA = Camera.simple(160, 120, 130.0)
VOXEL_M = 0.02


@pytest.fixture(scope="module")
def frames():
    return ring(CAMERA)


@pytest.fixture(scope="module")
def volume(frames):
    made = TsdfVolume.around([0.05, 0.05, -0.1], [0.95, 0.95, 0.5], VOXEL_M)
    made.integrate_all(frames)
    return made


def dense(volume):
    """Distances and weights of a limited volume as arrays over its box; those of bricks that do not exist are 1 and 0."""
    shape = volume._shape + -volume._shape % 8
    distance, weight = np.ones(shape), np.zeros(shape)
    for place, d, w in zip(
        8 * volume._places, _as_bricks(volume._distance), _as_bricks(volume._weight), strict=True
    ):
        here = tuple(slice(a, a + 8) for a in place)
        distance[here], weight[here] = d, w
    inside = tuple(slice(n) for n in volume._shape)
    return distance[inside], weight[inside]


def dense_mask(volume):
    """Which voxels of the box are stored."""
    mask = np.zeros(volume._shape + -volume._shape % 8, bool)
    for place in 8 * volume._places:
        mask[tuple(slice(a, a + 8) for a in place)] = True
    return mask[tuple(slice(n) for n in volume._shape)]


def twin(volume, frames):
    """The same average in NumPy, float64, every voxel projected."""
    index = np.stack(np.meshgrid(*map(np.arange, volume._shape), indexing="ij"), axis=-1)
    points = index * volume.voxel_m + volume.origin_m
    distance, weight = np.ones(index.shape[:3]), np.zeros(index.shape[:3])
    for frame in frames:
        seen = frame.T_world_camera.inverse().apply(points)
        with np.errstate(invalid="ignore", divide="ignore"):
            pixels = np.floor(frame.camera.project(seen) + 0.5)
        inside = (pixels >= 0).all(-1) & (pixels < [frame.camera.width, frame.camera.height]).all(-1)
        u, v = np.where(inside[..., None], pixels, 0).astype(int).transpose(3, 0, 1, 2)
        gap = frame.depth_m[v, u] - seen[..., 2]
        with np.errstate(invalid="ignore"):
            used = inside & (gap >= -volume.truncation_m)
        value = np.minimum(1, gap / volume.truncation_m)
        distance = np.where(used, (distance * weight + value) / (weight + 1), distance)
        weight += used
    return distance, weight


def test_the_kernel_equals_its_plain_twin(volume, frames):
    distance, weight = twin(volume, frames)
    ours, mass = dense(volume)
    stored = dense_mask(volume)
    # A voxel on the border of two pixels may fall to either side in float32.
    same = weight == mass
    assert same[stored].mean() > 0.999
    assert np.percentile(np.abs(distance - ours)[same & stored], 99) < 1e-4
    # What is not stored is far from any surface: free in front of it, or not observed.
    assert (distance[~stored] == 1).all()
    assert not stored.all()


def test_the_surface_lies_on_the_spheres_and_the_plate(volume):
    mesh = volume.mesh(min_weight=2)
    errors = surface_error_m(mesh.vertices_m)
    assert np.median(errors) < 0.1 * VOXEL_M
    # Where spheres meet the plate and at grazing sight the projective distance is too large.
    assert np.percentile(errors, 95) < 0.5 * VOXEL_M


def test_triangles_look_outside(volume):
    mesh = volume.mesh(min_weight=2)
    centre, radius = np.array(SPHERES[0][0]), SPHERES[0][1]
    offset = mesh.vertices_m - centre
    on = (np.abs(np.linalg.norm(offset, axis=1) - radius) < 0.2 * VOXEL_M) & (offset[:, 2] > 0)
    assert on.sum() > 50
    along = (mesh.vertex_normals[on] * offset[on]).sum(axis=1) / radius
    assert np.percentile(along, 5) > 0.9


def test_colour_is_averaged_and_comes_out_as_red_green_blue(volume):
    mesh = volume.mesh(min_weight=2)
    assert mesh.colors is not None
    assert np.median(mesh.colors, axis=0).tolist() == [0, 0, 200]


def test_bricks_leave_no_cracks(volume):
    """Edges of one triangle only are where the known region ends, never between two known bricks."""
    mesh = volume.mesh(min_weight=2)
    edges = np.sort(
        np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1
    )
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    assert counts.max() == 2
    middles = mesh.vertices_m[unique[counts == 1]].mean(axis=1)
    cells = (middles - volume.origin_m) / volume.voxel_m
    known = dense(volume)[1] >= 2
    for cell in cells[:: max(1, len(cells) // 200)]:
        low = np.maximum(np.floor(cell - 1e-6).astype(int) - 1, 0)
        high = np.ceil(cell + 1e-6).astype(int) + 2
        part = known[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        assert not part.all() or (low == 0).any() or (high >= known.shape).any()


def test_a_volume_without_a_box_has_the_same_surface_and_more(frames):
    # The same grid: voxels at whole multiples of the voxel size.
    low_m, high_m = np.array([0.0, 0.0, -0.16]), np.array([1.24, 1.24, 0.76])
    limited = TsdfVolume.around(low_m, high_m, VOXEL_M, color=False)
    whole = TsdfVolume(VOXEL_M, color=False)
    limited.integrate_all(frames)
    whole.integrate_all(frames)
    ours, other = limited.mesh(2).vertices_m, whole.mesh(2).vertices_m
    other = other[((other >= low_m - 1e-9) & (other <= high_m + 1e-9)).all(axis=1)]
    assert len(ours) == len(other) > 1000
    gaps, _ = cKDTree(ours).query(other)
    # A voxel on the border of two pixels may fall to either side in float32, which moves a vertex within its cell.
    assert (gaps > 1e-5).mean() < 0.05
    assert gaps.max() < VOXEL_M


def test_views_one_by_one_miss_only_what_was_free_before(frames):
    """A brick does not know what views saw before it was allocated; the surface is the same to a tenth of a voxel."""
    together, apart = (TsdfVolume.around([0.05, 0.05, -0.1], [0.95, 0.95, 0.5], VOXEL_M) for _ in range(2))
    together.integrate_all(frames)
    for frame in frames:
        apart.integrate(frame)
    gaps, _ = cKDTree(apart.mesh(2).vertices_m).query(together.mesh(2).vertices_m)
    assert np.percentile(gaps, 90) < 0.1 * VOXEL_M


def test_noise_averages_out(frames):
    rng = np.random.default_rng(0)
    frame = frames[0]
    sigma_m = 0.01

    def empty():
        return TsdfVolume.around([0.05, 0.05, -0.1], [0.95, 0.95, 0.5], VOXEL_M, color=False)

    def noisy():
        depth = (frame.depth_m + rng.normal(0, sigma_m, frame.depth_m.shape)).astype(np.float32)
        return DepthFrame(0.0, depth, None, frame.T_world_camera, CAMERA)

    def spread(volume):
        return np.median(surface_error_m(volume.mesh().vertices_m))

    plain, noise = empty(), empty()
    plain.integrate(frame)
    noise.integrate(noisy())
    first = spread(noise)
    for _ in range(15):
        noise.integrate(noisy())
    # 16 views: four times smaller, on top of the grid's own error.
    assert spread(noise) < 0.4 * first + spread(plain)


def test_a_distorted_camera_sees_the_same_surface():
    bent = Camera(160, 120, CAMERA.matrix, np.array([-0.15, 0.03, 0.0, 0.0, 0.0]))
    made = TsdfVolume.around([0.05, 0.05, -0.1], [0.95, 0.95, 0.5], VOXEL_M, color=False)
    for frame in ring(bent, 4):
        made.integrate(frame)
    assert np.median(surface_error_m(made.mesh(2).vertices_m)) < 0.15 * VOXEL_M


def test_errors_say_what_is_wrong():
    with pytest.raises(InputError, match="no surface was seen"):
        TsdfVolume().mesh()
    with pytest.raises(InputError, match="at least 2"):
        TsdfVolume.around(np.zeros(3), np.zeros(3))
    with pytest.raises(InputError, match="expected > 0"):
        TsdfVolume(-1.0)
    far = TsdfVolume(0.001, max_bricks=10)
    with pytest.raises(InputError, match="at most 10"):
        far.integrate(view(CAMERA, Camera.pose_of_view((0.5, -0.4, 0.6), (0.5, 0.5, 0.1))))


def test_meshes_survive_a_file(tmp_path, volume):
    mesh = volume.mesh(2)
    mesh.save(tmp_path / "m.ply")
    found = type(mesh).load(tmp_path / "m.ply")
    np.testing.assert_allclose(found.vertices_m, mesh.vertices_m, atol=1e-6)
    np.testing.assert_array_equal(found.faces, mesh.faces)
    np.testing.assert_array_equal(found.colors, mesh.colors)
    data = (tmp_path / "m.ply").read_bytes()
    (tmp_path / "cut.ply").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError):
        type(mesh).load(tmp_path / "cut.ply")


def test_text_files_with_polygons_and_scores_are_read(tmp_path):
    (tmp_path / "m.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "property float score\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0 0.5\n1 0 0 1\n1 1 0 2\n0 1 0 3\n4 0 1 2 3\n"
    )
    found = read_ply(tmp_path / "m.ply")
    assert found.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert found.fields["score"].tolist() == pytest.approx([0.5, 1, 2, 3])


def test_identity_pose_and_an_all_invalid_view_change_nothing():
    made = TsdfVolume(VOXEL_M, color=False)
    depth = np.full((120, 160), np.nan, np.float32)
    made.integrate(DepthFrame(0.0, depth, None, Pose.identity(), CAMERA))
    assert made.bricks == 0


@pytest.mark.parametrize("voxels", [7, 8, 9])
def test_a_surface_exactly_on_voxels_is_found_wherever_bricks_end(voxels):
    """Distances of exactly zero at the first voxels of a brick of 8."""
    camera = Camera.simple(48, 36, 40.0)
    frame = DepthFrame(0.0, np.full((36, 48), 0.75, np.float32), None, Pose.identity(), camera)
    low_m = np.array([-0.125, -0.125, 0.75 - voxels * 0.015625])  # powers of two: no rounding
    limited = TsdfVolume.around(low_m, low_m + 0.25, 0.015625, color=False)
    whole = TsdfVolume(0.015625 * voxels / 8, color=False)
    for volume in (limited, whole):
        volume.integrate(frame)
        assert np.abs(volume.mesh().vertices_m[:, 2] - 0.75).max() < 1e-6
