"""Effects of what an exploration does not know on its readings: pose, gain and zeros of the gripper, and errors of the simulation.

Symbols: those of :mod:`.haptic_model`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.measurement import AIR_PA
from ..data import HEIGHTS, FeatureSet, POSE_m, TILT_rad, TouchProtocol
from .unknown_class import FEATURES, FIRST_WIDTH, HEIGHT, USUAL_HEIGHT_m

#: Ratio of the pose error of an uncalibrated gripper (5 mm) to that of a calibrated one.
POSE_RATIO = 5e-3 / POSE_m
#: Names of the nuisances, in the order of the rows of ``nuisance``.
NUISANCES = ("gain", "height", "zero of the force", "zero of the deformation", "mouth", "flattening")
APART = [k for k, name in enumerate(NUISANCES) if name != "height"]  # the height is part of the pose
#: Places over which the effect of the mouth's closure falls by e: fitted to maps of bottles with free and with fixed mouths.
MOUTH_REACH = 2.2


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """Standard deviations that the training data do not contain, and priors."""

    discrepancy: float = 0.04  #: relative error of simulated stiffness, independent by place
    end_discrepancy: float = 0.5  #: at the lowest and highest place, which depend on boundary conditions
    pose_m: float = POSE_m  #: error of the height, common to all touches
    poses: tuple[float, ...] = (1.0, POSE_RATIO)  #: equally probable factors of it; 1 if it was measured
    tilt_rad: float = TILT_rad  #: error of the gripper's tilt against the object, 3 degrees
    width_m: float = 0.0008  #: error of the width by pose and contact
    width_discrepancy: float = 0.005  #: relative
    gain: float = 0.09  #: common to all stiffnesses: force gain 5 %, modulus within 12 % (std 7 % if uniform)
    zero_N: float = 0.05  #: error of the force's zero, common to all touches
    zero_m: float = 5e-5  #: error of the deformation's zero (contact), common to all touches
    repeat: float = 0.0  #: relative difference of repeated touches of a place, learned from curves
    width_repeat: float = 0.0  #: of repeated widths of a place, learned from curves
    curvature: float = np.inf  #: between places of an object, learned from curves; infinite: no evidence
    mouth: float = 0.0  #: of log stiffness at the highest place, if open or closed unlike in training
    #: Of the stiffness by which lid and enclosed air hinder the flattening of an oval, in units of that of a piston, if unlike in training.
    flattening: float = 0.0
    unknown_prior: float = 0.1  #: probability that an object is of no trained class
    #: Unknown objects are simulated containers; else like the classes, which need not be containers or have a measured outline.
    simulate_unknown: bool = True
    use_width: bool = True  #: widths and the height of the object count as evidence


def log_features(data: FeatureSet, protocol: TouchProtocol) -> Float[np.ndarray, "n p"]:
    """Logarithms of stiffness [N/m], width [m] and height as a ratio to :data:`USUAL_HEIGHT_m`.

    Parameters
    ----------
    data
        Objects.
    protocol
        Resolution of the stiffness.

    Raises
    ------
    InputError
        A width or a height is not finite and positive.
    """
    for field, size_m in (("width_m", data.width_m), ("height_m", data.height_m)):
        if size_m is not None and not (np.isfinite(size_m) & (size_m > 0)).all():
            raise InputError("FeatureSet", "found a size that is not finite and above 0", field=field)
    stiffness = protocol.seen_stiffness(data.features[..., 0].reshape(len(data), -1))[0]
    tall = np.zeros(len(data)) if data.height_m is None else np.log(data.height_m / USUAL_HEIGHT_m)
    return np.column_stack([stiffness, np.log(data.width_m).reshape(len(data), -1), tall, 0 * tall])


def nuisance_effects(
    mean: Float[np.ndarray, "p"],
    pose: Float[np.ndarray, "p p"],
    settings: ModelSettings,
    protocol: TouchProtocol,
) -> Float[np.ndarray, "m p"]:
    """Effect of one standard deviation of each nuisance on the features of a class.

    The slope of a line through the origin, fitted to evenly spaced samples up to the reach r, changes by -3 z / (2 r) if
    the deformation reads z too high, and by 3 f / (2 k r) with an error f of the force's zero. "height" is the part of the pose errors
    along the slope s of the profile, P s / sqrt(s' P s). "mouth" decays exponentially from the highest place downwards;
    "flattening" is that of ovals.

    Parameters
    ----------
    mean
        Features of the class.
    pose
        P, effect of pose errors.
    settings, protocol
        Assumed standard deviations, and the protocol of a touch.
    """
    out = np.zeros((len(NUISANCES), FEATURES))
    stiffness = np.exp(mean[:FIRST_WIDTH])
    reach = np.minimum(protocol.max_deformation_m, protocol.max_force_N / stiffness)
    out[0, :FIRST_WIDTH] = settings.gain
    slope = _slopes(mean[None])[0]
    along = pose @ slope
    out[1] = along / np.sqrt(max(float(slope @ along), 1e-12))
    out[2, :FIRST_WIDTH] = 1.5 * settings.zero_N / (stiffness * reach)
    # The linearisation of the logarithm holds up to a relative effect of 1.
    out[3, :FIRST_WIDTH] = -np.minimum(1.5 * settings.zero_m / reach, 1.0)
    below = HEIGHTS - 1 - np.arange(FIRST_WIDTH) // 4
    out[4, :FIRST_WIDTH] = settings.mouth * np.exp(-below / MOUTH_REACH)
    out[5, :FIRST_WIDTH] = settings.flattening * np.repeat(_piston(mean), 4)
    return out


def _piston(mean: Float[np.ndarray, "p"]) -> Float[np.ndarray, "h"]:
    """Stiffness of the enclosed air when an oval flattens, relative to that of the wall, by height; at most 1.

    A pinch of a section with the half-axes a and q a changes its area by a part that is proportional to (1 - q^2) a, over a length
    that is proportional to the height H. Against the volume, proportional to q a^2 H, the air has the stiffness p (1 - q^2)^2 H.
    Both axes have the same relative effect (one shape of deformation), which vanishes at the foot and at a mouth that is held.
    """
    axes = mean[FIRST_WIDTH:HEIGHT].reshape(HEIGHTS, 2)
    flat = 1.0 - np.exp(-2.0 * np.abs(axes[:, 0] - axes[:, 1]))
    wall = np.exp(mean[:FIRST_WIDTH].reshape(HEIGHTS, 4).mean(axis=1))
    air = AIR_PA * USUAL_HEIGHT_m * np.exp(mean[HEIGHT]) * flat**2
    along = np.sin(np.pi * (np.arange(HEIGHTS) + 0.5) / HEIGHTS) ** 2
    return np.asarray(np.minimum(air / wall, 1.0) * along)


def pose_covariance(
    data: FeatureSet, features: Float[np.ndarray, "n p"], settings: ModelSettings, protocol: TouchProtocol
) -> Float[np.ndarray, "p p"]:
    """Covariance of the features due to one pose error of the gripper, common to all touches.

    Taken from the stiffness maps of the objects where available. Otherwise an error of the height moves all contacts along
    the slope of each profile, and a tilt in the plane of the tips moves them up on one side and down on the other.

    Parameters
    ----------
    data
        Objects of one class.
    features
        Their features, see :func:`log_features`.
    settings, protocol
        Standard deviations of the pose; resolution of the stiffness and distance of the heights.
    """
    count = len(features)
    slopes = _slopes(features)
    shift = settings.pose_m / protocol.place_m * slopes
    out = shift.T @ shift / count
    if data.pose_errors is not None:
        scale = settings.pose_m / POSE_m * protocol.seen_stiffness(data.features[..., 0])[1]
        moved = (scale[:, None] * np.asarray(data.pose_errors, dtype=float)).reshape(-1, FIRST_WIDTH)
        out[:FIRST_WIDTH] = out[:, :FIRST_WIDTH] = 0.0
        out[:FIRST_WIDTH, :FIRST_WIDTH] = moved.T @ moved / len(moved)
    else:
        lever = 0.5 * settings.tilt_rad * data.width_m / protocol.place_m
        steep = slopes[:, :FIRST_WIDTH].reshape(count, HEIGHTS, 4)
        for axis in range(2):
            tilted = np.zeros_like(steep)
            for k, sign in enumerate((1.0, -1.0)):
                tilted[:, :, 2 * axis + k] = sign * lever[:, :, axis] * steep[:, :, 2 * axis + k]
            flat = tilted.reshape(count, -1)
            out[:FIRST_WIDTH, :FIRST_WIDTH] += flat.T @ flat / count
    spread = (settings.width_m / data.width_m.mean(axis=0)) ** 2
    # The height of the object is measured as accurately as the gripper is positioned.
    tall = (settings.pose_m / USUAL_HEIGHT_m * np.exp(-features[:, HEIGHT].mean())) ** 2
    return out + np.diag(np.concatenate([np.zeros(FIRST_WIDTH), spread.ravel(), [tall, 0.0]]))


def _slopes(features: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
    """Change of each feature from one height to the next."""
    count = len(features)
    stiffness = np.gradient(features[:, :FIRST_WIDTH].reshape(count, HEIGHTS, 4), axis=1)
    width = np.gradient(features[:, FIRST_WIDTH:HEIGHT].reshape(count, HEIGHTS, 2), axis=1)
    return np.column_stack([stiffness.reshape(count, -1), width.reshape(count, -1), np.zeros((count, 2))])


def discrepancy(settings: ModelSettings) -> Float[np.ndarray, "p"]:
    """Variances of the errors of a simulation, independent by feature.

    Parameters
    ----------
    settings
        Relative errors.
    """
    out = np.full(FEATURES, settings.discrepancy**2)
    out[:4] = out[FIRST_WIDTH - 4 : FIRST_WIDTH] = settings.end_discrepancy**2
    out[FIRST_WIDTH:] = settings.width_discrepancy**2
    return out
