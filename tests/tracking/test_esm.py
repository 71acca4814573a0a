"""The planar tracker against views whose homography is known exactly."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.ndimage import map_coordinates

from visuohaptic.core import InputError
from visuohaptic.tracking.templates import EsmSettings, EsmTemplate, align, motion_jacobian, velocity_fields
from visuohaptic.tracking.templates.alignment import _esm_kernels as kernels
from visuohaptic.tracking.templates.alignment import _sample_kernels as sample_kernels

SIZE = (300, 300)


def moved_corners(view, rng: np.random.Generator, distance: float, at: float = 55.0) -> tuple:
    """True homography near the middle of the frame, and a start whose corners are ``distance`` off."""
    from benchmarks._plane_view import corner_homography

    true = view.corners + at + rng.uniform(-3, 3, (4, 2))
    angle = rng.uniform(0, 2 * np.pi, 4)
    start = true + distance * np.column_stack([np.cos(angle), np.sin(angle)])
    return corner_homography(view.corners, true), corner_homography(view.corners, start)


@pytest.fixture(scope="module")
def astronaut(views: ModuleType):
    return views.PlaneView.named("astronaut", 200)


def test_exponential_is_the_matrix_exponential() -> None:
    rng = np.random.default_rng(0)
    for size in (1e-6, 0.1, 3.0):
        p = rng.normal(0, size, 8)
        a = np.array([[p[1], p[2], p[0]], [p[4], p[5], p[3]], [p[6], p[7], 0]])
        a -= np.eye(3) * np.trace(a) / 3
        result = np.zeros((3, 3))
        kernels.exponential(np.append(p, [0, 0]), result)
        np.testing.assert_allclose(result, expm(a), rtol=1e-8, atol=1e-10)
        assert np.linalg.det(result) == pytest.approx(1.0, rel=1e-8)  # SL(3)


def test_fields_are_the_derivative_of_the_exponential() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (7, 2))
    h = np.array([[90, 5, 200], [-4, 95, 150], [0.05, -0.03, 1.0]])
    jacobian = motion_jacobian(h, points)
    growth = np.zeros((3, 3))
    for k in range(8):
        sides = []
        for sign in (1, -1):
            step = np.zeros(10)
            step[k] = sign * 1e-5
            kernels.exponential(step, growth)
            mapped = np.column_stack([points, np.ones(7)]) @ (h @ growth).T
            sides.append(mapped[:, :2] / mapped[:, 2:])
        np.testing.assert_allclose(jacobian[:, :, k], (sides[0] - sides[1]) / 2e-5, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("cubic", [False, True])
@pytest.mark.parametrize("fraction", [0.0, 0.5])
def test_sums_equal_their_numpy_twin(cubic: bool, fraction: float) -> None:
    """The kernel's moments, put together, are J^T W J and J^T W r of a plain implementation."""
    rng = np.random.default_rng(2)
    rows, columns, height, width = 20, 26, 50, 60
    image = rng.uniform(20, 220, (height, width)).astype(np.float32)
    template = rng.uniform(20, 220, (rows, columns)).astype(np.float32)
    tx, ty = (rng.normal(0, 30, (rows, columns)).astype(np.float32) for _ in range(2))
    unit = columns / 2
    x = ((np.arange(columns) - 12.5) / unit).astype(np.float32)
    y = (np.arange(rows) - 9.5) / unit
    offset = rng.uniform(-0.4, 0.4, (2, rows, columns)).astype(np.float32)
    h = np.array([1.1, 0.1, 12.0, -0.1, 0.9, 21.0, 1e-3, -2e-3, 1.0])
    gain, bias, cut, margin = 0.8, 12.0, 60.0, 30.0
    matrix, vector, stats = np.zeros((10, 10)), np.zeros(10), np.zeros(13)
    used = np.arange(rows)
    value, inside = np.full((2, rows, columns), np.nan, np.float32)
    energy = sample_kernels.sample_rows(image, h.reshape(3, 3), offset, used, cubic, value, inside)
    kernels.gauss_newton_sums(
        value, inside, energy, template, tx, ty, x, y, used, gain, bias, cut, margin, fraction, unit,
        matrix, vector, stats, np.zeros(256, np.int64),
    )  # fmt: skip

    v, u = np.mgrid[:rows, :columns].astype(float)
    q = h[6] * u + h[7] * v + 1
    px = (h[0] * u + h[1] * v + h[2]) / q + offset[0]
    py = (h[3] * u + h[4] * v + h[5]) / q + offset[1]
    inside = (px >= 1) & (px <= width - 2.001) & (py >= 1) & (py <= height - 2.001)
    # With ``cubic`` the image is taken as B-spline coefficients.
    value = map_coordinates(image.astype(float), [py, px], order=3 if cubic else 1, prefilter=False)
    p = gain * template + bias
    r = value - p
    w = inside * np.minimum(1, (cut / np.abs(r)) ** 4) * ((p >= margin) & (p <= 255 - margin))
    gx, gy = gain * tx.astype(float), gain * ty.astype(float)
    if fraction > 0:
        gx[:, 1:-1] = 0.5 * gx[:, 1:-1] + 0.25 * unit * (value[:, 2:] - value[:, :-2])
        gy[1:-1] = 0.5 * gy[1:-1] + 0.25 * unit * (value[2:] - value[:-2])
        w[[0, -1]] = 0
    points = np.stack([np.broadcast_to(x, (rows, columns)), np.broadcast_to(y[:, None], (rows, columns))], -1)
    fields = velocity_fields(points.reshape(-1, 2).astype(float))
    j = np.column_stack([np.stack([gx.ravel(), gy.ravel()], 1)[:, None] @ fields]).reshape(-1, 8)
    j = np.column_stack([j, -template.ravel(), -np.ones(template.size)])
    expected = (j.T * w.ravel()) @ j
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # Float32 sums over rows: 1e-5 of the scale of each entry.
    np.testing.assert_allclose(matrix / scale, expected / scale, atol=3e-5)
    right = (j.T * w.ravel()) @ r.ravel()
    root = np.sqrt(np.diag(expected) * (w.ravel() @ r.ravel() ** 2))
    np.testing.assert_allclose(vector / root, right / root, atol=3e-5)
    assert stats[0] == pytest.approx(w.sum(), rel=1e-4)
    assert stats[6] == pytest.approx(energy * stats[0])
    assert stats[7] == inside[1:-1].sum() if fraction > 0 else inside.sum()


def test_energy_is_the_variance_of_a_sample() -> None:
    """Interpolated white noise: declared variance against 36100 samples (2 sigma of that is 1.4 %)."""
    from scipy.ndimage import spline_filter

    rng = np.random.default_rng(3)
    noise = rng.normal(0, 1, (201, 201))
    coefficients = spline_filter(noise, order=3, mode="mirror").astype(np.float32)
    offset, rows = np.zeros((2, 1, 1), np.float32), np.arange(190)
    for fx, fy in ((0.0, 0.0), (0.5, 0.5), (0.25, 0.8)):
        h = np.array([[1.0, 0.0, 5 + fx], [0.0, 1.0, 5 + fy], [0.0, 0.0, 1.0]])
        value, inside = np.zeros((2, 190, 190), np.float32)
        for cubic, image in ((True, coefficients), (False, noise.astype(np.float32))):
            energy = sample_kernels.sample_rows(image, h, offset, rows, cubic, value, inside)
            assert energy == pytest.approx(float((value**2).mean()), rel=0.03)


def test_noise_free_error_is_a_thousandth_of_a_pixel(astronaut, views: ModuleType) -> None:
    template = EsmTemplate.from_image(astronaut.template)
    rng = np.random.default_rng(4)
    for _ in range(3):
        true, start = moved_corners(astronaut, rng, 4.0)
        frame = astronaut.frame(true, SIZE, 0.0, rng)
        # Passes are repeated until they no longer move: what remains is the interpolation.
        found = align(template, frame, start, EsmSettings(tolerance_px=0.002))
        assert found.valid
        assert found.ncc > 0.999
        error = views.corner_error(found.homography, true, astronaut.corners)
        # Rounding of template and frame (0.29 grey levels each) alone gives 0.0015 px; twice that.
        assert np.sqrt((error**2).sum(1).mean()) < 0.003
        usual = align(template, frame, start)
        error = views.corner_error(usual.homography, true, astronaut.corners)
        assert np.sqrt((error**2).sum(1).mean()) < 0.006  # a tenth of the default tolerance


@pytest.mark.parametrize("name", ["astronaut", "gravel"])
def test_noise_on_the_bound_and_declared_covariance(name: str, views: ModuleType) -> None:
    """Corner error within 1.1 x the Cramer-Rao bound, declared covariance within 25 %, scale unbiased."""
    view = views.PlaneView.named(name, 200)
    template = EsmTemplate.from_image(view.template)
    rng = np.random.default_rng(5)
    noise, errors, declared, scales = 5.0, [], [], []
    centred = view.corners - view.corners.mean(0)
    bounds = []
    for _ in range(5):
        true, _ = moved_corners(view, rng, 3.0)
        clean = view.continuous(true, SIZE)
        bounds.append(np.trace(view.bound(true, noise)) / 4)
        for _ in range(16):
            frame = np.clip(np.round(clean + rng.normal(0, noise, SIZE)), 0, 255).astype(np.uint8)
            start = true @ np.array([[1.005, 0.004, 2], [-0.003, 0.996, -1.5], [0, 0, 1]])
            found = align(template, frame, start)
            error = views.corner_error(found.homography, true, view.corners)
            errors.append(error.ravel())
            declared.append(found.corner_covariance)
            scales.append((error * centred).sum() / (centred**2).sum())
            assert found.noise == pytest.approx(noise, rel=0.1)
    errors, covariance = np.array(errors), np.mean(declared, axis=0)
    rms = np.sqrt((errors**2).sum(1).mean() / 4)
    # 80 trials x 8 numbers (about 5 independent): the ratio scatters by 4 %; floor 1.1 plus two of these.
    assert rms / np.sqrt(np.mean(bounds)) < 1.1 * 1.08
    # Mahalanobis distance: mean 8 when the covariance is right; its square root is the ratio of sigmas.
    distance = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(covariance), errors).mean()
    assert 0.8 < np.sqrt(distance / 8) < 1.25
    # 20 ppm floor plus three standard errors of the mean of 80 trials.
    assert abs(np.mean(scales)) < 20e-6 + 3 * np.std(scales) / np.sqrt(len(scales))


@pytest.mark.parametrize(("name", "distance"), [("astronaut", 40.0), ("gravel", 32.0)])
def test_reach(name: str, distance: float, views: ModuleType) -> None:
    """Corners 40 / 32 px off in random directions: at least 9 of 10 converge."""
    view = views.PlaneView.named(name, 200)
    template = EsmTemplate.from_image(view.template)
    rng = np.random.default_rng(6)
    true, _ = moved_corners(view, rng, 0.0, at=100.0)
    frame = view.frame(true, (400, 400), 2.0, rng)
    good = 0
    for _ in range(20):
        angle = rng.uniform(0, 2 * np.pi, 4)
        target = views.corner_error(true, np.diag([0, 0, 1.0]), view.corners)
        start = views.corner_homography(
            view.corners, target + distance * np.column_stack([np.cos(angle), np.sin(angle)])
        )
        found = align(template, frame, start)
        error = views.corner_error(found.homography, true, view.corners)
        good += bool(found.valid and np.linalg.norm(error, axis=1).mean() < 1.0)
    assert good >= 18


@pytest.mark.parametrize("scale", [0.4, 0.75, 1.4, 2.2])
def test_other_sizes_in_the_image(scale: float, views: ModuleType) -> None:
    """Near and far: error below 0.1 px, covariance within 40 % (its scale law is approximate)."""
    view = views.PlaneView.named("astronaut", 200)
    template = EsmTemplate.from_image(view.template)
    rng = np.random.default_rng(7)
    errors, declared = [], []
    side = int(200 * scale + 120)
    for _ in range(4):
        corners = view.corners * scale + 60 + rng.uniform(-3, 3, (4, 2))
        true = views.corner_homography(view.corners, corners)
        # Far away, one image pixel is the mean over the part of the template that it sees.
        fine = 4 if scale < 1 else 1
        grid = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1.0]])
        clean = view.continuous(grid @ true, (side * fine, side * fine))
        clean = clean.reshape(side, fine, side, fine).mean((1, 3))
        for _ in range(8):
            frame = np.clip(np.round(clean + rng.normal(0, 3, clean.shape)), 0, 255).astype(np.uint8)
            start = views.corner_homography(view.corners, corners + rng.uniform(-2, 2, (4, 2)))
            found = align(template, frame, start)
            assert found.valid
            errors.append(views.corner_error(found.homography, true, view.corners).ravel())
            declared.append(np.trace(found.corner_covariance))
    errors = np.array(errors)
    assert np.sqrt((errors**2).sum(1).mean() / 4) < 0.1
    assert np.sqrt(np.mean(declared) / (errors**2).sum(1).mean()) == pytest.approx(1.0, abs=0.4)


def test_light_occlusion_and_inversion(astronaut, views: ModuleType) -> None:
    template = EsmTemplate.from_image(astronaut.template)
    rng = np.random.default_rng(8)
    true, start = moved_corners(astronaut, rng, 6.0)
    clean = astronaut.continuous(true, SIZE)
    dim = np.clip(np.round(0.5 * clean + 60 + rng.normal(0, 2, SIZE)), 0, 255).astype(np.uint8)
    found = align(template, dim, start)
    assert found.valid
    assert found.gain == pytest.approx(0.5, abs=0.01)
    assert found.bias == pytest.approx(60, abs=1.0)
    covered = dim.copy()
    covered[150:, 160:] = rng.integers(0, 255, covered[150:, 160:].shape)  # a quarter of the template
    found = align(template, covered, start)
    assert found.valid
    assert found.weight < 0.9
    error = views.corner_error(found.homography, true, astronaut.corners)
    assert np.linalg.norm(error, axis=1).max() < 0.2
    assert not align(template, 255 - dim, start).valid


def test_loss_is_said_with_its_reason(astronaut) -> None:
    template = EsmTemplate.from_image(astronaut.template)
    rng = np.random.default_rng(9)
    noise = rng.integers(0, 255, SIZE, dtype=np.uint8)
    start = np.array([[1, 0, 50], [0, 1, 50], [0, 0, 1.0]])
    lost = align(template, noise, start)
    assert not lost.valid
    assert lost.reason
    assert np.isnan(lost.corner_covariance).all()
    far = align(template, noise, np.array([[1, 0, 5050], [0, 1, 50], [0, 0, 1.0]]))
    assert far.reason == "outside the image"
    assert "not a homography" in align(template, noise, np.full((3, 3), np.nan)).reason
    assert "mirrors the template" in align(template, noise, np.diag([-1.0, 1, 1])).reason
    bent = np.full((2, *astronaut.template.shape), np.nan, np.float32)
    assert "not a number" in align(template, noise, start, offset=bent).reason
    flat = align(template, np.full(SIZE, 128, np.uint8), start)
    assert not flat.valid
    with pytest.raises(InputError, match="no contrast"):
        EsmTemplate.from_image(np.full((50, 50), 7, np.uint8))
    with pytest.raises(InputError, match=r"\(5, 5\).*16 px"):
        EsmTemplate.from_image(np.zeros((5, 5), np.uint8))
    with pytest.raises(InputError, match=r"image: found shape \(5, 5, 3\)"):
        align(template, np.zeros((5, 5, 3), np.uint8), start)


def test_a_known_offset_is_undone(astronaut, views: ModuleType) -> None:
    """What a lens adds to the homography: with the offset given, the homography is the true one."""
    rng = np.random.default_rng(10)
    template = EsmTemplate.from_image(astronaut.template)
    true, start = moved_corners(astronaut, rng, 3.0)
    y, x = np.mgrid[:200, :200] - 99.5
    offset = np.stack([1e-4 * x * y, 8e-5 * (x**2 - y**2)])  # up to 1 px at the corners
    # Frame pixel p shows the template point u with  H u + offset(u) = p: fixed-point iteration.
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    p = np.stack([u, v], -1)
    inverse = np.linalg.inv(true)
    q = p.copy()
    for _ in range(20):
        t = np.concatenate([q, np.ones((*q.shape[:2], 1))], -1) @ inverse.T
        t = t[..., :2] / t[..., 2:] - 99.5
        q = p - np.stack([1e-4 * t[..., 0] * t[..., 1], 8e-5 * (t[..., 0] ** 2 - t[..., 1] ** 2)], -1)
    frame = astronaut._sample(t[..., 0] + 99.5, t[..., 1] + 99.5)
    frame = np.clip(np.round(frame), 0, 255).astype(np.uint8)
    found = align(template, frame, start, offset=offset.astype(np.float32))
    error = views.corner_error(found.homography, true, astronaut.corners)
    assert np.linalg.norm(error, axis=1).max() < 0.01
    without = align(template, frame, start, EsmSettings())
    error = views.corner_error(without.homography, true, astronaut.corners)
    assert np.linalg.norm(error, axis=1).max() > 0.1
