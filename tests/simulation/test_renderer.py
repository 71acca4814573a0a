"""Rendered edges compared with independent references: areas along columns, brute force, NumPy twins."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.simulation.foam import SensorRig
from visuohaptic.simulation.rendering import (
    MATERIALS,
    CameraEffects,
    FoamScene,
    Look,
    Occluder,
    SceneObject,
    SceneRenderer,
    Solid,
    Surface,
    _canvas,
    crossings,
    texture_tile,
)
from visuohaptic.simulation.rendering._coverage import coverage, share_facets
from visuohaptic.simulation.rendering._render_kernels import add_plane

FLAT = Look()  # no texture, no shading: levels 170 foam, 60 body, 100 floor
FOAM, BODY, FLOOR = 170.0, 60.0, 100.0
DISTORTION = np.array([-0.12, 0.05, 0.001, -0.0005, 0.0])


def camera_and_pose(
    *, width: int = 640, height: int = 360, roll: float = 0.0, **more: object
) -> tuple[Camera, Pose]:
    """A camera 0.3 m from the strip, 70 degrees steep, f scaled with the image."""
    camera = Camera.simple(width, height, 1.125 * width, **more)
    pose = camera.pose_of_view((-0.1, 0.0, 0.28), (0.015, 0.0, 0.0)).inverse()
    return camera, Pose.from_rotation_vector([0, 0, roll], [0, 0, 0]) @ pose


def strip(shape: str = "straight", points: int = 401) -> tuple[np.ndarray, np.ndarray]:
    """Back and front contour, 25 cm long and 2 cm wide."""
    y = np.linspace(-0.125, 0.125, points)
    back = np.column_stack([np.zeros(points), y])
    front = back + np.array([0.02, 0.0])
    if shape == "bent":
        angle = y / 0.25
        outward = np.column_stack([np.cos(angle), np.sin(angle)])
        back = 0.25 * outward - [0.25, 0]
        front = 0.27 * outward - [0.25, 0]
    if shape == "dented":
        front[:, 0] -= 0.008 * np.exp(-((y / 0.03) ** 2))
    return back, front


def edge_rows(
    image: np.ndarray, expected: np.ndarray, before: float, after: float, reach: float = 6.0
) -> np.ndarray:
    """Position of a step down each column from its area: rows of the upper level fill up to the edge.

    Independent of blur, as the area below a blurred step does not change; pixels
    are squares, so the sum over whole pixels is the exact integral.
    """
    found = np.full(len(expected), np.nan)
    for i, row in enumerate(expected):
        first, last = round(row - reach), round(row + reach)
        column = image[first : last + 1, i].astype(np.float64)
        found[i] = first - 0.5 + ((column - after) / (before - after)).sum()
    return found


def truth_rows(curve: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Mean row of a curve over the width of each pixel column (25 lines per column)."""
    shifts = (np.arange(25) + 0.5) / 25 - 0.5
    u = (columns[:, None] + shifts).ravel()
    origin = np.column_stack([u, np.full(u.size, 180.0)])
    t = crossings(curve, origin, np.array([0.0, 1.0]))
    return 180.0 + t.reshape(-1, 25).mean(axis=1)


@pytest.mark.parametrize("shape", ["straight", "bent", "dented"])
@pytest.mark.parametrize("roll", [0.0, 0.13])
@pytest.mark.parametrize("distortion", [np.zeros(5), DISTORTION])
@pytest.mark.parametrize("blur", [0.0, 0.9])
def test_edges_are_where_truth_says(shape: str, roll: float, distortion: np.ndarray, blur: float) -> None:
    camera, pose = camera_and_pose(roll=roll, distortion=distortion)
    renderer = SceneRenderer(camera, pose, FLAT, CameraEffects(blur_px=blur))
    back, front = strip(shape)
    scene = FoamScene(0.0, back, front)
    image, truth = renderer.render_exact(scene), renderer.truth(scene)
    columns = np.arange(120, 520)
    for curve, before, after in ((truth.front_px, FLOOR, FOAM), (truth.back_px, FOAM, BODY)):
        expected = truth_rows(curve, columns)
        found = edge_rows(image[:, columns], expected, before, after)
        # Kernel in float32 on levels up to 170: 1e-4 px. Blur moves the mean of a curved edge by
        # sigma^2 times half its curvature, below 0.8 / 2 * 0.009 = 0.004 px for the dent.
        limit = 0.001 if blur == 0 or shape == "straight" else 0.005
        assert np.abs(found - expected).max() < limit


def test_profile_of_an_edge_is_the_step_through_pixel_and_lens() -> None:
    from scipy.special import erf

    camera, pose = camera_and_pose()
    sigma = 1.1
    renderer = SceneRenderer(camera, pose, FLAT, CameraEffects(blur_px=sigma))
    scene = FoamScene(0.0, *strip())
    image = renderer.render_exact(scene)
    row = truth_rows(renderer.truth(scene).front_px, np.array([300]))[0]

    def integral(x: np.ndarray) -> np.ndarray:  # of the normal distribution function
        z = x / sigma
        return sigma * (z * 0.5 * (1 + erf(z / np.sqrt(2))) + np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi))

    rows = np.arange(int(row) - 6, int(row) + 7)
    step = integral(rows + 0.5 - row) - integral(rows - 0.5 - row)
    # A Gaussian sampled at pixels instead of integrated: aliasing exp(-2 pi^2 sigma^2) = 4e-11,
    # cut at 4 sigma: 6e-5 of the contrast of 70.
    np.testing.assert_allclose(image[rows, 300], FLOOR + (FOAM - FLOOR) * step, atol=0.01)


def test_images_of_a_scene_at_rest_are_those_drawn_one_by_one() -> None:
    scene = FoamScene(0.0, *strip())
    for look in (Look.photo(), Look.photo(colour=True)):
        effects = CameraEffects(1.0, 3.0, light=lambda t: 1.0 - t, exposure_s=0.01)
        renderer = SceneRenderer(*camera_and_pose(width=320, height=180), look, effects)
        one, other = (np.random.default_rng(4) for _ in range(2))
        images = list(renderer.repeated(scene, 2, rng=one))
        assert np.array_equal(images, [renderer.render(scene, rng=other) for _ in images])
        assert not np.array_equal(*images)


def test_all_layers_have_the_memory_layout_that_is_compiled_in_advance(monkeypatch) -> None:
    """Another one would be compiled at the first frame, for seconds."""
    contiguous: list[bool] = []

    def record(*arguments: object) -> None:
        contiguous.extend(part.flags.c_contiguous for part in arguments if isinstance(part, np.ndarray))

    monkeypatch.setattr(_canvas, "add_plane", record)
    body = SceneObject(np.array([[0.018, -0.02], [0.1, -0.02], [0.1, 0.02], [0.018, 0.02]]))
    renderer = SceneRenderer(*camera_and_pose(width=320, height=180), Look.photo(stripe=True))
    renderer.render(FoamScene(0.0, *strip(), (body,)), rng=np.random.default_rng(0))
    assert contiguous
    assert all(contiguous)


def test_stripe_has_its_own_exact_edge() -> None:
    camera, pose = camera_and_pose()
    look = Look(stripe=Surface(90.0), stripe_width_m=0.005)
    renderer = SceneRenderer(camera, pose, look, CameraEffects(blur_px=0.8))
    scene = FoamScene(0.0, *strip("bent"))
    image, truth = renderer.render_exact(scene), renderer.truth(scene)
    columns = np.arange(150, 490)
    for curve, before, after in ((truth.front_px, FLOOR, 90.0), (truth.stripe_px, 90.0, FOAM)):
        expected = truth_rows(curve, columns)
        found = edge_rows(image[:, columns], expected, before, after, reach=4.0)
        assert np.abs(found - expected).max() < 0.005


def shaken(t_s: float) -> Pose:
    """A camera that shakes at 15 Hz by some pixels."""
    phase = 2 * np.pi * 15 * t_s
    return Pose.from_rotation_vector(
        [0.004 * np.sin(phase), 0.003 * np.cos(phase), 0.002 * np.sin(phase)], [0, 0, 0]
    )


def denting(t_s: float) -> FoamScene:
    """A strip that is pressed in at 0.1 m/s."""
    back, front = strip()
    front[:, 0] -= (0.002 + 0.1 * t_s) * np.exp(-((front[:, 1] / 0.05) ** 2))
    return FoamScene(t_s, back, front)


def test_rolling_shutter_equals_one_picture_per_row() -> None:
    camera, pose = camera_and_pose(row_delay_s=8e-5, distortion=DISTORTION)
    still, _ = camera_and_pose(distortion=DISTORTION)
    effects = CameraEffects(blur_px=0)
    renderer = SceneRenderer(camera, pose, FLAT, effects)
    image = renderer.render_exact(denting, t_s=0.01, camera_shake=shaken)
    static = SceneRenderer(still, pose, FLAT, effects)
    truth = renderer.truth(denting, t_s=0.01, camera_shake=shaken)
    rows = np.unique(
        np.linspace(np.nanmin(truth.front_px[:, 1]) + 2, np.nanmax(truth.back_px[:, 1]), 12).astype(int)
    )
    for row in rows:
        t_s = 0.01 + row * camera.row_delay_s
        alone = static.render_exact(denting(t_s), t_s=t_s, camera_shake=shaken)[row]
        # A row sees its state at its centre's time, while an edge inside of it moves on by
        # (500 px/s)(8e-5 s) = 4 % of its way, plus 0.005 px of interpolation: levels of 110 x 0.03 px.
        assert np.abs(image[row] - alone).max() < 3.5


def test_rolling_shutter_edges_are_where_truth_says() -> None:
    camera, pose = camera_and_pose(row_delay_s=8e-5, distortion=DISTORTION)
    renderer = SceneRenderer(camera, pose, FLAT, CameraEffects(blur_px=0))
    image = renderer.render_exact(denting, t_s=0.01, camera_shake=shaken)
    truth = renderer.truth(denting, t_s=0.01, camera_shake=shaken)
    columns = np.arange(120, 520)
    for curve, before, after in ((truth.front_px, FLOOR, FOAM), (truth.back_px, FOAM, BODY)):
        expected = truth_rows(curve, columns)
        found = edge_rows(image[:, columns], expected, before, after)
        assert np.abs(found - expected).max() < 0.002


def test_rolling_shutter_truth_solves_its_own_equation() -> None:
    camera, pose = camera_and_pose(row_delay_s=8e-5)
    truth = SceneRenderer(camera, pose).truth(denting, t_s=0.01, camera_shake=shaken)
    _, front = strip()
    # A point of the strip, projected with the state of the row where it is said to be seen. The
    # ends of the dense curve are material points.
    for end, index in ((0, 0), (-1, -1)):
        pixel = truth.front_px[end]
        t_s = 0.01 + pixel[1] * camera.row_delay_s
        point = np.append(denting(t_s).front_m[index], 0.0)
        seen = camera.project((shaken(t_s) @ pose).apply(point))
        # Cubics over nine keys: 0.02 (2 pi 15 x 0.029 / 8)^4 x 3 px = 0.001 px.
        np.testing.assert_allclose(seen, pixel, atol=0.003)
    assert len(front) == 401


def test_touching_object_leaves_no_gap_and_no_floor_at_the_contact() -> None:
    camera, pose = camera_and_pose()
    renderer = SceneRenderer(camera, pose, FLAT, CameraEffects(blur_px=0.8))
    back, front = strip()
    front[:, 0] -= 0.006 * (np.abs(front[:, 1]) <= 0.03)
    box = SceneObject(np.array([[0.014, -0.03], [0.1, -0.03], [0.1, 0.03], [0.014, 0.03]]), 0.3, 215.0)
    scene = FoamScene(0.0, back, front, (box,))
    image, truth = renderer.render_exact(scene), renderer.truth(scene)
    columns = np.arange(270, 371)  # inside of the contact, the object spans more
    expected = truth_rows(truth.front_px, columns)
    found = edge_rows(image[:, columns], expected, 215.0, FOAM)
    assert np.abs(found - expected).max() < 0.002
    near = image[int(expected.min()) - 6 : int(expected.max()) + 7, 270:371]
    assert near.min() > FOAM - 0.01  # a floor of 100 that shone through would be darker
    assert near.max() < 215.01


def test_object_in_front_of_the_flank_hides_the_foam() -> None:
    camera, pose = camera_and_pose()
    renderer = SceneRenderer(camera, pose, FLAT, CameraEffects(blur_px=0))
    back, front = strip(points=1001)
    # Pressed in almost to the back by a narrow tall box far on the left: its flank
    # leans outwards in the picture, over the foam beside it.
    inside = (front[:, 1] > 0.07) & (front[:, 1] < 0.09)
    front[inside, 0] = 0.002
    box = SceneObject(np.array([[0.002, 0.07], [0.1, 0.07], [0.1, 0.09], [0.002, 0.09]]), 0.2, 215.0)
    scene = FoamScene(0.0, back, front, (box,))
    truth = renderer.truth(scene)
    hidden = front[~truth.front_visible]
    assert len(hidden) > 3
    assert hidden[:, 1].min() > 0.089
    assert hidden[:, 1].max() < 0.11
    image = renderer.render_exact(scene)
    pixels = camera.project(pose.apply(np.column_stack([hidden, np.zeros(len(hidden))])))
    # Behind the object by at least a pixel: the object's own level and nothing else.
    clear = (hidden[:, 1] > 0.0905) & (hidden[:, 1] < hidden[:, 1].max() - 0.001)
    levels = [image[round(v), round(u)] for u, v in pixels[clear]]
    assert levels
    np.testing.assert_allclose(levels, 215.0, atol=0.01)


def test_round_objects_fill_their_outline() -> None:
    camera, pose = camera_and_pose(distortion=DISTORTION)
    renderer = SceneRenderer(camera, pose, FLAT, CameraEffects(blur_px=0.8))
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    outline = 0.03 * np.column_stack([np.cos(angle), np.sin(angle)]) + [0.06, 0.01]
    many = renderer.render_exact(FoamScene(0.0, *strip(), (SceneObject(outline, 0.05, 215.0),)))
    # The hull of the projected rims, by another route to the same silhouette.
    from scipy.spatial import ConvexHull

    rims = np.concatenate([np.column_stack([outline, np.full(90, z)]) for z in (-0.05, 0.05)])
    still, _ = camera_and_pose()
    ideal = still.project(pose.apply(rims))
    hull = rims[ConvexHull(ideal).vertices]
    steps = np.linspace(0, 1, 50, endpoint=False)[None, :, None]
    fine = hull[:, None] + steps * (np.roll(hull, -1, axis=0) - hull)[:, None]
    part = coverage(camera.project(pose.apply(fine.reshape(-1, 3))), 360, 640, 0.8)
    assert part is not None
    rows = slice(0, int(np.nanmin(renderer.truth(FoamScene(0.0, *strip())).front_px[:, 1])) - 8)
    expected = np.full((360, 640), FLOOR)
    expected[part.window] += (215.0 - FLOOR) * part.fraction
    # Pieces of straight lines between points 8 px apart: 0.001 px of a contrast of 115.
    assert np.abs(many - expected)[rows].max() < 0.2


def test_coverage_equals_area_of_clipped_polygons() -> None:
    from skimage.draw import polygon2mask

    rng = np.random.default_rng(4)
    for _ in range(5):
        angle = np.sort(rng.uniform(0, 2 * np.pi, 9))
        polygon = np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(4, 14, (9, 1)) + [12, 9]
        part = coverage(polygon, 20, 24)
        assert part is not None
        image = np.zeros((20, 24))
        image[part.window] = part.fraction
        fine = polygon2mask((20 * 40, 24 * 40), (polygon[:, ::-1] + 0.5) * 40 - 0.5)
        counted = fine.reshape(20, 40, 24, 40).mean(axis=(1, 3))
        # Counting 40 x 40 cells errs by about one cell for each of the 40 that an edge crosses.
        assert np.abs(image - counted).max() < 0.04
        inner = coverage(polygon[::-1], 60, 60)
        assert inner is not None


def test_coverage_sums_to_the_polygon_area() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        polygon = rng.uniform(3, 50, (3, 2))
        part = coverage(polygon, 60, 60)
        assert part is not None
        (x0, y0), (x1, y1), (x2, y2) = polygon
        area = 0.5 * abs((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0))
        np.testing.assert_allclose(part.fraction.sum(), area, atol=1e-3)
    assert coverage(np.array([[-9.0, -9], [-5, -9], [-5, -5]]), 10, 10) is None


def test_facets_end_at_their_outline() -> None:
    """Facets that reach beyond the outline of their solid, as while it moves during a readout, share it with the rest."""
    square = np.array([[10.0, 10], [30, 10], [30, 30], [10, 30]])
    whole = coverage(square, 60, 60, 0.8)
    facets = [coverage(square * (0.5, 1.2) + shift, 60, 60) for shift in ([0.0, -8.0], [10.0, 5.0])]
    assert whole is not None
    found = [one for one in facets if one is not None]
    left = share_facets(whole, found)
    total = np.zeros((60, 60))
    for part in (left, *found):
        for r, (low, high) in enumerate(part.spans):
            total[part.y0 + r, part.x0 + low : part.x0 + high] += part.fraction[r, low:high]
    expected = np.zeros((60, 60))
    expected[whole.window] = whole.fraction
    np.testing.assert_allclose(total, expected, atol=1e-6)


@pytest.mark.parametrize("warped", [False, True])
def test_plane_kernel_equals_numpy(warped: bool) -> None:
    camera = Camera.simple(40, 30, 60.0, distortion=np.array([-0.2, 0.1, 0, 0, 0]))
    u, v = np.meshgrid(np.arange(40.0), np.arange(30.0))
    rays = camera.rays(np.stack([u, v], axis=-1))[..., :2].copy()
    matrix = np.array([[0.3, 0.02, 0.01], [0.01, 0.25, -0.02], [0.1, 0.2, 1.0]])
    tile = texture_tile("concrete", 1, 64)
    image = np.zeros((30, 40, 1), np.float32)
    weight = np.random.default_rng(0).uniform(0.1, 1, (12, 20)).astype(np.float32)
    clear = np.random.default_rng(1).uniform(0.0, 1, (30, 40)).astype(np.float32)
    # A texel and its neighbours to the right, below and below to the right share a word.
    packed = sum(
        np.roll(tile, (-dy, -dx), (0, 1)).astype(np.uint32) << np.uint32(8 * (dx + 2 * dy))
        for dx in (0, 1)
        for dy in (0, 1)
    )
    level = np.array([99.0], np.float32)
    # A shift that is linear in both coordinates is exact in the table.
    place = np.stack(
        np.meshgrid(-0.5 + 0.05 * np.arange(21), -0.6 + 0.05 * np.arange(25), indexing="ij"), axis=2
    )
    turn = np.array([[0.05, -0.1], [0.02, 0.15]])
    warp = (place @ turn.T).astype(np.float32) if warped else np.zeros((0, 0, 2), np.float32)
    grid = np.array([-0.5, -0.6, 0.05])
    x, y = np.moveaxis(rays, 2, 0).astype(np.float32)
    add_plane(
        image,
        clear,
        weight,
        np.tile(np.array([0, 20], np.int32), (12, 1)),
        7,
        5,
        x,
        y,
        matrix[None],
        packed,
        300.0,
        9.0,
        level,
        warp,
        grid,
    )
    a, b, w = np.moveaxis(np.concatenate([rays, np.ones((30, 40, 1))], axis=-1) @ matrix.T, -1, 0)
    a, b = a / w, b / w
    assert max(abs(a).max() - 0.5, abs(b).max() - 0.6) < 0.0
    if warped:
        a, b = np.moveaxis(np.stack([a, b], axis=-1) @ (np.eye(2) + turn).T, -1, 0)
    s, t = a * 300.0, b * 300.0
    i, j = np.floor(s).astype(int), np.floor(t).astype(int)
    f, g = s - i, t - j
    data = tile.astype(float)
    texture = sum(
        wx * wy * data[(j + dy) % 64, (i + dx) % 64]
        for dx, wx in ((0, 1 - f), (1, f))
        for dy, wy in ((0, 1 - g), (1, g))
    )
    value = 99.0 + 9.0 * (texture - 128) / 42
    expected = np.zeros((30, 40))
    expected[5:17, 7:27] = (clear * value)[5:17, 7:27] * weight
    np.testing.assert_allclose(image[..., 0], expected, atol=0.02)  # float32 texture coordinates


@pytest.mark.parametrize("shape", ["straight", "bent"])
def test_the_foams_texture_moves_with_the_foam(shape: str) -> None:
    """A place of the foam has the same grey level before and after it is compressed, and another one if it did not move."""
    camera, pose = camera_and_pose(width=1600, height=896)
    look = Look(foam=Surface(170.0, 15.0, "foam"))
    renderer = SceneRenderer(camera, pose, look, CameraEffects(blur_px=1.0))
    back, front = strip(shape)
    y = np.linspace(-0.125, 0.125, len(back))
    pressed = back + (front - back) * (1.0 - 0.3 * np.exp(-((y / 0.03) ** 2)))[:, None]
    part = np.linspace(0.2, 0.85, 30)[:, None, None]

    def levels(image: np.ndarray, front: np.ndarray) -> np.ndarray:
        from scipy.ndimage import map_coordinates

        points = (back + part * (front - back))[:, 180:221].reshape(-1, 2)
        u, v = camera.project(pose.apply(np.column_stack([points, np.zeros(len(points))]))).T
        return map_coordinates(image.reshape(image.shape[:2]).astype(float), [v, u], order=1)

    before, after = (renderer.render_exact(FoamScene(0.0, back, f)).copy() for f in (front, pressed))
    contrast = levels(before, front).std()
    assert contrast > 5.0
    # The lens blurs the compressed texture more: grains of 1 mm, whose places move by up to 30 px.
    assert np.std(levels(after, pressed) - levels(before, front)) < 0.3 * contrast
    assert np.std(levels(after, pressed) - levels(before, pressed)) > 0.8 * contrast


def test_floor_texture_sticks_to_the_world() -> None:
    camera, pose = camera_and_pose(width=1600, height=896)
    look = Look(floor=Surface(110.0, 15.0, "concrete"))
    renderer = SceneRenderer(camera, pose, look, CameraEffects(blur_px=0))
    scenes = [
        FoamScene(0.0, *strip(), T_world_foam=Pose.from_rotation_vector([0, 0, a], [x, 2.0, 0.05]))
        for a, x in ((0.3, 5.0), (0.35, 5.02))
    ]
    first, second = (renderer.render_exact(s) for s in scenes)
    # The same points of the floor, seen from both places, away from strip and plate.
    points = np.column_stack(
        [*np.random.default_rng(0).uniform([0.08, -0.05], [0.11, 0.05], (60, 2)).T, np.full(60, -0.05)]
    )
    other = scenes[1].T_world_foam.inverse().apply(scenes[0].T_world_foam.apply(points))
    from scipy.ndimage import map_coordinates

    levels = [
        map_coordinates(image, camera.project(pose.apply(p)).T[::-1], order=1)
        for image, p in ((first, points), (second, other))
    ]
    assert np.std(levels[0]) > 5
    # Bilinear reading between pixels smooths the finest grain differently.
    assert np.corrcoef(levels)[0, 1] > 0.98


def test_occluders_come_and_go_with_rows_and_time() -> None:
    camera, pose = camera_and_pose(row_delay_s=1e-4)
    renderer = SceneRenderer(camera, pose, FLAT, CameraEffects(blur_px=0))
    scene = FoamScene(0.0, *strip())
    square = np.array([[99.5, 49.5], [199.5, 49.5], [199.5, 149.5], [99.5, 149.5]])
    hand = Occluder(square, surface=Surface(30.0), start_s=0.0, end_s=0.01, velocity=(0.0, 0.0))
    clean = renderer.render_exact(scene)
    image = renderer.render_exact(scene, occluders=[hand])
    # The row at 10 ms is number 100; later rows do not see it any more.
    np.testing.assert_allclose(image[50:101, 100:200], 30.0, atol=1e-3)
    np.testing.assert_array_equal(image[101:], clean[101:])
    later = renderer.render_exact(scene, t_s=1.0, occluders=[hand])
    np.testing.assert_array_equal(later, clean)
    high = Occluder(np.array([[0, -0.02], [0.02, -0.02], [0.02, 0.02], [0, 0.02]]), 0.1, Surface(30.0))
    image = renderer.render_exact(scene, occluders=[high])
    u, v = camera.project(pose.apply(np.array([0.01, 0.0, 0.1])))
    assert abs(image[round(v), round(u)] - 30.0) < 1e-3


def test_colour_pictures_and_repeatable_noise() -> None:
    camera, pose = camera_and_pose(width=320, height=180)
    renderer = SceneRenderer(camera, pose, Look.photo(colour=True, stripe=True), CameraEffects(noise_sigma=3))
    scene = FoamScene(0.0, *strip())
    image = renderer.render(scene, rng=np.random.default_rng(1))
    assert image.shape == (180, 320, 3)
    np.testing.assert_array_equal(image, renderer.render(scene, rng=np.random.default_rng(1)))
    assert (image != renderer.render(scene, rng=np.random.default_rng(2))).mean() > 0.5
    blue, green, red = image[150, 160].astype(int)
    assert max(blue, green, red) < 90  # the dark body


def test_motion_blur_widens_edges_and_keeps_their_place() -> None:
    camera, pose = camera_and_pose()

    def moving(t_s: float) -> FoamScene:
        back, front = strip()
        front[:, 0] += 0.2 * t_s
        return FoamScene(t_s, back, front)

    sharp, blurred = (
        SceneRenderer(camera, pose, FLAT, CameraEffects(blur_px=0.5, exposure_s=e)) for e in (0.0, 0.01)
    )
    columns = np.array([300])
    row = truth_rows(sharp.truth(moving(0.02)).front_px, columns)
    images = [r.render_exact(moving, t_s=0.02)[:, columns] for r in (sharp, blurred)]
    for image in images:
        # Perspective makes the mean of the positions differ by a little from the middle one.
        assert abs(edge_rows(image, row, FLOOR, FOAM, 12.0) - row)[0] < 0.02
    rows = slice(int(row[0]) - 10, int(row[0]) + 11)
    steepness = [np.abs(np.diff(image[rows, 0])).max() for image in images]
    assert steepness[1] < 0.6 * steepness[0]


def test_bad_scenes_are_refused() -> None:
    camera, pose = camera_and_pose(width=64, height=36)
    renderer = SceneRenderer(camera, pose)
    with pytest.raises(InputError, match="needs t_s"):
        renderer.render(denting, rng=np.random.default_rng(0))
    back, front = strip()
    with pytest.raises(InputError, match="same number of points"):
        renderer.truth(FoamScene(0.0, back, front[:-1]))
    with pytest.raises(InputError, match="front_m: found points that are not finite"):
        renderer.truth(FoamScene(0.0, back, front * np.nan))
    dart = SceneObject(np.array([[0.03, 0], [0.1, 0.05], [0.06, 0.0], [0.1, -0.05]]))
    with pytest.raises(InputError, match=r"objects\[0\].*not convex; split"):
        renderer.truth(FoamScene(0.0, back, front, (dart,)))
    with pytest.raises(InputError, match="expected one of plain"):
        Surface(100.0, material="cheese")
    with pytest.raises(InputError, match="finite start_s"):
        Occluder(np.zeros((3, 2)), velocity=(1.0, 0.0)).outline_at(0.0)


@pytest.mark.parametrize("material", sorted(MATERIALS))
def test_tiles_repeat_without_seams(material: str) -> None:
    tile = texture_tile(material, 3, 256).astype(float)
    assert abs(tile.mean() - 128) < 3  # clipping of the tails moves the mean
    assert 30 < tile.std() < 46
    inner = np.abs(np.diff(tile, axis=0)).mean(axis=1)
    seam = np.abs(tile[0] - tile[-1]).mean()
    if material != "planks":  # the seam of planks is a joint between two boards
        assert seam < inner.mean() + 6 * inner.std() + 1
    assert texture_tile(material, 3, 256) is texture_tile(material, 3, 256)


def test_a_solid_that_stands_looks_like_its_upright_prism_and_one_that_leans_moves_with_its_pose():
    rig = SensorRig(width_px=400, height_px=224, focal_px=350.0, distance_m=0.35, angle_rad=np.radians(55))
    renderer = SceneRenderer(rig.camera, rig.T_camera_foam, Look.photo())
    y = np.linspace(-0.1, 0.1, 21)
    back = np.column_stack([np.zeros(21), y])
    own = np.array([[-0.03, -0.05], [0.03, -0.05], [0.03, 0.05], [-0.03, 0.05]])
    at = np.array([0.08, 0.01, -0.05])

    def picture(solid):
        thing = SceneObject(own + at[:2], 0.15, texture=30.0, solid=solid)
        scene = FoamScene(0.0, back, back + np.array([0.02, 0]), (thing,))
        return renderer.render_exact(scene)

    upright = picture(None)
    np.testing.assert_allclose(picture(Solid(own, 0.2, Pose(np.eye(3), at))), upright, atol=0.05)
    leans = picture(Solid(own, 0.2, Pose.from_rotation_vector([0.0, 0.3, 0.0], at)))
    assert np.abs(leans - upright).max() > 20
    # Fallen away by a right angle it shows its bottom to the camera.
    fallen = picture(Solid(own, 0.2, Pose.from_rotation_vector([0.0, 1.5, 0.0], at)))
    floor = renderer.render_exact(FoamScene(0.0, back, back + np.array([0.02, 0])))
    u, v = rig.camera.project(rig.T_camera_foam.apply(at + np.array([0.0, 0.0, 0.02]))).round().astype(int)
    assert abs(float(fallen[v, u]) - float(floor[v, u])) > 5
