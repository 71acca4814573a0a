"""Calibration of a camera with known parameters: rendered boards, and corners with known noise."""

from __future__ import annotations

import argparse
import functools
from pathlib import Path

import cv2
import numpy as np
import pytest

from visuohaptic.cli._arguments import Add
from visuohaptic.cli.verbs.sensing import calibrate_camera as command
from visuohaptic.core import CalibrationError, InputError
from visuohaptic.core.camera import (
    Board,
    BoardView,
    CalibrationLimits,
    Camera,
    Pose,
    calibrate_camera,
    detect_board,
)

CAMERA = Camera(
    640,
    480,
    np.array([[610.0, 0, 325.0], [0, 606.0, 236.0], [0, 0, 1]]),
    np.array([-0.12, 0.05, 0.001, -0.0008, 0.0]),
)
CHARUCO = Board(9, 7, 0.03, 0.022)
CHESS = Board(9, 7, 0.03)


def poses(count: int, seed: int, *, tilt_deg: float = 35.0) -> list[Pose]:
    """The board's middle at random places of the image, tilted about random axes."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        angle = rng.uniform(0, 2 * np.pi)
        turn = np.radians(rng.uniform(0.4, 1.0) * tilt_deg) * np.array([np.cos(angle), np.sin(angle), 0.0])
        pose = Pose.from_rotation_vector(turn, np.zeros(3))
        middle = np.array([rng.uniform(-0.09, 0.09), rng.uniform(-0.07, 0.07), rng.uniform(0.34, 0.5)])
        corner = middle - pose.rotation @ np.array([4.5 * 0.03, 3.5 * 0.03, 0.0])
        found.append(Pose(pose.rotation, corner))
    return found


def corner_views(seed: int, noise_px: float, count: int = 15, **more: float) -> list[BoardView]:
    rng = np.random.default_rng(seed + 1000)
    views = []
    for number, pose in enumerate(poses(count, seed, **more)):
        pixels = CAMERA.project(pose.apply(CHESS.corners_m))
        inside = ((pixels >= 0) & (pixels < [640, 480])).all(axis=1)
        noisy = pixels + rng.normal(0, noise_px, pixels.shape)
        views.append(BoardView(f"view{number}", np.flatnonzero(inside), noisy[inside]))
    return views


@functools.cache
def fine_rays() -> np.ndarray:
    """Three rays per pixel and axis: a pixel integrates over its area."""
    fine = (np.arange(640 * 3) + 0.5) / 3 - 0.5, (np.arange(480 * 3) + 0.5) / 3 - 0.5
    return CAMERA.rays(np.stack(np.meshgrid(*fine), axis=-1))


def render(board: Board, pose: Pose) -> np.ndarray:
    """The printed board through lens and perspective: every pixel looks up its place on the print."""
    scale = 40  # print pixels per square
    size = (board.columns * scale, board.rows * scale)
    if board.marker_m is not None:
        print_ = board.charuco().generateImage(size)
    else:
        y, x = np.mgrid[: board.rows, : board.columns]
        # As OpenCV's ChArUco boards, the first square is black.
        print_ = np.kron(((x + y) % 2 * 255).astype(np.uint8), np.ones((scale, scale), np.uint8))
    print_ = cv2.copyMakeBorder(print_, scale, scale, scale, scale, cv2.BORDER_CONSTANT, value=255)
    rays = fine_rays()
    normal, origin = pose.rotation[:, 2], pose.translation_m
    points = rays * ((origin @ normal) / (rays @ normal))[..., None]
    flat = ((points - origin) @ pose.rotation)[..., :2] / board.square_m
    # Coordinate 0 of the print is the outer edge of its first pixel.
    places = ((flat + 1) * scale - 0.5).astype(np.float32)
    image = cv2.remap(
        print_.astype(np.float32), places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderValue=128
    )
    image = cv2.resize(image, (640, 480), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(1).normal(0, 2, image.shape)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.7) + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("board", [CHARUCO, CHESS], ids=["charuco", "chess"])
def test_rendered_corners_are_found_to_sub_pixel(board: Board) -> None:
    errors = []
    for pose in poses(3, seed=2, tilt_deg=30.0):
        centred = Pose(pose.rotation, pose.translation_m * [1.0, 1.0, 1.3])
        view = detect_board(render(board, centred), board)
        truth = CAMERA.project(centred.apply(board.corners_m))
        if len(view.corner_ids):
            error = view.pixels - truth[view.corner_ids]
            if board.marker_m is None:
                # A plain board of odd x odd squares looks the same upside down.
                error = min(error, view.pixels[::-1] - truth[view.corner_ids], key=lambda e: np.abs(e).sum())
            errors.append(error)
    error = np.concatenate(errors)
    assert len(error) > 60
    # A pixel of the print is 0.75 px of the image; its interpolated edges are right to about a
    # twelfth of that.
    assert np.sqrt((error**2).mean()) < 0.06
    # The pixel convention: a shift of half a pixel would be a bias.
    assert np.abs(error.mean(axis=0)).max() < 0.03


def parameters(camera: Camera) -> np.ndarray:
    return np.concatenate([camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], camera.distortion[:5]])


def test_truth_is_recovered_within_the_declared_sigma() -> None:
    """Over 12 sessions of known noise: each parameter within 4 sigma, and the sigmas right on average."""
    scores = []
    for seed in range(12):
        result = calibrate_camera(corner_views(seed, 0.1), CHESS, (640, 480))
        sigma = np.array(list(result.sigma.values()))
        scores.append((parameters(result.camera) - parameters(CAMERA)) / sigma)
        # Corner noise of 0.1 px in x and in y: the rms is sqrt(2) of it, less the freedom of the fit.
        assert 0.12 < result.rms_px < 0.142
    scores_array = np.array(scores)
    # 108 normal values: beyond 4.5 sigma with a probability of 7e-4.
    assert np.abs(scores_array).max() < 4.5
    # Mean square of 108 values, correlated within a session (at least 12 free): 1 +- 3 sqrt(2 / 12).
    assert 0.25 < (scores_array**2).mean() < 2.2


def test_outlier_view_is_removed_and_named() -> None:
    views = corner_views(1, 0.1)
    rng = np.random.default_rng(0)
    views[4] = BoardView(
        "moved.png", views[4].corner_ids, views[4].pixels + rng.normal(0, 4, views[4].pixels.shape)
    )
    result = calibrate_camera(views, CHESS, (640, 480))
    assert list(result.removed) == ["moved.png"]
    assert "px is usual" in result.removed["moved.png"]
    error = parameters(result.camera) - parameters(CAMERA)
    assert (np.abs(error) < 4.5 * np.array(list(result.sigma.values()))).all()


def test_poor_sessions_are_refused_with_the_reason() -> None:
    with pytest.raises(CalibrationError, match=r"found 5 good views, expected at least 8.*more images"):
        calibrate_camera(corner_views(1, 0.1, 5), CHESS, (640, 480))
    with pytest.raises(CalibrationError, match=r"0 views are tilted.*tilt the board"):
        calibrate_camera(corner_views(1, 0.1, tilt_deg=3.0), CHESS, (640, 480))
    with pytest.raises(CalibrationError, match=r"rms is 2\.\d+ px, expected at most 0.6 px"):
        calibrate_camera(corner_views(1, 1.5), CHESS, (640, 480))
    left = [view.pixels[:, 0] < 400 for view in corner_views(1, 0.1, 9)]
    clipped = [
        BoardView(view.name, view.corner_ids[part], view.pixels[part])
        for view, part in zip(corner_views(1, 0.1, 9), left, strict=True)
    ]
    limits = CalibrationLimits(min_coverage=0.99)
    with pytest.raises(CalibrationError, match=r"corners cover \d+% of the image, expected 99%"):
        calibrate_camera(clipped, CHESS, (640, 480), limits=limits)
    with pytest.raises(CalibrationError, match="focal length is known to"):
        calibrate_camera(
            corner_views(1, 0.1), CHESS, (640, 480), limits=CalibrationLimits(max_focal_sigma=1e-6)
        )
    with pytest.raises(CalibrationError, match="found 0 good views"):
        calibrate_camera([], CHESS, (640, 480))
    # As with its corners counted instead of its squares.
    blank = [BoardView(f"image {k}", np.zeros(0, np.int64), np.zeros((0, 2))) for k in range(9)]
    with pytest.raises(CalibrationError, match="9 x 7 squares in none of 9 images; count its squares, not"):
        calibrate_camera(blank, CHESS, (640, 480))


def test_board_refusals() -> None:
    with pytest.raises(InputError, match="columns: found 2, expected at least 3"):
        Board(2, 7, 0.03)
    with pytest.raises(InputError, match=r"expected 0 < marker < 0.03"):
        Board(9, 7, 0.03, 0.04)
    with pytest.raises(InputError, match="found 'DICT_NONSENSE'"):
        detect_board(np.zeros((48, 64), np.uint8), Board(9, 7, 0.03, 0.02, "DICT_NONSENSE"))
    with pytest.raises(InputError, match="chessboard of 3 x 7 squares, expected at least 4 each way"):
        Board(3, 7, 0.03)
    with pytest.raises(InputError, match="DICT_4X4_50 with 50 markers, expected 70 for 14 x 10 squares"):
        detect_board(np.zeros((48, 64), np.uint8), Board(14, 10, 0.03, 0.02, "DICT_4X4_50"))


def test_command_from_pictures_to_file(tmp_path: Path) -> None:
    """Ten rendered pictures: the written camera projects as the true one does."""
    photos = tmp_path / "photos"
    photos.mkdir()
    for number, pose in enumerate(poses(10, seed=5)):
        cv2.imwrite(str(photos / f"{number}.png"), render(CHARUCO, pose))
    parser = argparse.ArgumentParser()
    command.add_arguments(Add(parser))
    out = tmp_path / "camera.yaml"
    words = ["--squares", "9x7", "--square-mm", "30", "--marker-mm", "22", "--out", str(out)]
    result = command.run(parser.parse_args([str(photos), *words]))
    assert result["views"] >= 8
    found = Camera.load(out)
    for name, truth in zip(("fx", "fy", "cx", "cy"), parameters(CAMERA)[:4], strict=True):
        entry = result["parameters"][name]
        # Corner errors of a rendered board are not wholly independent: 4 sigma instead of 3.
        assert abs(entry["value"] - truth) < 4 * entry["sigma"] + 0.2, name
    rays = np.array([[x, y, 1.0] for x in (-0.35, 0, 0.35) for y in (-0.25, 0, 0.25)])
    assert np.abs(found.project(rays) - CAMERA.project(rays)).max() < 1.0
    for wrong in ("9by7", "\u00b2x6", "9" * 5000 + "x6"):
        with pytest.raises(InputError, match=r"found '.{1,60}', expected COLUMNSxROWS"):
            command.run(
                parser.parse_args([str(photos), "--squares", wrong, "--square-mm", "30", "--out", str(out)])
            )
