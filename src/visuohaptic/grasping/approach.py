"""Collision-free approach direction of a gripper to a grasp, given object, table and scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from ..core.objects import StiffnessMap
from ..core.ranges import finite_array
from .force import GripperModel

#: Elevations of the approach above the horizontal, in the order tried [rad]: from the side to from above.
ELEVATIONS_rad = tuple(np.radians((0.0, 30.0, 60.0, 90.0)))
#: Length of the straight approach, and clearance to obstacles [m].
TRAVEL_m, CLEARANCE_m = 0.1, 0.002
#: Distance of the points by which the triangles of a scene are represented [m], half of the narrowest part of a gripper; and the
#: distance beyond which nothing is an obstacle [m].
SCENE_STEP_m, SCENE_REACH_m = 0.005, 0.4
#: Maximum number of triangles that those of a scene are divided into: at least 5 m^2 within the reach, and below 1 GB.
MAX_SCENE_TRIANGLES = 2_000_000


@dataclass(frozen=True, slots=True, eq=False)
class GripperApproach:
    """Pose of the closing gripper: x from the first finger to the second, z the approach direction."""

    T_object_gripper: Float[np.ndarray, "4 4"]  #: origin midway between the contacts
    elevation_rad: float  #: elevation of the approach: 0 horizontal, from the side; pi / 2 from above
    open_width_m: float  #: between the fingers during the approach


@dataclass(frozen=True, slots=True, eq=False)
class ApproachSpace:
    """Obstacles of the gripper during its approach."""

    points_m: Float[np.ndarray, "p 3"]  #: of the object and of the scene, in the object's frame
    floor_m: float  #: height of the supporting surface

    @classmethod
    def of(cls, surface: StiffnessMap, scene_m: Float[np.ndarray, "s 3"] | None = None) -> ApproachSpace:
        """Corners and centroids of the triangles of an object, and points of the scene.

        Parameters
        ----------
        surface
            Map of the object, z up, on its foot.
        scene_m
            Points of its surroundings, as of a fused scene, in its frame [m]; none by default.
        """
        corners = surface.vertices_m[surface.faces]
        points = [corners.reshape(-1, 3), corners.mean(axis=1)]
        if scene_m is not None:
            points.append(np.asarray(scene_m, dtype=float).reshape(-1, 3))
        return cls(np.concatenate(points), float(corners[..., 2].min()))


def scene_points(
    vertices_m: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    T_scene_object: Float[np.ndarray, "4 4"],
    extent_m: Float[np.ndarray, "2 3"],
    name: str = "scene",
) -> Float[np.ndarray, "s 3"]:
    """Points of a scene near an object, in its frame [m]: vertices, and a grid on larger triangles.

    Parameters
    ----------
    vertices_m, faces
        Mesh, or points with no faces, in the frame of the scene.
    T_scene_object
        Pose of the object in the scene.
    extent_m
        Lowest and highest corner of the object.
    name
        Of the scene, for errors.

    Raises
    ------
    InputError
        A number is not finite, no point is near the object, or the surfaces there are too large for the memory.
    """
    vertices_m = finite_array(name, vertices_m, None, 3, least=0)
    points = (vertices_m - T_scene_object[:3, 3]) @ T_scene_object[:3, :3]
    low, high = extent_m[0] - SCENE_REACH_m, extent_m[1] + SCENE_REACH_m
    pieces, corners = [points], points[faces]
    while len(corners):
        corners = corners[((corners.max(axis=1) > low) & (corners.min(axis=1) < high)).all(axis=1)]
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        corners = corners[edges.max(axis=1) > SCENE_STEP_m]
        if 4 * len(corners) > MAX_SCENE_TRIANGLES:
            size = f"its triangles are {4 * len(corners)} of {1e3 * SCENE_STEP_m:g} mm and more within {SCENE_REACH_m} m of the object"
            remedy = "give only what stands around it, without hidden surfaces"
            raise InputError(name, f"{size}, expected at most {MAX_SCENE_TRIANGLES}", remedy=remedy)
        # Each is divided into four, so that what is beyond the reach is left out early.
        middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
        pieces.append(middles.reshape(-1, 3))
        outer = np.stack([corners, middles, np.roll(middles, 1, axis=1)], axis=2)
        corners = np.concatenate([outer.reshape(-1, 3, 3), middles])
    found = np.concatenate([one[((one > low) & (one < high)).all(axis=1)] for one in pieces])
    if not len(found):
        away = f"no point is within {SCENE_REACH_m} m of the object, expected its surroundings in metres"
        raise InputError(name, away, remedy="give the place of the object in it (--place)")
    return found


def find_approach(
    space: ApproachSpace,
    first_m: Float[np.ndarray, "3"],
    second_m: Float[np.ndarray, "3"],
    gripper: GripperModel,
) -> GripperApproach | None:
    """The first collision-free approach perpendicular to the line of the fingers, or None.

    Parameters
    ----------
    space
        Object, scene and table.
    first_m, second_m
        Contacts [m].
    gripper
        Opening and size of fingers and palm.

    Notes
    -----
    Fingers are boxes as wide as their patch, the palm is a box behind them. Points in the swept volume of a box
    are collisions, up to the fingertip, which is one radius beyond the contact.
    """
    middle = 0.5 * (first_m + second_m)
    x = second_m - first_m
    width = float(np.linalg.norm(x))
    x = x / width
    open_width = min(gripper.opening_m, width + 2 * gripper.finger_thickness_m)
    side = np.cross([0.0, 0.0, 1.0], x)
    if np.linalg.norm(side) < 1e-6:
        return None
    side /= np.linalg.norm(side)
    above = np.cross(x, side)
    for elevation in ELEVATIONS_rad:
        for sign in (1.0, -1.0) if elevation < np.pi / 2 else (1.0,):
            z = -(sign * np.cos(elevation) * side + np.sin(elevation) * above)
            pose = np.eye(4)
            pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = x, np.cross(z, x), z, middle
            if _is_free(space, pose, open_width, gripper):
                return GripperApproach(pose, float(elevation), open_width)
    return None


def _is_free(
    space: ApproachSpace, pose: Float[np.ndarray, "4 4"], open_width: float, gripper: GripperModel
) -> bool:
    local = (space.points_m - pose[:3, 3]) @ pose[:3, :3]
    for low, high in _boxes(open_width, gripper):
        swept = np.array([low[0], low[1], low[2] - TRAVEL_m])
        if ((local > swept - CLEARANCE_m) & (local < high + CLEARANCE_m)).all(axis=1).any():
            return False
        corners = np.array(
            [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
        )
        if (corners @ pose[2, :3] + pose[2, 3]).min() < space.floor_m:
            return False
    return True


def _boxes(open_width: float, gripper: GripperModel) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Lowest and highest corners of fingers and palm in the gripper's frame."""
    inner, outer = 0.5 * open_width, 0.5 * open_width + gripper.finger_thickness_m
    radius, length = max(gripper.finger_radius_m, 1e-3), gripper.finger_length_m
    for sign in (1.0, -1.0):
        ends = np.sort([sign * inner, sign * outer])
        # No clearance along the closing direction: the distance to the wall follows from the opening width.
        ends += np.array([CLEARANCE_m, -CLEARANCE_m])
        yield np.array([ends[0], -radius, -length]), np.array([ends[1], radius, radius])
    half = 0.5 * gripper.palm_thickness_m
    yield np.array([-outer, -half, -length - gripper.palm_thickness_m]), np.array([outer, half, -length])
