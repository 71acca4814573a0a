"""Intrinsic calibration from images of a board; sessions that give an inaccurate camera are rejected."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..errors import CalibrationError, InputError
from ..geometry import so3_exp
from ..ranges import POSITIVE, at_least, check_ranges
from .model import Camera

#: Squares each way of a chessboard that OpenCV detects: three inner corners.
_FEWEST = 4
#: Names of the estimated parameters in the order of OpenCV.
_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


@dataclass(frozen=True, slots=True)
class Board:
    """A printed board of ``columns`` x ``rows`` squares.

    With ``marker_m`` it is a ChArUco board with markers of ``dictionary`` in its
    white squares, which may be partly visible; without, it is a plain chessboard that
    must be completely visible.
    """

    columns: int = field(metadata=at_least(3))  #: squares along the board's x axis
    rows: int = field(metadata=at_least(3))  #: squares along its y axis
    square_m: float = field(metadata=POSITIVE)  #: edge of a square, measured on the print
    marker_m: float | None = None  #: edge of a marker
    dictionary: str = "DICT_4X4_250"  #: OpenCV's name

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.marker_m is None and min(self.columns, self.rows) < _FEWEST:
            found = f"found a chessboard of {self.columns} x {self.rows} squares"
            raise InputError("Board", f"{found}, expected at least {_FEWEST} each way")
        if self.marker_m is not None and not 0 < self.marker_m < self.square_m:
            raise InputError(
                "Board", f"found {self.marker_m}, expected 0 < marker < {self.square_m}", field="marker_m"
            )

    @property
    def corners_m(self) -> Float[np.ndarray, "n 3"]:
        """Inner corners, row by row; z = 0."""
        y, x = np.mgrid[1 : self.rows, 1 : self.columns]
        flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
        return flat * self.square_m

    def charuco(self) -> Any:
        """OpenCV's object of a ChArUco board."""
        import cv2

        code = getattr(cv2.aruco, self.dictionary, None) if self.dictionary.startswith("DICT_") else None
        if code is None:
            raise InputError("Board", f"found {self.dictionary!r}, expected a name such as DICT_4X4_250")
        dictionary = cv2.aruco.getPredefinedDictionary(code)
        size, markers = (self.columns, self.rows), self.columns * self.rows // 2
        if markers > len(dictionary.bytesList):
            there = f"found {self.dictionary} with {len(dictionary.bytesList)} markers"
            raise InputError("Board", f"{there}, expected {markers} for {self.columns} x {self.rows} squares")
        return cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m or 0.0, dictionary)


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """Corners of the board found in one image."""

    name: str  #: name of the image, for messages
    corner_ids: Int[np.ndarray, "n"]  #: index into ``Board.corners_m``
    pixels: Float[np.ndarray, "n 2"]


@dataclass(frozen=True, slots=True)
class CalibrationLimits:
    """Acceptance limits of a session; the defaults suit a sensor with an accuracy of a tenth of a pixel."""

    min_views: int = 8
    min_corners: int = 8  #: a view with fewer is not used
    min_coverage: float = 0.5  #: fraction of the cells of a 6 x 6 grid over the image that contain corners
    min_tilt_deg: float = 15.0  #: of at least two views, about axes at least 30 deg apart
    max_rms_px: float = 0.6
    max_focal_sigma: float = 0.003  #: standard deviation relative to the focal length
    max_centre_sigma_px: float = 3.0
    outlier: float = 3.0  #: a view whose rms exceeds this multiple of the median is removed


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """A camera and the accuracy of its calibration."""

    camera: Camera
    sigma: dict[str, float]  #: standard deviation of fx, fy, cx, cy [px], k1, k2, p1, p2, k3
    rms_px: float  #: root mean square distance of corners from their projection
    view_rms_px: dict[str, float]  #: the same for each view used
    coverage: float  #: fraction of the image covered by corners, 0..1
    tilt_deg: tuple[float, float]  #: smallest and largest angle between board and image plane
    removed: dict[str, str] = field(default_factory=dict)  #: rejected views, with the reason

    def summary(self) -> dict[str, Any]:
        """Plain numbers for a report."""
        camera = self.camera
        values = dict(zip(_PARAMETERS[:4], camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], strict=True))
        values |= dict(zip(_PARAMETERS[4:], camera.distortion[[0, 1, 2, 3, 4]], strict=True))
        return {
            "width": camera.width,
            "height": camera.height,
            "parameters": {
                name: {"value": float(value), "sigma": float(self.sigma[name])}
                for name, value in values.items()
            },
            "rms_px": self.rms_px,
            "coverage": self.coverage,
            "tilt_deg": list(self.tilt_deg),
            "views": len(self.view_rms_px),
            "removed": dict(self.removed),
        }


def detect_board(
    image: UInt8[np.ndarray, "rows columns *colour"], board: Board, name: str = "image"
) -> BoardView:
    """Detect the board's corners with sub-pixel accuracy; the view has no corners if the board is not detected.

    Parameters
    ----------
    image
        Grey or BGR image, 8 bit, shape (rows, columns[, 3]).
    board
        The printed board.
    name
        Name of the image, for messages and the report.

    Returns
    -------
    BoardView
        Corners [px]; none if the board is not completely visible.
    """
    import cv2

    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    nothing = BoardView(name, np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
    if board.marker_m is not None:
        pixels, ids, _, _ = cv2.aruco.CharucoDetector(board.charuco()).detectBoard(grey)
        if ids is None or not len(ids):
            return nothing
        corners = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        return BoardView(name, ids.ravel().astype(np.int64), _refined(grey, corners, board))
    size = (board.columns - 1, board.rows - 1)
    good, pixels = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not good:
        return nothing
    corners = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    return BoardView(name, np.arange(size[0] * size[1]), _refined(grey, corners, board))


def _refined(
    grey: UInt8[np.ndarray, "rows columns"], corners: Float[np.ndarray, "n 2"], board: Board
) -> Float[np.ndarray, "n 2"]:
    """Corners refined in a window that excludes the markers.

    OpenCV's own window includes edges of the markers, which displaces some of
    the corners by 0.1 to 0.4 px (observed on rendered boards with 30 px squares);
    its chessboard detector has errors of the same size on a tilted board.
    """
    import cv2

    if len(corners) < 2:
        return corners
    apart = np.linalg.norm(corners[:, None] - corners[None, :], axis=2)
    np.fill_diagonal(apart, np.inf)
    # The nearest neighbour is one square away along the most foreshortened direction.
    square_px = float(np.median(apart.min(axis=1)))
    margin = 0.5 * (1.0 - (board.marker_m or 0.0) / board.square_m)
    half = int(np.clip(0.8 * margin * square_px, 2, 7))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    start = corners.astype(np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(grey, start.copy(), (half, half), (-1, -1), criteria).reshape(-1, 2)
    # A corner that moves far has converged to something other than a crossing of two edges.
    near = np.linalg.norm(refined - corners, axis=1) < half
    return np.where(near[:, None], refined, corners).astype(np.float64)


def calibrate_camera(
    views: Iterable[BoardView],
    board: Board,
    size: tuple[int, int],
    *,
    limits: CalibrationLimits | None = None,
    name: str = "camera",
) -> CameraCalibration:
    """Estimate focal lengths, principal point and distortion (k1, k2, p1, p2, k3).

    Standard deviations come from the curvature of the squared error at its
    minimum, scaled by the residuals (OpenCV's ``calibrateCameraExtended``).
    Views whose rms is an outlier are removed one at a time, the worst first.

    Parameters
    ----------
    views
        Detected corners of each image, from :func:`detect_board`.
    board
        The printed board. Its edge length only sets the scale of the poses.
    size
        Width and height of the images [px].
    limits
        Acceptance limits for views and results; defaults if omitted.
    name
        Name of the camera, written to its file.

    Raises
    ------
    CalibrationError
        Too few views, too little image coverage, too little variation of tilt,
        or a fit that is too uncertain; the message states what to add.
    """
    limits = limits or CalibrationLimits()
    removed: dict[str, str] = {}
    used: list[BoardView] = []
    views = list(views)
    if views and not any(len(view.corner_ids) for view in views):
        raise CalibrationError(
            name,
            f"found a board of {board.columns} x {board.rows} squares in none of {len(views)} images",
            remedy="count its squares, not the corners between them, and check the kind of the board",
        )
    for view in views:
        if len(view.corner_ids) >= limits.min_corners and not _collinear(board, view):
            used.append(view)
        else:
            removed[view.name] = (
                f"{len(view.corner_ids)} corners, expected {limits.min_corners} not in a line"
            )
    while True:
        if len(used) < limits.min_views:
            raise CalibrationError(
                name,
                f"found {len(used)} good views, expected at least {limits.min_views}"
                + (f"; left out: {_listed(removed)}" if removed else ""),
                remedy="take more images of the whole board, sharp and evenly lit",
            )
        fit = _fit(used, board, size)
        worst = int(np.argmax(fit.view_rms_px))
        typical = float(np.median(fit.view_rms_px))
        # Below a twentieth of a pixel differences between views do not indicate an outlier.
        if fit.view_rms_px[worst] <= max(limits.outlier * typical, 0.05):
            break
        bad = used.pop(worst)
        removed[bad.name] = f"rms {fit.view_rms_px[worst]:.2f} px where {typical:.2f} px is usual"
    coverage = _coverage(used, size)
    _check_views(fit, coverage, limits, name)
    camera = Camera(size[0], size[1], fit.matrix, fit.distortion, name=name)
    return CameraCalibration(
        camera,
        dict(zip(_PARAMETERS, (float(value) for value in fit.sigma), strict=True)),
        fit.rms_px,
        {view.name: float(rms) for view, rms in zip(used, fit.view_rms_px, strict=True)},
        coverage,
        (float(fit.tilt_deg.min()), float(fit.tilt_deg.max())),
        removed,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    matrix: Float[np.ndarray, "3 3"]
    distortion: Float[np.ndarray, "5"]
    sigma: Float[np.ndarray, "9"]
    rms_px: float
    view_rms_px: Float[np.ndarray, "v"]
    normals: Float[np.ndarray, "v 3"]  #: board normals, in the camera frame
    tilt_deg: Float[np.ndarray, "v"]


def _fit(views: list[BoardView], board: Board, size: tuple[int, int]) -> _Fit:
    import cv2

    corners = board.corners_m
    points = [corners[view.corner_ids].astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32).reshape(-1, 1, 2) for view in views]
    try:
        rms, matrix, distortion, turns, _, sigma, _, view_rms = cv2.calibrateCameraExtended(
            points, pixels, size, np.eye(3), np.zeros(5)
        )
    except cv2.error as error:
        raise CalibrationError("camera", f"the views cannot be fitted ({error.err})") from error
    normals = so3_exp(np.reshape(turns, (-1, 3)))[..., 2]
    tilt = np.degrees(np.arccos(np.clip(np.abs(normals[:, 2]), 0.0, 1.0)))
    return _Fit(
        np.asarray(matrix, dtype=np.float64),
        np.asarray(distortion, dtype=np.float64).ravel()[:5],
        np.asarray(sigma, dtype=np.float64).ravel()[:9],
        float(rms),
        np.asarray(view_rms, dtype=np.float64).ravel(),
        normals,
        tilt,
    )


def _check_views(fit: _Fit, coverage: float, limits: CalibrationLimits, name: str) -> None:
    """Reject a session whose standard deviations would be too optimistic."""
    problems = []
    if coverage < limits.min_coverage:
        problems.append(
            f"corners cover {coverage:.0%} of the image, expected {limits.min_coverage:.0%}: "
            "show the board at the borders and corners of the image"
        )
    tilted = fit.normals[fit.tilt_deg >= limits.min_tilt_deg]
    if not _diverse(tilted):
        problems.append(
            f"{len(tilted)} views are tilted by {limits.min_tilt_deg:.0f} deg or more, expected some about "
            f"two axes (largest: {fit.tilt_deg.max():.0f} deg): tilt the board left/right and up/down"
        )
    if fit.rms_px > limits.max_rms_px:
        problems.append(
            f"rms is {fit.rms_px:.2f} px, expected at most {limits.max_rms_px} px: "
            "check that the board is flat and its size right"
        )
    focal = float((fit.sigma[:2] / np.diag(fit.matrix)[:2]).max())
    if not focal <= limits.max_focal_sigma:
        problems.append(f"focal length is known to {focal:.2%}, expected {limits.max_focal_sigma:.2%}")
    centre = float(fit.sigma[2:4].max())
    if not centre <= limits.max_centre_sigma_px:
        problems.append(
            f"principal point is known to {centre:.1f} px, expected {limits.max_centre_sigma_px} px"
        )
    if problems:
        raise CalibrationError(name, "; ".join(problems))


def _diverse(normals: Float[np.ndarray, "v 3"]) -> bool:
    """Whether the boards tilt about axes at least 30 degrees apart (opposite tilts have the same axis)."""
    if len(normals) < 2:
        return False
    leaning = np.arctan2(normals[:, 1], normals[:, 0])
    apart = np.abs(leaning[:, None] - leaning[None, :]) % np.pi
    return bool((np.minimum(apart, np.pi - apart) >= np.radians(30)).any())


def _coverage(views: list[BoardView], size: tuple[int, int]) -> float:
    seen = np.zeros((6, 6), dtype=bool)
    for view in views:
        cells = np.clip((view.pixels / np.array(size) * 6).astype(int), 0, 5)
        seen[cells[:, 1], cells[:, 0]] = True
    return float(seen.mean())


def _collinear(board: Board, view: BoardView) -> bool:
    """Whether all corners lie on one line of the board, so that its pose is undetermined."""
    points = board.corners_m[view.corner_ids, :2]
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[-1] < 0.4 * board.square_m)


def _listed(removed: dict[str, str]) -> str:
    texts = [f"{name} ({reason})" for name, reason in removed.items()]
    return ", ".join(texts[:5]) + (f" and {len(texts) - 5} more" if len(texts) > 5 else "")
