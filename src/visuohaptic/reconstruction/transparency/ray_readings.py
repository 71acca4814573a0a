"""What a camera reads on every ray against what other views see there, and in what circumstances.

The readings are *the same* surface, a *farther* or a *nearer* one, and *none* (a drop-out). How often each of them is
to be expected where nothing is transparent depends on the circumstances, the *context* of a ray: how far it is from
where the camera must fail (an edge of the expected surface, the unknown, a grazing surface, the shadow of the
projector; Alt 2016, 5.1), how many views see the expected surface, how many read nothing where it is (a dark surface
drops out from everywhere, glass before it from some places), and how far away it is. All of it follows from the other
views; the rates of each context are counted in the sequence itself (:mod:`.evidence`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt16

from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from .background import ideal_depth, intrinsics, motions

__all__ = ["CONTEXTS", "DROPPED", "FAR", "NEAR", "SAME", "RayImage", "TrackedNoise", "ViewDepth", "ray_image"]

#: Values of :attr:`RayImage.reading`; 0 is unknown.
SAME, FAR, NEAR, DROPPED = 1, 2, 3, 4
#: Upper limits of the classes of a context: distance from where the camera fails (in margins of its edges), views that
#: see the surface, fraction of views that read nothing there, depth of the surface [m].
_DISTANCES, _VOTES, _EMPTY, _DEPTHS_M = (0.0, 1.0, 2.0, 4.0), (2, 3), (0.1, 0.3, 0.5), (0.4, 0.8, 1.6, 3.2)
CONTEXTS = (len(_DISTANCES) + 1) * (len(_VOTES) + 1) * (len(_EMPTY) + 1) * (len(_DEPTHS_M) + 1)
#: Standard deviations within which depths agree: 1 % of those that do are missed.
_WIDTH = 2.5
#: Of this number of views and more three have to see a surface, of fewer two: by chance two of many agree.
_MANY = 8
#: Views whose agreement is measured, residuals that it takes, and the factor by which a noise may be larger than known.
_PROBES, _MIN_RESIDUALS, _TRUSTED = 6, 1000, 4.0
#: Tangent of the angle of incidence beyond which nothing is read.
_GRAZING_SLOPE = 4.0


@dataclass(frozen=True, slots=True)
class TrackedNoise:
    """Deviation of a depth from what another view predicts for it: of the camera, and of the poses."""

    device: DepthNoise = SENSOR_NOISE["kinect"]
    tracking_m: float = 0.003  #: by the position of the camera [m]
    turn_rad: float = 0.0015  #: by its direction [rad]

    factor: float = 1.0  #: of both, as measured in the sequence

    @classmethod
    def measured(
        cls, frames: Sequence[DepthFrame], near: Sequence[Sequence[int]], device: DepthNoise
    ) -> TrackedNoise:
        """The noise that a sequence shows: how well depths of some views agree with their nearest neighbour's.

        Parameters
        ----------
        frames
            All views.
        near
            Neighbours of each view, nearest first.
        device
            What is known of the camera.
        """
        from ._background_kernels import warp_views

        noise, ratios = cls(device), []
        paired = [i for i in range(len(frames)) if near[i]]
        for i in paired[:: max(1, len(paired) // _PROBES)]:
            here, there = (ViewDepth.of_frame(frames[k], noise) for k in (i, near[i][0]))
            pose = here.frame.T_world_camera
            warped = np.empty((1, *here.depth_m.shape), np.float32)
            motion = motions(pose, [there.frame.T_world_camera])
            warp_views(there.depth_m[None], motion, *intrinsics(here.frame.camera), warped)
            residual = np.abs(warped[0] - here.depth_m) / (np.sqrt(2) * here.sigma_m)
            ratios.append(residual[residual < 2 * _WIDTH])
        found = np.concatenate(ratios) if ratios else np.zeros(0)
        if len(found) < _MIN_RESIDUALS:
            return noise
        # Half of the deviates of a normal distribution are within 0.67 of its standard deviation.
        factor = float(np.clip(np.median(found) / 0.6745, 1.0, _TRUSTED))
        return cls(device, noise.tracking_m, noise.turn_rad, factor)

    def sigma_m(self, depth_m: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Standard deviation of depths of a surface that is seen at right angles [m].

        Parameters
        ----------
        depth_m
            Depths along the optical axis [m].
        """
        found: Float[np.ndarray, "*n"] = self.factor * self.device.with_tracking(self.tracking_m).sigma_m(
            depth_m
        )
        return found

    def pixels(self, focal_px: float) -> float:
        """Standard deviation of the place of a point in an image, per axis: by rounding and by the poses [px].

        Parameters
        ----------
        focal_px
            Focal length [px].
        """
        return float(np.hypot(np.sqrt(2 / 12), focal_px * self.turn_rad))


@dataclass(frozen=True, slots=True, eq=False)
class ViewDepth:
    """Depths of a view as a pinhole would see them, with what they may be off."""

    frame: DepthFrame
    depth_m: Float32[np.ndarray, "h w"]
    sigma_m: Float32[np.ndarray, "h w"]

    @classmethod
    def of_frame(cls, frame: DepthFrame, noise: TrackedNoise) -> ViewDepth:
        """Prepare a view for comparisons.

        Parameters
        ----------
        frame
            View.
        noise
            Of camera and poses.
        """
        from ._ray_kernels import depth_deviation

        depth_m = ideal_depth(frame)
        sigma_m = np.empty_like(depth_m)
        device = noise.device
        numbers = (device.quadratic_per_m, device.constant_m, device.offset_m, noise.tracking_m)
        focal_px = frame.camera.focal_px
        reach = noise.pixels(focal_px), _GRAZING_SLOPE / focal_px
        depth_deviation(depth_m, *(np.float32(number) for number in (*numbers, *reach)), sigma_m)
        return cls(frame, depth_m, np.float32(noise.factor) * sigma_m)


@dataclass(frozen=True, slots=True, eq=False)
class RayImage:
    """What each pixel of a view reads against what other views see on its ray."""

    reading: UInt8[np.ndarray, "h w"]  #: 0 unknown, 1 same, 2 farther, 3 nearer, 4 none
    code: UInt16[
        np.ndarray, "h w"
    ]  #: circumstances of the ray, below ``CONTEXTS``, times 5, plus the reading
    predicted_m: Float32[np.ndarray, "h w"]  #: depth of the opaque surface, 0 unknown [m]
    limit_m: Float32[np.ndarray, "h w"]  #: depth up to which the ray is evidence, 0: of nothing [m]
    clear: Bool[np.ndarray, "h w"]  #: whether a ray is away from where the camera fails


def ray_image(view: ViewDepth, others: Sequence[ViewDepth], noise: TrackedNoise) -> RayImage:
    """Compare every ray of a view with other views of the same camera.

    Parameters
    ----------
    view
        View whose rays are compared.
    others
        Other views, at least two.
    noise
        Of camera and poses.
    """
    from ._background_kernels import warp_views
    from ._ray_kernels import read_rays

    pose, camera = view.frame.T_world_camera, intrinsics(view.frame.camera)
    depths = np.stack([other.depth_m for other in others])
    sigmas = np.stack([other.sigma_m for other in others])
    poses = [other.frame.T_world_camera for other in others]
    warped = np.empty_like(depths)
    warp_views(depths, motions(pose, poses), *camera, warped)
    there = np.array([(other.inverse() @ pose).matrix[:3] for other in poses], np.float32)
    deepest_m = np.float32(noise.factor * noise.device.with_tracking(0.0).sigma_m(np.array(1.0)))
    numbers = np.float32(_WIDTH), deepest_m, np.float32(noise.factor * noise.tracking_m)
    shape = view.depth_m.shape
    predicted_m = np.empty(shape, np.float32)
    votes, empty, reading = (np.empty(shape, np.uint8) for _ in range(3))
    quorum = 2 if len(others) < _MANY else 3
    own = (view.depth_m, view.sigma_m, depths, sigmas, there, warped)
    read_rays(*own, *camera, *numbers, quorum, predicted_m, votes, empty, reading)
    focal_px = view.frame.camera.focal_px
    margin_px = noise.device.edge_px(focal_px) + noise.pixels(focal_px)
    distance = _from_failures(predicted_m, noise, focal_px) / margin_px
    far = np.digitize(distance, _DISTANCES, right=True)
    seen = np.digitize(votes, _VOTES, right=True)
    deep = np.digitize(predicted_m, _DEPTHS_M)
    dark = np.digitize(empty / np.maximum(votes + empty, 1), _EMPTY)
    context = far
    for limits, part in ((_VOTES, seen), (_EMPTY, dark), (_DEPTHS_M, deep)):
        context = context * (len(limits) + 1) + part
    limit_m = np.where(reading > 0, predicted_m - 3 * noise.sigma_m(predicted_m), 0.0).astype(np.float32)
    return RayImage(reading, (5 * context + reading).astype(np.uint16), predicted_m, limit_m, distance > 1)


def _from_failures(
    predicted_m: Float32[np.ndarray, "h w"], noise: TrackedNoise, focal_px: float
) -> Float32[np.ndarray, "h w"]:
    """Distance of every pixel from where the camera must fail [px]: steps, the unknown, grazing surfaces, shadows.

    At a step a camera mixes depths: stereo fattens what is in front by half of its matching window. Beside the unknown
    an edge may be hidden, as a cable on a table has a seam without depths around it.
    """
    import cv2

    from ._ray_kernels import projector_shadow

    known = predicted_m > 0
    window = np.ones((3, 3), np.uint8)
    nearest_m = cv2.erode(np.where(known, predicted_m, np.float32(1e3)), window)
    step_m = cv2.dilate(predicted_m, window) - nearest_m
    steep_m = 2 * _GRAZING_SLOPE / focal_px * nearest_m
    # A speck narrower than three pixels hides no edge.
    unknown = cv2.morphologyEx((~known).astype(np.uint8), cv2.MORPH_OPEN, window) > 0
    failing = unknown | (known & (step_m > np.maximum(2 * _WIDTH * noise.sigma_m(predicted_m), steep_m)))
    if noise.device.baseline_m != 0:
        shadow = np.zeros(predicted_m.shape, np.uint8)
        projector_shadow(predicted_m, focal_px * noise.device.baseline_m, 0.5, shadow)
        failing |= shadow > 0
    return cv2.distanceTransform((~failing).astype(np.uint8), cv2.DIST_L2, 3)
