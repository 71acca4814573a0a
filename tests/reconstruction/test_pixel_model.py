"""A user's own network as further evidence for glass: what it returns, what is learned of it, how much it may say."""

import math

import cv2
import numpy as np
import pytest

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.core.errors import InputError
from visuohaptic.io.depth import DepthFrame, MaskFolder, OnnxModel, load_pixel_model, scores_of
from visuohaptic.reconstruction.fusion import SpaceGrid
from visuohaptic.reconstruction.transparency.ray_evidence import RayEvidence, ScoreEvidence

CAMERA = Camera.simple(64, 48, 60.0)


# --- networks -------------------------------------------------------------------------------------


def _varint(number: int) -> bytes:
    low, rest = number & 127, number >> 7
    return bytes([low | 128]) + _varint(rest) if rest else bytes([low])


def _field(number: int, content: bytes | int) -> bytes:
    """A field of a protocol buffer: bytes with their length, or an integer."""
    if isinstance(content, int):
        return _varint(number << 3) + _varint(content)
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def _network(weights: np.ndarray, shape: tuple[int, int]) -> bytes:
    """ONNX file of one convolution by weights (outputs, 3, 1, 1) on an image of rows and columns."""

    def value(name: bytes, *dims: int) -> bytes:
        sizes = b"".join(_field(1, _field(1, dim)) for dim in dims)
        return _field(1, name) + _field(2, _field(1, _field(1, 1) + _field(2, sizes)))

    tensor = b"".join(_field(1, dim) for dim in weights.shape)
    tensor += _field(2, 1) + _field(8, b"w") + _field(9, weights.astype("<f4").tobytes())
    node = _field(1, b"x") + _field(1, b"w") + _field(2, b"y") + _field(4, b"Conv")
    graph = _field(1, node) + _field(2, b"g") + _field(5, tensor)
    graph += _field(11, value(b"x", 1, 3, *shape)) + _field(12, value(b"y", 1, len(weights), *shape))
    return _field(1, 8) + _field(7, graph) + _field(8, _field(1, b"") + _field(2, 13))


def _frame(depth_m: np.ndarray, color: np.ndarray | None = None, index: int = 0) -> DepthFrame:
    pose = Pose(np.eye(3), np.zeros(3))
    return DepthFrame(0.0, depth_m.astype(np.float32), color, pose, CAMERA, index)


@pytest.fixture
def picture() -> np.ndarray:
    """Blue, green, red; red grows to the right, blue downwards."""
    red, blue = np.meshgrid(np.arange(64), np.arange(48))
    return np.stack([blue, np.full(red.shape, 100), 2 * red], axis=-1).astype(np.uint8)


def test_a_network_sees_red_green_blue_as_it_was_trained(tmp_path, picture):
    path = tmp_path / "net.onnx"
    path.write_bytes(_network(np.array([[0, 0, 1.0], [1.0, 0, 0]]).reshape(2, 3, 1, 1), (48, 64)))
    model = load_pixel_model(path)
    scores = model(_frame(np.ones((48, 64)), picture))
    expected = (
        picture[:, :, 2] / 255.0 - 0.485
    ) / 0.229  # the last of two channels is red, the first of the input
    np.testing.assert_allclose(scores, expected, atol=1e-5)


def test_the_network_has_an_input_of_its_own_size(tmp_path, picture):
    path = tmp_path / "net.onnx"
    path.write_bytes(_network(np.array([[1.0, 0, 0]]).reshape(1, 3, 1, 1), (24, 32)))
    scores = OnnxModel(path, size=(32, 24))(_frame(np.ones((48, 64)), picture))
    expected = (picture[:, :, 2] / 255.0 - 0.485) / 0.229
    assert scores.shape == (48, 64)
    assert abs(scores - expected)[2:-2, 2:-2].max() < 0.02


@pytest.mark.parametrize("output", ["depth", "disparity"])
def test_a_depth_that_sees_the_glass_is_nearer_than_the_measured_one(tmp_path, output):
    seen_m = np.full((48, 64), 0.8) + 0.004 * np.arange(64)
    measured_m = seen_m.copy()
    seen_m[10:30, 20:40] -= 0.3  # glass, through which the camera measures the wall
    measured_m[12, 22] = np.nan
    told = 255 * (0.5 * seen_m if output == "depth" else 0.1 + 0.5 / seen_m)  # any unit, any scale and offset
    color = np.zeros((48, 64, 3), np.uint8)
    color[:, :, 2] = np.rint(told)
    path = tmp_path / "net.onnx"
    path.write_bytes(_network(np.array([[1.0, 0, 0]]).reshape(1, 3, 1, 1), (48, 64)))
    model = OnnxModel(path, output, mean=(0, 0, 0), sigma=(1, 1, 1))
    scores = model(_frame(measured_m, color))
    truth = np.log(measured_m / seen_m)
    assert np.isnan(scores[12, 22])
    # One grey level of the color image is 1 % of such a depth.
    np.testing.assert_allclose(scores, truth, atol=0.03)


def test_what_cannot_be_a_network_or_its_input_is_refused(tmp_path, picture):
    path = tmp_path / "net.onnx"
    path.write_bytes(b"not a network")
    with pytest.raises(InputError, match="expected a network in ONNX format"):
        OnnxModel(path)
    path.write_bytes(_network(np.ones((1, 3, 1, 1)), (24, 32)))
    with pytest.raises(InputError, match="no color image of view 3"):
        OnnxModel(path)(_frame(np.ones((48, 64)), index=3))
    with pytest.raises(InputError, match="output"):
        OnnxModel(path, "depths")
    with pytest.raises(InputError, match="found no images"):
        MaskFolder(tmp_path / "masks")


def test_masks_are_in_natural_order_and_of_any_size(tmp_path):
    for number in (2, 10, 1):
        cv2.imwrite(str(tmp_path / f"mask{number}.png"), np.full((24, 32), 10 * number, np.uint8))
    model = load_pixel_model(tmp_path)
    values = [float(model(_frame(np.ones((48, 64)), index=k))[5, 5]) for k in range(3)]
    assert values == pytest.approx([10, 20, 100])
    with pytest.raises(InputError, match="found 3 masks"):
        model(_frame(np.ones((48, 64)), index=3))
    with pytest.raises(InputError, match="found 3 masks, expected 2"):
        load_pixel_model(tmp_path, views=2)


@pytest.mark.parametrize("scores", [np.zeros((24, 32)), np.zeros((48, 64), complex), 0.5])
def test_a_model_returns_one_number_for_each_pixel(scores):
    with pytest.raises(InputError, match=r"model: found .* for view 0, expected numbers \(48, 64\)"):
        scores_of(lambda frame: scores, _frame(np.ones((48, 64))))


# --- what is learned of the scores ----------------------------------------------------------------

#: Voxels of 2 cm; the smallest object is 4 cm.
GRID, VOXEL_M, OBJECT_M, RADIUS_M = (
    SpaceGrid.around((-0.3, -0.3, -0.3), (0.3, 0.3, 0.3), 0.02),
    0.02,
    0.04,
    0.05,
)


def _views(count: int = 8) -> list[DepthFrame]:
    frames = []
    for turn in np.linspace(0, 2 * np.pi, count, endpoint=False):
        forward = -np.array([np.cos(turn), np.sin(turn), 0.4])
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.column_stack([right, np.cross(forward, right), forward])
        frames.append(
            DepthFrame(0.0, np.full((48, 64), 2, np.float32), None, Pose(rotation, -forward), CAMERA)
        )
    return frames


def _balls(centres_m: np.ndarray, frames: list[DepthFrame]) -> np.ndarray:
    """Silhouettes (n, rows, columns) of balls."""
    images = np.zeros((len(frames), 48, 64), np.float32)
    for image, frame in zip(images, frames, strict=True):
        local = frame.T_world_camera.inverse().apply(centres_m)
        for x, y, z in local:
            u, v = 60 * x / z + CAMERA.matrix[0, 2], 60 * y / z + CAMERA.matrix[1, 2]
            cv2.circle(image, (round(u), round(v)), round(60 * RADIUS_M / z), 1.0, -1)
    return images


def _learned(scores: np.ndarray, frames: list[DepthFrame], excess: np.ndarray) -> np.ndarray:
    limit_m = np.full((len(frames), 48, 64), 2, np.float32)
    nothing, ones = np.zeros_like(limit_m), np.ones(len(frames), np.float32)
    rays = RayEvidence(frames, ones, limit_m, nothing, nothing)
    found = ScoreEvidence.learned(list(scores), [3] * len(frames), rays, limit_m > 0, excess, GRID, OBJECT_M)
    return found.sums(GRID)


def _inside(centres_m: np.ndarray) -> np.ndarray:
    cells = np.argwhere(np.ones(GRID.shape, bool))
    away_m = np.linalg.norm(GRID.centres_m(cells)[:, None] - centres_m, axis=2).min(axis=1)
    return (away_m < RADIUS_M).reshape(GRID.shape)


def _possible(glass: np.ndarray) -> np.ndarray:
    """Evidence by the readings: even at the glass, none elsewhere."""
    return np.where(glass, 0.0, -10.0).astype(np.float32)


def test_a_network_that_sees_the_glass_tells_where_it_is():
    frames, centre_m = _views(), np.array([[0.1, 0.0, 0.05]])
    glass = _inside(centre_m)
    rng = np.random.default_rng(0)
    scores = _balls(centre_m, frames) + 0.2 * rng.standard_normal((8, 48, 64)).astype(np.float32)
    evidence = _learned(scores, frames, _possible(glass))
    assert evidence[glass].max() > 2
    assert np.median(evidence[~glass]) < 0
    assert (
        np.mean(evidence[~glass] > 0.5 * evidence[glass].max()) < 0.06
    )  # in the shadows of the glass in some views
    # The opposite says the same: how a score relates to glass is learned.
    opposite = _learned(-scores, frames, _possible(glass))
    assert opposite[glass].max() > 1


@pytest.mark.parametrize("seed", range(3))
def test_scores_of_noise_say_nothing(seed):
    frames, centre_m = _views(), np.array([[0.1, 0.0, 0.05]])
    noise = np.random.default_rng(seed).standard_normal((8, 48, 64)).astype(np.float32)
    evidence = _learned(noise, frames, _possible(_inside(centre_m)))
    assert (
        evidence.min() >= -math.log(2) - 1e-5
    )  # a network that overlooks the glass does so in all views: one half
    assert evidence[_inside(centre_m)].max() < 2


def test_the_more_places_a_network_points_at_the_less_it_says():
    frames, rng = _views(), np.random.default_rng(1)
    places_m = np.array(
        [[x, y, z] for x in (-0.2, 0.0, 0.2) for y in (-0.2, 0.0, 0.2) for z in (-0.15, 0.15)]
    )
    told = {}
    for count in (1, 4, 18):
        scores = _balls(places_m[:count], frames) + 0.2 * rng.standard_normal((8, 48, 64)).astype(np.float32)
        evidence = _learned(scores, frames, _possible(_inside(places_m[:1])))
        told[count] = float(evidence[_inside(places_m[:1])].max())
        # Places of the size of the smallest object: at most the logarithm of their number over those it points at.
        pointed = np.count_nonzero(_inside(places_m[:count])) * (VOXEL_M / OBJECT_M) ** 3
        assert told[count] < math.log(evidence.size * (VOXEL_M / OBJECT_M) ** 3 / pointed) + math.log(4)
    assert told[1] > told[4] > told[18]
