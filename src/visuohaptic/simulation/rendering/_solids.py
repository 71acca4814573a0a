"""Upright prisms in the camera's view, and the parts of the sensor plane that they hide.

Outlines and contours are in frame F, with their states at the K keys of a frame: (n, K, 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core.camera.pose import Pose
from ...core.geometry import polygon_area, wrap_angle
from .rolling_view import NEAR_M, cut_polygon, following

#: Neighbouring edges whose directions differ by less share one face and its texture.
SMOOTH_RAD = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """One face of a prism, with the frame of its texture."""

    corners_m: Float[np.ndarray, "n K 3"]
    origin_m: Float[np.ndarray, "K 3"]  #: of the texture
    along_a: Float[np.ndarray, "K 3"]  #: unit vectors in the face
    along_b: Float[np.ndarray, "K 3"]
    normal: Float[np.ndarray, "3"]  #: outward, at the middle key


def at_height(points_m: Float[np.ndarray, "n K 2"], z_m: float) -> Float[np.ndarray, "n K 3"]:
    """Points of a horizontal plane in space.

    Parameters
    ----------
    points_m
        Points (n, K, 2) [m].
    z_m
        Height of the plane [m].
    """
    return np.concatenate([points_m, np.full((*points_m.shape[:-1], 1), z_m)], axis=-1)


def closed(front: Float[np.ndarray, "n K 2"], back: Float[np.ndarray, "m K 2"]) -> Float[np.ndarray, "p K 2"]:
    """Polygon between two contours that run in the same direction.

    Parameters
    ----------
    front, back
        Contours (n, K, 2) and (m, K, 2) [m].
    """
    return np.concatenate([front, back[::-1]])


def turned_left(outline_m: Float[np.ndarray, "n K 2"]) -> Float[np.ndarray, "n K 2"]:
    """The outline in counter-clockwise order.

    Parameters
    ----------
    outline_m
        Outline (n, K, 2) [m].
    """
    return outline_m if polygon_area(outline_m[:, outline_m.shape[1] // 2]) > 0 else outline_m[::-1]


def prism_faces(
    outline_m: Float[np.ndarray, "n K 2"],
    low_m: float,
    top_m: float,
    centre_m: Float[np.ndarray, "3"],
    min_normal_x: float = -2.0,
) -> list[Face]:
    """Faces of an upright prism that face the camera; the outline is counter-clockwise.

    Side faces whose normal's x is below ``min_normal_x`` are omitted.

    Parameters
    ----------
    outline_m
        Outline (n, K, 2), counter-clockwise [m].
    low_m, top_m
        Heights of base and top [m].
    centre_m
        Centre of the camera (3) in frame F [m].
    min_normal_x
        Minimum x of the normal of a side face.
    """
    keys = outline_m.shape[1]
    mid = keys // 2
    normals, lengths = _normals(outline_m[:, mid])
    seen = _seen(outline_m[:, mid], centre_m) & (normals[:, 0] >= min_normal_x)
    runs = np.cumsum(lengths) - lengths
    up = np.broadcast_to([0.0, 0.0, 1.0], (keys, 3))
    angles = np.arctan2(normals[:, 1], normals[:, 0])
    faces = []
    for group in _runs_of_edges(seen, angles):
        line = outline_m[np.append(group, (group[-1] + 1) % len(outline_m))]
        chord = line[-1] - line[0]
        direction = chord / np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-12)
        # Texture continues around the corners: a is the length along the outline.
        origin = at_height(line[0] - runs[group[0]] * direction, 0.0)
        faces.append(
            Face(
                np.concatenate([at_height(line, low_m), at_height(line[::-1], top_m)]),
                origin,
                at_height(direction, 0.0),
                up,
                np.append(normals[group].mean(axis=0), 0.0),
            )
        )
    if centre_m[2] > top_m + NEAR_M:
        along = outline_m[1] - outline_m[0]
        along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
        faces.append(
            Face(
                at_height(outline_m, top_m),
                at_height(outline_m[0], top_m),
                at_height(along, 0.0),
                at_height(across, 0.0),
                np.array([0.0, 0.0, 1.0]),
            )
        )
    return faces


def silhouette(
    outline_m: Float[np.ndarray, "n K 2"], low_m: float, top_m: float, centre_m: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "m K 3"]:
    """Outline of an upright convex prism as seen from the camera's centre.

    Parameters
    ----------
    outline_m, low_m, top_m, centre_m
        As of :func:`prism_faces`.
    """
    seen = _seen(outline_m[:, outline_m.shape[1] // 2], centre_m)
    if seen.all() or not seen.any():
        return at_height(outline_m, top_m)
    # A convex outline has one run of visible edges.
    first = int(np.flatnonzero(seen & ~np.roll(seen, 1))[0])
    turned, count = np.roll(outline_m, -first, axis=0), int(seen.sum())
    near = turned[: count + 1] if count < len(turned) else turned
    far = np.concatenate([turned[count:], turned[:1]])
    upper = far if centre_m[2] > top_m + NEAR_M else near[::-1]
    return np.concatenate([at_height(near, low_m), at_height(upper, top_m)])


def solid_faces(
    outline_m: Float[np.ndarray, "n 2"],
    height_m: float,
    poses_foam_solid: tuple[Pose, ...],
    texture_z_m: float,
    centre_m: Float[np.ndarray, "3"],
) -> list[Face]:
    """Faces of a prism in any orientation, in frame F.

    ``texture_z_m`` is the height in the solid at which the texture of its sides starts: that of the sensor
    plane for an upright solid, so that the texture is continuous when a body starts to tilt.

    Parameters
    ----------
    outline_m
        Outline (n, 2) in the frame of the solid [m].
    height_m
        Height of the solid [m].
    poses_foam_solid
        ``T_foam_solid`` at each of the K keys.
    texture_z_m
        Height in the solid at which the texture of its sides starts [m].
    centre_m
        Centre of the camera (3) in frame F [m].
    """
    keys = len(poses_foam_solid)
    middle = poses_foam_solid[keys // 2]
    eye = middle.inverse().apply(centre_m)
    own = np.repeat(np.asarray(outline_m, dtype=np.float64)[:, None], keys, axis=1)
    faces = prism_faces(turned_left(own), 0.0, height_m, eye)
    if eye[2] < -NEAR_M:
        along = np.repeat([[[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]], keys, axis=1)
        below = at_height(turned_left(own)[::-1], 0.0)
        faces.append(Face(below, np.zeros((keys, 3)), along[0], along[1], np.array([0.0, 0.0, -1.0])))
    rotations = np.array([pose.rotation for pose in poses_foam_solid])
    places_m = np.array([pose.translation_m for pose in poses_foam_solid])

    def to_foam(vectors: np.ndarray) -> np.ndarray:
        return np.einsum("kij,...kj->...ki", rotations, vectors)

    turned = []
    for face in faces:
        lift = texture_z_m if face.normal[2] == 0.0 else 0.0
        origin = face.origin_m + np.array([0.0, 0.0, lift])

        turned.append(
            Face(
                to_foam(face.corners_m) + places_m,
                to_foam(origin) + places_m,
                to_foam(face.along_a),
                to_foam(face.along_b),
                middle.rotation @ face.normal,
            )
        )
    return turned


def hidden_parts(
    foam_m: Float[np.ndarray, "p K 2"],
    outline_m: Float[np.ndarray, "n 2"],
    top_m: float,
    centre_m: Float[np.ndarray, "3"],
) -> list[tuple[Float[np.ndarray, "q K 2"], float]]:
    """Signed polygons whose sum is the part of the foam's top hidden by an upright prism.

    Hidden is the shadow of the prism from the camera's centre, without
    its own base: there the foam touches it from the near side.

    Parameters
    ----------
    foam_m
        Polygon of the foam's top (p, K, 2) [m].
    outline_m
        Outline of the prism (n, 2) [m].
    top_m
        Height of its top [m].
    centre_m
        Centre of the camera (3) in frame F [m].
    """
    mid = foam_m.shape[1] // 2
    points = foam_m[:, mid]
    if points[:, 0].max() <= outline_m[:, 0].min() and centre_m[0] < points[:, 0].min():
        return []
    result = []
    for region, sign in ((_shadow(outline_m, top_m, centre_m), 1.0), (outline_m, -1.0)):
        part = foam_m
        outward, _ = _normals(region)
        offsets = (region * outward).sum(axis=1)
        # Only an edge that some of the foam's points lie beyond can cut it.
        for k in np.flatnonzero((points @ outward.T > offsets).any(axis=0)):
            part = cut_polygon(part, offsets[k] - part[:, mid] @ outward[k])
            if len(part) < 3:
                break
        result.append((part, sign))
    # Less than a hundredth of a pixel: the regions differ by rounding only.
    if abs(abs(polygon_area(result[0][0][:, mid])) - abs(polygon_area(result[1][0][:, mid]))) < 1e-10:
        return []
    return [(part, sign) for part, sign in result if len(part) >= 3]


def hidden_from(
    points_m: Float[np.ndarray, "n 2"],
    outline_m: Float[np.ndarray, "m 2"],
    top_m: float,
    centre_m: Float[np.ndarray, "3"],
) -> Bool[np.ndarray, "n"]:
    """Mask of points of the plane z = 0 that an upright prism hides; points on its outline are visible.

    Parameters
    ----------
    points_m
        Points (n, 2) [m].
    outline_m
        Outline of the prism (m, 2) [m].
    top_m
        Height of its top [m].
    centre_m
        Centre of the camera (3) in frame F [m].
    """
    shadow = _within(_shadow(outline_m, top_m, centre_m), points_m, 1e-6)
    return shadow & ~_within(outline_m, points_m, -1e-4)


def _shadow(outline_m: np.ndarray, top_m: float, centre_m: np.ndarray) -> np.ndarray:
    """Convex region of the plane z = 0 that a prism hides or stands on, counter-clockwise."""
    from scipy.spatial import ConvexHull

    height = centre_m[2]
    # A prism as high as the camera hides everything behind it; 50 times farther is beyond any view.
    scale = height / max(height - top_m, 0.02 * height) if top_m > 0 else 1.0
    points = np.concatenate([outline_m, centre_m[:2] + scale * (outline_m - centre_m[:2])])
    return points[ConvexHull(points).vertices]


def _normals(outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outward unit normals and lengths of the edges of a counter-clockwise polygon."""
    edge = following(outline) - outline
    length = np.hypot(edge[:, 0], edge[:, 1])
    return np.column_stack([edge[:, 1], -edge[:, 0]]) / np.maximum(length, 1e-12)[:, None], length


def _seen(outline: np.ndarray, centre_m: np.ndarray) -> np.ndarray:
    """Mask of side faces that face the camera."""
    normals, lengths = _normals(outline)
    return (((centre_m[:2] - outline) * normals).sum(axis=1) > 0) & (lengths > 1e-9)


def _within(polygon: np.ndarray, points: np.ndarray, margin_m: float) -> np.ndarray:
    """Whether points lie deeper than a margin inside a convex counter-clockwise polygon."""
    outward, _ = _normals(polygon)
    return ((polygon * outward).sum(axis=1) - points @ outward.T > margin_m).all(axis=1)


def _runs_of_edges(chosen: np.ndarray, angles: np.ndarray) -> list[np.ndarray]:
    """Groups of adjacent edges of the given mask whose normals differ little, as on a round solid."""
    groups: list[list[int]] = []
    for i in np.flatnonzero(chosen):
        if groups and groups[-1][-1] == i - 1:
            turn = angles[i] - angles[groups[-1][0]]
            if abs(wrap_angle(turn)) < SMOOTH_RAD:
                groups[-1].append(int(i))
                continue
        groups.append([int(i)])
    return [np.array(group) for group in groups]
