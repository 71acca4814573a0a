"""Motions of the rod's cross sections from template poses in the camera (Alt 2016, Sec. 3.4).

Covariances of poses are of (x, y, z, r_X, r_Y, r_Z) [m, rad] in the axes of the
*target* frame, translation and rotation apart: t' = t + dt, R' = exp([dr]) R.
For a pose in the camera these are the axes of the camera, as in ROS
``PoseWithCovariance``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from ...core import InputError, Pose, Reason
from ...core.geometry import hat, so3_log


class TemplateObservation(Protocol):
    """Interface of a tracked template; any tracker may provide it."""

    @property
    def name(self) -> str: ...
    @property
    def valid(self) -> bool: ...
    @property
    def reason(self) -> Reason: ...
    @property
    def T_camera_template(self) -> Pose | None: ...
    @property
    def covariance(self) -> Float[np.ndarray, "6 6"]: ...


@dataclass(frozen=True, slots=True, eq=False)
class TemplateMeasurement:
    """Pose of one named template in one frame."""

    name: str
    T_camera_template: Pose | None  #: None when not valid
    covariance: Float[np.ndarray, "6 6"]  #: of the pose, in the axes of the camera; NaN when not valid
    valid: bool = True
    reason: Reason = Reason.OK

    @classmethod
    def missing(cls, name: str, reason: Reason = Reason.LOST) -> TemplateMeasurement:
        """A template that is not visible.

        Parameters
        ----------
        name
            Name of the template.
        reason
            Reason why it is not visible.
        """
        return cls(name, None, np.full((6, 6), np.nan), False, reason)


@dataclass(frozen=True, slots=True, eq=False)
class RelativePoses:
    """Poses of n templates in the reference template, and their joint covariance."""

    names: tuple[str, ...]
    poses: tuple[Pose, ...]  #: pose_reference_template of each
    covariance: Float[np.ndarray, "6n 6n"]  #: correlated, because all share the reference
    shared: Float[np.ndarray, "6n 6"]  #: d(poses) / d(reference), of the common part

    def select(self, names: Sequence[str]) -> RelativePoses:
        """Select templates in a given order.

        Parameters
        ----------
        names
            Their names.
        """
        places = [self.names.index(name) for name in names]
        rows = np.concatenate([6 * place + np.arange(6) for place in places])
        return RelativePoses(
            tuple(names),
            tuple(self.poses[place] for place in places),
            self.covariance[np.ix_(rows, rows)],
            self.shared[rows],
        )


@dataclass(frozen=True, slots=True, eq=False)
class SectionMotion:
    """Motion of n cross sections of the rod relative to rest, in frame S."""

    xi: Float[np.ndarray, "n"]
    translation_m: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 3 3"]
    noise: Float[np.ndarray, "6n 6n"]  #: covariance due to the frame's own poses, (d, phi) per section
    zero: Float[np.ndarray, "6n 6n"]  #: covariance due to the zero reference, common to all frames

    @property
    def vector(self) -> Float[np.ndarray, "6n"]:
        """(d_X, d_Y, d_Z, phi_X, phi_Y, phi_Z) of each section [m, rad]."""
        return np.hstack([self.translation_m, so3_log(self.rotation)]).ravel()

    @property
    def covariance(self) -> Float[np.ndarray, "6n 6n"]:
        """Sum of both covariances."""
        return self.noise + self.zero


def relative_poses(
    reference: Pose,
    reference_covariance: Float[np.ndarray, "6 6"],
    templates: Sequence[TemplateObservation],
) -> RelativePoses:
    """Templates relative to the reference template, so that camera and sensor may move.

    With t = R_R^T (t_A - t_R) and R = R_R^T R_A,
    dt = R_R^T (dt_A - dt_R - dr_R x (t_A - t_R)) and dr = R_R^T (dr_A - dr_R).

    Parameters
    ----------
    reference
        ``T_camera_reference``, pose of the reference template.
    reference_covariance
        Its covariance, axes of the camera [m, rad].
    templates
        Templates on the rod, all valid.
    """
    turn = np.kron(np.eye(2), reference.rotation.T)
    poses, own, shared = [], [], []
    for template in templates:
        pose = template.T_camera_template
        if pose is None:
            raise InputError("templates", f"{template.name} has no pose", remedy="leave it out")
        if template.covariance.shape != (6, 6) or not np.isfinite(template.covariance).all():
            raise InputError(
                "templates", f"{template.name} is valid, but its covariance is not 6 x 6 numbers"
            )
        poses.append(reference.inverse() @ pose)
        own.append(turn @ template.covariance @ turn.T)
        lever = np.eye(6)
        lever[:3, 3:] = -hat(pose.translation_m - reference.translation_m)
        shared.append(turn @ lever)
    stack = np.vstack(shared)
    covariance = stack @ reference_covariance @ stack.T
    for k, block in enumerate(own):
        covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += block
    return RelativePoses(tuple(template.name for template in templates), tuple(poses), covariance, -stack)


def section_motion(
    now: RelativePoses,
    rest: RelativePoses,
    xi: Mapping[str, float],
    T_reference_sensor: Pose,
    length_m: float,
) -> SectionMotion:
    """Motion of the cross sections that carry the templates.

    A template is fixed to one cross section by an unknown rigid mount. At rest
    that section is at (xi L, 0, 0) in S, which with the pose at rest determines the
    mount; with the current pose, the mount determines the section. A section at q in
    the reference template is at o = R_0^T (q - t_0) in the template, and is
    now at x = R o + t.

    Parameters
    ----------
    now, rest
        Poses in the reference template, now and without load.
    xi
        Position x / L of each template on the rod, by name.
    T_reference_sensor
        Pose of frame S in the reference template.
    length_m
        Length L of the rod [m].
    """
    rest = rest.select(now.names)
    turn = T_reference_sensor.rotation.T
    turn6 = np.kron(np.eye(2), turn)
    count = len(now.names)
    places = np.array([xi[name] for name in now.names])
    translation, rotation = np.zeros((count, 3)), np.zeros((count, 3, 3))
    by_now, by_rest = np.zeros((6 * count, 6 * count)), np.zeros((6 * count, 6 * count))
    for k, (pose, pose_rest) in enumerate(zip(now.poses, rest.poses, strict=True)):
        section = T_reference_sensor.apply(np.array([places[k] * length_m, 0.0, 0.0]))
        arm_rest = section - pose_rest.translation_m
        turned = pose.rotation @ pose_rest.rotation.T
        arm = turned @ arm_rest
        translation[k] = turn @ (arm + pose.translation_m - section)
        rotation[k] = turn @ turned @ turn.T
        block = np.eye(6)
        block[:3, 3:] = -hat(arm)
        rows = slice(6 * k, 6 * k + 6)
        by_now[rows, rows] = turn6 @ block
        # exp([dr]) R_0 rotates the section back by dr, relative to the current pose.
        block = np.zeros((6, 6))
        block[:3, :3] = block[3:, 3:] = -turned
        block[:3, 3:] = turned @ hat(arm_rest)
        by_rest[rows, rows] = turn6 @ block
    return SectionMotion(
        places,
        translation,
        rotation,
        by_now @ now.covariance @ by_now.T,
        by_rest @ rest.covariance @ by_rest.T,
    )
