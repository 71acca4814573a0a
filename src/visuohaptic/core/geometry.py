"""Geometry shared by several packages: angles, rotations as a Lie group, polygons and surfaces.

``*batch`` or ``...`` stands for any batch shape. Rotation vectors are axis times angle [rad].
"""

from __future__ import annotations

from typing import overload

import numpy as np
from jaxtyping import Float, Int

#: Planar pose or motion: x, y [m], angle [rad].
_Pose2D = tuple[float, float, float] | Float[np.ndarray, "3"]
#: A polygon whose area is below this fraction of its squared extent is a line up to rounding.
_MIN_AREA = 1e-12


@overload
def wrap_angle(angle_rad: float) -> float: ...
@overload
def wrap_angle(angle_rad: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]: ...
def wrap_angle(angle_rad: float | np.ndarray) -> float | np.ndarray:
    """Wrap an angle to (-pi, pi].

    Parameters
    ----------
    angle_rad
        Angle or array of angles [rad].

    Returns
    -------
    float or array
        Same shape as the argument [rad]; NaN stays NaN.

    Examples
    --------
    >>> round(wrap_angle(3.5 * np.pi) / np.pi, 6)
    -0.5
    """
    # The remainder is exact, and so is the difference of numbers within a factor of two.
    angle = np.fmod(angle_rad, 2 * np.pi)
    wrapped = angle - 2 * np.pi * (angle > np.pi) + 2 * np.pi * (angle <= -np.pi)
    return wrapped if isinstance(angle_rad, np.ndarray) and angle_rad.ndim else float(wrapped)


def rotation_2d(angle_rad: float) -> Float[np.ndarray, "2 2"]:
    """2D rotation matrix.

    Parameters
    ----------
    angle_rad
        Angle, counter-clockwise [rad].
    """
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def compose_2d(first: _Pose2D, second: _Pose2D) -> tuple[float, float, float]:
    """Composition of planar poses: ``second``, given in the frame of ``first``.

    Parameters
    ----------
    first, second
        x, y [m], angle [rad].

    Examples
    --------
    >>> compose_2d((1.0, 0.0, np.pi / 2), (2.0, 0.0, 0.0))[1]
    2.0
    """
    c, s = np.cos(first[2]), np.sin(first[2])
    x, y, angle = second
    return float(first[0] + c * x - s * y), float(first[1] + s * x + c * y), first[2] + angle


def relative_2d(first: _Pose2D, second: _Pose2D) -> tuple[float, float, float]:
    """Pose ``second`` in the frame of ``first``: the inverse of :func:`compose_2d`.

    Parameters
    ----------
    first, second
        x, y [m], angle [rad], in one frame.

    Examples
    --------
    >>> relative_2d((1.0, 0.0, 0.0), (3.0, 0.5, 0.1))
    (2.0, 0.5, 0.1)
    """
    c, s = np.cos(first[2]), np.sin(first[2])
    x, y = second[0] - first[0], second[1] - first[1]
    return float(c * x + s * y), float(c * y - s * x), wrap_angle(second[2] - first[2])


def hat(vector: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Cross-product matrices: ``hat(v) @ w`` is ``cross(v, w)``.

    Parameters
    ----------
    vector
        Vectors, shape (..., 3).
    """
    v = np.asarray(vector, dtype=np.float64)
    out = np.zeros((*v.shape, 3))
    out[..., 2, 1], out[..., 0, 2], out[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    return out - np.swapaxes(out, -1, -2)


def so3_exp(rotation_vector_rad: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrices of rotation vectors, by Rodrigues' formula.

    Parameters
    ----------
    rotation_vector_rad
        Axis times angle, shape (..., 3) [rad]; of any length.
    """
    vector = np.asarray(rotation_vector_rad, dtype=np.float64)
    angle = np.sqrt((vector * vector).sum(axis=-1))[..., None, None]
    cross = hat(vector)
    sine, versine = (
        np.sinc(angle / np.pi),
        0.5 * np.sinc(angle / (2 * np.pi)) ** 2,
    )  # over angle, over its square
    return np.eye(3) + sine * cross + versine * (cross @ cross)


def so3_log(rotation: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Rotation vectors of rotation matrices; inverse of :func:`so3_exp`.

    Parameters
    ----------
    rotation
        Rotation matrices, shape (..., 3, 3); orthonormal up to rounding.

    Returns
    -------
    array
        Axis times angle, shape (..., 3), of length 0 to pi [rad]. For a half turn, both signs of the axis
        are valid; one of them is returned.
    """
    matrix = np.asarray(rotation, dtype=np.float64)
    transposed = np.swapaxes(matrix, -1, -2)
    skew = 0.5 * (matrix - transposed)
    vector = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)  # axis times sine
    sine = np.sqrt((vector * vector).sum(axis=-1))
    cosine = 0.5 * (np.trace(matrix, axis1=-2, axis2=-1) - 1)
    angle = np.arctan2(sine, cosine)
    out = vector * (np.where(sine > 0, angle, 1.0) / np.where(sine > 0, sine, 1.0))[..., None]
    obtuse = cosine < 0
    if obtuse.any():
        # Near a half turn the sine vanishes, but not the symmetric part, cos I + (1 - cos) axis axis^T.
        square = 0.5 * (matrix + transposed) - cosine[..., None, None] * np.eye(3)
        column = np.argmax(np.diagonal(square, axis1=-2, axis2=-1), axis=-1)
        axis = np.take_along_axis(square, column[..., None, None], axis=-1)[..., 0]
        length = np.sqrt((axis * axis).sum(axis=-1)) * np.where((axis * vector).sum(axis=-1) < 0, -1.0, 1.0)
        length = np.where(obtuse, length, 1.0)  # undefined for small angles
        out = np.where(obtuse[..., None], axis * (angle / length)[..., None], out)
    return out


def sphere_directions(count: int) -> Float[np.ndarray, "count 3"]:
    """Unit vectors spread evenly over the sphere, the same at every call: Fibonacci's lattice.

    Parameters
    ----------
    count
        Number of directions.
    """
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    flat = np.sqrt(1 - z**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def polygon_area(outline_m: Float[np.ndarray, "n 2"]) -> float:
    """Signed area of a simple polygon [m^2], positive for counter-clockwise order.

    Parameters
    ----------
    outline_m
        Corners in order, shape (n, 2) [m]; closed implicitly.
    """
    return 0.5 * float(_fan(outline_m)[2].sum())


def polygon_centroid(outline_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2"]:
    """Centroid of a polygon's area, shape (2,) [m]; for zero area, the mean of its corners; NaN without any.

    Parameters
    ----------
    outline_m
        Corners in order, of either orientation, shape (n, 2) [m].
    """
    outline = np.asarray(outline_m, dtype=np.float64)
    if not len(outline):
        return np.full(2, np.nan)
    p, q, double = _fan(outline)
    total = double.sum()
    if abs(total) <= _MIN_AREA * np.ptp(outline, axis=0).max() ** 2:
        return outline.mean(axis=0)
    return outline[0] + double @ (p + q) / (3 * total)


def polygon_second_moments(outline_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2 2"]:
    """Second moments of a polygon's area about its centroid, divided by the area: a covariance matrix [m^2]; NaN without area.

    The trace is the squared polar radius of gyration.

    Parameters
    ----------
    outline_m
        Corners in order, of either orientation, shape (n, 2) [m].
    """
    centred = np.asarray(outline_m, dtype=np.float64) - polygon_centroid(outline_m)
    p, q = centred, np.roll(centred, -1, axis=0)
    double = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    if not len(centred) or abs(double.sum()) <= _MIN_AREA * np.ptp(centred, axis=0).max() ** 2:
        return np.full((2, 2), np.nan)
    # A triangle (0, p, q) contributes its area / 12 times p p^T + q q^T + (p + q) (p + q)^T.
    moments = sum((v * double[:, None]).T @ v for v in (p, q, p + q))
    return np.asarray(moments / (12 * double.sum()))


def _fan(outline_m: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges of a triangle fan from the first corner, and twice the triangles' areas: accurate far from the origin."""
    away = np.asarray(outline_m, dtype=np.float64)[1:] - outline_m[:1]
    p, q = away[:-1], away[1:]
    return p, q, p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]


def area_vectors(
    vertices_m: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f k"]
) -> Float[np.ndarray, "f 3"]:
    """Normal times area of each face, shape (f, 3) [m^2].

    Parameters
    ----------
    vertices_m
        Vertices, shape (v, 3) [m].
    faces
        Vertex indices of triangles, quadrilaterals or larger polygons, counter-clockwise seen from the side
        to which the normal points, shape (f, k). For a non-planar polygon, its mean normal times the spanned area.
    """
    corners = np.asarray(vertices_m)[faces]
    away = corners[:, 1:] - corners[:, :1]
    return 0.5 * np.cross(away[:, :-1], away[:, 1:]).sum(axis=1)


def vertex_normals(
    vertices_m: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f k"]
) -> Float[np.ndarray, "v 3"]:
    """Unit normals of vertices, shape (v, 3): area-weighted means over adjacent faces; 0 for vertices without faces.

    Parameters
    ----------
    vertices_m
        Vertices, shape (v, 3) [m].
    faces
        Vertex indices, shape (f, k), as in :func:`area_vectors`.
    """
    vectors = area_vectors(vertices_m, faces)
    sums = np.zeros((len(vertices_m), 3))
    for corner in range(faces.shape[1]):
        np.add.at(sums, faces[:, corner], vectors)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 0)
