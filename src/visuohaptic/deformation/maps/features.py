"""Stiffness features: 16 heights, 4 sides, 3 coefficients (Alt 2016, Sec. 6.1.6).

Sides are x+, x-, y+, y- of the object's axes; heights are at (h - 1/2) / 16 of the wall's height,
h = 1 .. 16 from below. Coefficients, all with respect to the deformation at the point of that side:

- i: linear, up to 3 mm [N/m]
- I: linear, full range [N/m]
- II: quadratic, full range, times (1 cm)^2 / 50 N
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from ...core import InputError, finite_array
from ...core.objects import HEIGHTS, NOMINAL_N, SIDES, LOW_m, NOMINAL_m
from ..nonlinear.contents import Contents, closed_compliance, enclosed_gradient, tip_approach
from ..shapes.mesher import ShellObject
from ..shells.shell import ShellModel
from ..shells.stiffness_map import DualTips, dual_tip_compliance, opposing_points
from .grasp_patterns import own_compliance

#: Reasons for a missing feature.
HELD, NOTHING_OPPOSITE = "the wall is held", "nothing is opposite"


@dataclass(frozen=True, slots=True, eq=False)
class StiffnessFeatures:
    """Features of one object; NaN where a coefficient was not computed or there is no opposite wall.

    A coefficient that is not ``valid`` is still a finite number; ``reason`` states why it is not reliable.
    """

    values: Float[np.ndarray, "16 4 3"]  #: coefficients i, I [N/m] and II [1]
    points_m: Float[np.ndarray, "16 4 3"]  #: points on the surface
    #: Whether a coefficient is reliable: a curve may end early, or snap through.
    valid: Bool[np.ndarray, "16 4 3"]
    reason: Shaped[np.ndarray, "16 4"]  #: why not all three are valid, or empty
    #: Fraction of the requested deformations that the curve reached; NaN without a curve.
    reached: Float[np.ndarray, "16 4"] | None = None

    def normalised(self, scheme: str = "centre") -> Float[np.ndarray, "16 4 2"]:
        """Scale-free linear coefficients i and I, see :func:`normalised`.

        Parameters
        ----------
        scheme
            ``norm``, ``centre`` or ``point``.
        """
        return np.stack([normalised(self.values[..., k], scheme) for k in range(2)], axis=-1)


def normalised(feature: Float[np.ndarray, "16 4"], scheme: str = "centre") -> Float[np.ndarray, "16 4"]:
    """Scale-free features.

    Parameters
    ----------
    feature
        One linear coefficient.
    scheme
        ``norm``: ``F' / |F'|`` with ``F' = F - median(F)``, Eq. (6.4); ``centre``: ``F / mean(F at
        x8+, x8-, y8+, y8-) - 1``, Eq. (6.5); ``point``: the same with F at x8+ alone.
    """
    if scheme == "norm":
        moved = feature - np.nanmedian(feature)
        length = float(np.sqrt(np.nansum(moved**2)))
        return moved / length if length > 0 else moved
    if scheme not in {"centre", "point"}:
        raise InputError("normalised", f"found {scheme!r}, expected norm, centre or point")
    scale = float(feature[7].mean() if scheme == "centre" else feature[7, 0])
    if not scale > 0:
        raise InputError("normalised", f"found stiffness {scale} N/m at the centre, expected > 0")
    return feature / scale - 1


def curve_coefficients(
    deformation_m: Float[np.ndarray, "k"], force_N: Float[np.ndarray, "k"]
) -> tuple[float, float, float]:
    """Least squares through the origin: i [N/m], I [N/m], II [1].

    II is the quadratic coefficient of ``F = a d + b d^2``, times (1 cm)^2 / 50 N. NaN if too few
    points are in the range.

    Parameters
    ----------
    deformation_m
        Deformation at the side's own point [m].
    force_N
        Force of one tip at these deformations [N].

    Raises
    ------
    InputError
        The arrays differ in shape or are not finite.
    """
    d = finite_array("curve", deformation_m, None, field="deformation_m", least=0)
    f = finite_array("curve", force_N, len(d), field="force_N", least=0)
    low = (d > 0) & (d <= LOW_m * (1 + 1e-9))

    def slope(some: np.ndarray) -> float:
        return float(d[some] @ f[some] / (d[some] @ d[some])) if some.any() else float("nan")

    quadratic = float("nan")
    if len(np.unique(d[d > 0])) >= 2:
        quadratic = float(np.linalg.lstsq(np.stack([d, d * d], axis=1), f, rcond=None)[0][1])
    return slope(low), slope(d > 0), quadratic * NOMINAL_m**2 / NOMINAL_N


def linear_features(container: ShellObject, contents: Contents | None = None) -> StiffnessFeatures:
    """Features of linear elasticity: i = I, II = 0, from one factorisation and a few pinches.

    Parameters
    ----------
    container
        Parametric or imported container.
    contents
        Contents; open by default.
    """
    model = container.model()
    points, corners, weights = feature_locations(container)
    names, inverse = np.unique(corners, return_inverse=True)
    tips = opposing_points(container.mesh, names, axis_point_m=container.axis_point_m)
    own = _own(container, model, tips, contents)
    tips_valid = (tips.valid[inverse].reshape(corners.shape) | (weights == 0)).all(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Between vertices the compliance is interpolated linearly: it is finite where the wall is fixed.
        value = 1.0 / np.einsum("hsk,hsk->hs", weights, own[inverse].reshape(corners.shape))
    values = np.stack([value, value, np.where(np.isfinite(value), 0.0, np.nan)], axis=-1)
    known = np.isfinite(values)
    reason = np.where(known.all(axis=2), "", np.where(tips_valid, HELD, NOTHING_OPPOSITE))
    return StiffnessFeatures(values, points, known, reason)


def _own(
    container: ShellObject, model: ShellModel, tips: DualTips, contents: Contents | None
) -> Float[np.ndarray, "m"]:
    pinch = dual_tip_compliance(model, tips)
    own = np.where(tips.valid, own_compliance(model, tips, np.nan_to_num(pinch)), np.nan)
    if contents is None or not contents.closed:
        return own
    # The gas exerts the same pressure at both tips; each tip moves back by its own fraction of w.
    a = enclosed_gradient(container, model)
    w = model.solve(a)
    along = tip_approach(tips, w, model.mesh.vertices_m)
    first = np.einsum("mi,mi->m", tips.direction, w[tips.first, :3])
    less = pinch - closed_compliance(container, model, tips, pinch, [contents])[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return own - np.where(along != 0, less * first / along, 0.0)


def feature_locations(
    container: ShellObject,
) -> tuple[Float[np.ndarray, "16 4 3"], Int[np.ndarray, "16 4 3"], Float[np.ndarray, "16 4 3"]]:
    """Outermost surface points of the 16 heights on the four sides.

    Parameters
    ----------
    container
        Parametric or imported container.

    Returns
    -------
    tuple
        Points (16, 4, 3) [m]; vertices of their faces (16, 4, 3); barycentric weights (16, 4, 3).

    Raises
    ------
    InputError
        There is no wall at one of the locations.
    """
    mesh = container.mesh
    faces = container.surface_faces
    low = float(mesh.vertices_m[:, 2].min())
    levels = low + (np.arange(HEIGHTS) + 0.5) / HEIGHTS * container.height_m
    points = np.zeros((HEIGHTS, len(SIDES), 3))
    corners = np.zeros((HEIGHTS, len(SIDES), 3), dtype=np.int64)
    weights = np.zeros((HEIGHTS, len(SIDES), 3))
    centred = mesh.vertices_m - np.array([*container.axis_point_m, 0.0])
    places = ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0))
    corner_z = centred[faces, 2].T
    bottom, top = np.minimum.reduce(corner_z), np.maximum.reduce(corner_z)
    at_level = [(bottom <= level) & (top >= level) for level in levels]
    for column, (axis, sign) in enumerate(places):
        flat = np.stack([centred[:, 1 - axis], centred[:, 2]], axis=1)
        reach = sign * centred[:, axis]
        a, b, c = (flat[faces[:, k]] for k in range(3))
        facing = np.maximum.reduce(reach[faces].T) > 0
        for row, level in enumerate(levels):
            target = np.array([0.0, level])
            some = np.flatnonzero(at_level[row] & facing)
            fractions = _shares(a[some], b[some], c[some], target)
            inside = np.asarray((fractions >= -1e-9).all(axis=1))
            if not inside.any():
                raise InputError(
                    container.name,
                    f"no wall on side {SIDES[column]} at height {level - low:.4g} m above the foot",
                )
            out = np.einsum("fk,fk->f", fractions, reach[faces[some]])
            best = int(np.argmax(np.where(inside, out, -np.inf)))
            face = faces[some[best]]
            fraction = np.maximum(fractions[best], 0.0)
            fraction = np.where(fraction < 1e-9, 0.0, fraction)
            weights[row, column] = fraction / fraction.sum()
            corners[row, column] = face
            points[row, column] = weights[row, column] @ mesh.vertices_m[face]
    return points, corners, weights


def _shares(a: np.ndarray, b: np.ndarray, c: np.ndarray, target: np.ndarray) -> Float[np.ndarray, "f 3"]:
    pairs = ((b - target, c - target), (c - target, a - target), (a - target, b - target))
    areas = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in pairs], axis=1)
    total = areas.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        out: np.ndarray = np.where(total != 0, areas / total, -1.0)
    return out
