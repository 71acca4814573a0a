"""Readings of rays: what a camera measures on each ray relative to what other views see there, and in which context.

The readings are *the same* surface, a *farther* or a *nearer* one, and *none* (a drop-out). Their rates where nothing is
transparent depend on the *context* of a ray: whether the second eye sees the expected surface, its distance from where
the camera fails (an edge of the expected surface, unknown depth, grazing incidence, the shadow of the projector; Alt 2016,
5.1), how many views see it, how many have no reading at it (a dark surface drops out in all views, glass in front of
it in some), and its depth. The context follows from the other views; the rates in each context are estimated from the sequence
itself (:mod:`.evidence`), and for a part at the surface behind it (:func:`surface_ratios`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt16

from ...io.depth.depth_sequence import DepthFrame
from ..fusion._fusion_view import GRAZING_SLOPE
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from .view_geometry import back_motions, ideal_depth, intrinsics, motions, world_points

#: Values of :attr:`RayImage.reading`; 0 is unknown.
SAME, FAR, NEAR, DROPPED = 1, 2, 3, 4
#: Upper limits of the context classes: distance from camera failures (in edge margins), number of views that see the
#: surface, fraction of views without a reading there, depth of the surface [m].
_DISTANCES, _VOTES, _EMPTY, _DEPTHS_M = (0.0, 1.0, 2.0, 4.0), (2, 3), (0.1, 0.3, 0.5), (0.4, 0.8, 1.6, 3.2)
#: Number of contexts; the distance has one more class, for surfaces that the second eye does not see.
CONTEXTS = (len(_DISTANCES) + 2) * (len(_VOTES) + 1) * (len(_EMPTY) + 1) * (len(_DEPTHS_M) + 1)
#: Probabilities of the readings same, farther, nearer, none through glass: thin and clear, strong, faint, filled. Real
#: D435s drop 29-77 % of the pixels of glass.
KINDS = np.array(
    [[0.30, 0.12, 0.05, 0.53], [0.08, 0.10, 0.04, 0.78], [0.62, 0.08, 0.03, 0.27], [0.15, 0.45, 0.12, 0.28]]
)
#: Weight of the prior of a context, in rays; the prior is that glass and no glass have equal rates.
_PRIOR_RAYS = 50.0
#: Standard deviation of the position [m] and of the orientation [rad] of a camera.
_TRACKING_M, _TURN_RAD = 0.003, 0.0015
#: Number of standard deviations within which depths agree: 1 % of agreeing depths are missed.
_WIDTH = 2.5
#: Three views have to see a surface if there are at least this many, otherwise two: two of many agree by chance.
_MANY = 8
#: Number of views whose agreement is measured, minimum number of residuals, and maximum factor on the nominal noise.
_PROBES, _MIN_RESIDUALS, _TRUSTED = 6, 1000, 4.0
#: Width of the median filter of predicted depths before edge detection [px].
_MEDIAN_PX = 5
#: Baselines that are compared on either side [m]: up to that of the known cameras (0.075) and of common ones (near 0.095). A step
#: moves a body by 1 mm.
_TRIED_M = np.linspace(0.0025, 0.1, 40)


@dataclass(frozen=True, slots=True)
class TrackedNoise:
    """Standard deviation of a depth against its prediction from another view, from camera and pose errors."""

    device: DepthNoise = SENSOR_NOISE["kinect"]
    factor: float = 1.0  #: factor on both, estimated from the sequence
    #: measured standard deviation of a depth, median of a pair of views, mean square of pairs; NaN if unknown [m]
    depth_sigma_m: float = np.nan

    @classmethod
    def measured(
        cls, frames: Sequence[DepthFrame], near: Sequence[Sequence[int]], device: DepthNoise
    ) -> TrackedNoise:
        """Estimate the noise of a sequence from the agreement of some views with their nearest neighbours.

        Pairs beyond 5 nominal standard deviations do not show the same surface.

        Parameters
        ----------
        frames
            All views.
        near
            Neighbours of each view, nearest first.
        device
            Nominal noise of the camera.
        """
        from ._view_kernels import warp_views

        noise, ratios, sigmas_m = cls(device), [], []
        paired = [i for i in range(len(frames)) if near[i]]
        for i in paired[:: max(1, len(paired) // _PROBES)]:
            here, there = (ViewDepth.of_frame(frames[k], noise) for k in (i, near[i][0]))
            pose = here.frame.T_world_camera
            warped = np.empty((1, *here.depth_m.shape), np.float32)
            motion = motions(pose, [there.frame.T_world_camera])
            warp_views(there.depth_m[None], motion, *intrinsics(here.frame.camera), warped)
            residual = np.abs(warped[0] - here.depth_m) / (np.sqrt(2) * here.sigma_m)
            same = residual < 2 * _WIDTH
            ratios.append(residual[same])
            # A median within a pair: readings of two surfaces at edges are no noise. Errors of poses differ from pair to pair.
            if same.any():
                sigmas_m.append(float(np.median((residual * here.sigma_m)[same])) / 0.6745)
        found = np.concatenate(ratios) if ratios else np.zeros(0)
        if len(found) < _MIN_RESIDUALS:
            return noise
        # The median absolute deviate of a normal distribution is 0.6745 standard deviations.
        factor = float(np.clip(np.median(found) / 0.6745, 1.0, _TRUSTED))
        depth_sigma_m = float(np.sqrt(np.mean(np.square(sigmas_m))))
        return cls(device, factor, depth_sigma_m)

    def sigma_m(self, depth_m: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Standard deviation of depths of a surface at normal incidence [m].

        Parameters
        ----------
        depth_m
            Depths along the optical axis [m].
        """
        return self.factor * replace(self.device, tracking_m=_TRACKING_M).sigma_m(depth_m)

    def pixels(self, focal_px: float) -> float:
        """Standard deviation of the image position of a point, per axis, from rounding and pose errors [px].

        Parameters
        ----------
        focal_px
            Focal length [px].
        """
        return float(np.hypot(np.sqrt(2 / 12), focal_px * _TURN_RAD))


@dataclass(frozen=True, slots=True, eq=False)
class ViewDepth:
    """Depths of a view as a pinhole image, with their standard deviations."""

    frame: DepthFrame
    depth_m: Float32[np.ndarray, "h w"]
    sigma_m: Float32[np.ndarray, "h w"]

    @classmethod
    def of_frame(cls, frame: DepthFrame, noise: TrackedNoise) -> ViewDepth:
        """Prepare a view for comparison with others.

        Parameters
        ----------
        frame
            View.
        noise
            Noise of camera and poses.
        """
        depth_m, focal_px = ideal_depth(frame), frame.camera.focal_px
        square = replace(noise.device, tracking_m=_TRACKING_M).sigma_m(depth_m) ** 2
        for axis in (0, 1):
            step, ahead = np.abs(np.diff(depth_m, axis=axis)), np.eye(2, dtype=int)[axis][:, None]
            both = [np.pad(step, ahead * ends, constant_values=np.inf) for ends in ((1, 0), (0, 1))]
            # The smaller of the two one-sided differences: the larger one may be a depth step.
            slope = np.fmin(*both)
            moved_m = np.float32(noise.pixels(focal_px)) * slope
            square += np.where(slope < GRAZING_SLOPE / focal_px * depth_m, moved_m, np.float32(0)) ** 2
        return cls(frame, depth_m, np.float32(noise.factor) * np.sqrt(square))


@dataclass(frozen=True, slots=True, eq=False)
class RayImage:
    """Reading of each pixel of a view relative to the surface that other views see on its ray."""

    reading: UInt8[np.ndarray, "h w"]  #: 0 unknown, 1 same, 2 farther, 3 nearer, 4 none
    #: context of the ray, below ``CONTEXTS``, times 5, plus the reading
    code: UInt16[np.ndarray, "h w"]
    predicted_m: Float32[np.ndarray, "h w"]  #: depth of the opaque surface; 0: unknown [m]
    limit_m: Float32[np.ndarray, "h w"]  #: depth up to which the ray is evidence; 0: no evidence [m]
    clear: Bool[np.ndarray, "h w"]  #: whether a ray is away from camera failures


def ray_image(view: ViewDepth, others: Sequence[ViewDepth], noise: TrackedNoise) -> RayImage:
    """Compare every ray of a view with other views of the same camera.

    Parameters
    ----------
    view
        View whose rays are compared.
    others
        Other views, at least two.
    noise
        Noise of camera and poses.
    """
    from ._ray_kernels import read_rays
    from ._view_kernels import warp_views

    pose, camera = view.frame.T_world_camera, intrinsics(view.frame.camera)
    depths = np.stack([other.depth_m for other in others])
    sigmas = np.stack([other.sigma_m for other in others])
    poses = [other.frame.T_world_camera for other in others]
    warped = np.empty_like(depths)
    warp_views(depths, motions(pose, poses), *camera, warped)
    there = back_motions(pose, poses)
    deepest_m = np.float32(noise.factor * replace(noise.device, tracking_m=0.0).sigma_m(np.array(1.0)))
    numbers = np.float32(_WIDTH), deepest_m, np.float32(noise.factor * _TRACKING_M)
    shape = view.depth_m.shape
    predicted_m = np.empty(shape, np.float32)
    votes, empty, reading = (np.empty(shape, np.uint8) for _ in range(3))
    quorum = 2 if len(others) < _MANY else 3
    own = (view.depth_m, view.sigma_m, depths, sigmas, there, warped)
    read_rays(*own, *camera, *numbers, quorum, predicted_m, votes, empty, reading)
    focal_px = view.frame.camera.focal_px
    margin_px = np.float32(noise.device.edge_px(focal_px) + noise.pixels(focal_px))
    distance_px, shadow = _from_failures(predicted_m, noise, focal_px)
    distance = distance_px / margin_px
    # A class of distance or votes begins above its limit, of the others at it.
    far, seen = [distance > limit for limit in _DISTANCES], [votes > limit for limit in _VOTES]
    share = empty / np.maximum(votes + empty, 1)
    dark, deep = [share >= limit for limit in _EMPTY], [predicted_m >= np.float32(z) for z in _DEPTHS_M]
    context = np.asarray(np.sum(far, axis=0, dtype=np.uint16))
    if (baseline_m := noise.device.baseline_m) != 0:
        # The second eye does not see the surface: another is before it, or less than half of a matching window is in its image.
        half_px, known = 0.5 * noise.device.window_px(focal_px), predicted_m > 0
        there = np.arange(shape[1]) - focal_px * baseline_m / np.where(known, predicted_m, 1)
        context[shadow | known & ((there < half_px) | (there > shape[1] - 1 - half_px))] = len(far) + 1
    for reached in (seen, dark, deep):
        context = context * (len(reached) + 1) + np.sum(reached, axis=0, dtype=np.uint16)
    limit_m = np.where(reading > 0, predicted_m - 3 * noise.sigma_m(predicted_m), np.float32(0))
    code = 5 * context + reading
    return RayImage(reading, code, predicted_m, limit_m, distance > 1)


def _from_failures(
    predicted_m: Float32[np.ndarray, "h w"], noise: TrackedNoise, focal_px: float
) -> tuple[Float32[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Distance of every pixel from the nearest camera failure [px]: depth step, unknown depth, grazing surface, shadow; and which are shadow.

    At a step a camera mixes depths: stereo extends the foreground by half of its matching window. Next to unknown depth
    an edge may be hidden, as a cable on a table is surrounded by pixels without depth.
    """
    import cv2

    from ._ray_kernels import projector_shadow

    window = np.ones((3, 3), np.uint8)
    # Smooth the noise of single readings; a median preserves edges.
    smooth_m = cv2.medianBlur(predicted_m, _MEDIAN_PX)
    known = smooth_m > 0
    nearest_m = cv2.erode(np.where(known, smooth_m, np.float32(1e3)), window)
    step_m = cv2.dilate(smooth_m, window) - nearest_m
    steep_m = 2 * GRAZING_SLOPE / focal_px * nearest_m
    # Unknown spots narrower than three pixels hide no edge.
    unknown = cv2.morphologyEx((predicted_m == 0).astype(np.uint8), cv2.MORPH_OPEN, window) > 0
    failing = unknown | (known & (step_m > np.maximum(2 * _WIDTH * noise.sigma_m(smooth_m), steep_m)))
    shadow = np.zeros(predicted_m.shape, np.uint8)
    if noise.device.baseline_m != 0:
        projector_shadow(predicted_m, focal_px * noise.device.baseline_m, 0.5, shadow)
    failing |= shadow > 0
    return cv2.distanceTransform((~failing).astype(np.uint8), cv2.DIST_L2, 3), shadow > 0


def reading_tables(codes: Sequence[UInt16[np.ndarray, "*n"]]) -> Float32[np.ndarray, "kinds n"]:
    """Log-likelihood ratios by kind of glass and :attr:`RayImage.code` [nat]; 0 for unknown readings.

    Parameters
    ----------
    codes
        Codes of the readings from which the rates without glass are estimated, of each view.
    """
    counts = sum(np.bincount(code.ravel(), minlength=5 * CONTEXTS) for code in codes)
    rates = np.reshape(counts, (CONTEXTS, 5))[:, 1:] + _PRIOR_RAYS * KINDS.mean(axis=0)
    rates /= rates.sum(axis=1, keepdims=True)
    tables = np.zeros((len(KINDS), CONTEXTS, 5), np.float32)
    tables[:, :, 1:] = np.log(KINDS[:, None] / rates)
    return tables.reshape(len(KINDS), -1)


def window_ratios(
    rays: RayImage, tables: Float32[np.ndarray, "kinds n"], matching_px: float, object_px: int
) -> Float32[np.ndarray, "h w"]:
    """Likelihood ratio of an object-sized window around every pixel (h, w).

    Parameters
    ----------
    rays
        Readings of a view.
    tables
        Log-likelihood ratios of the readings, see :func:`reading_tables` [nat].
    matching_px, object_px
        Edges of the matching window, whose readings count as one, and of the window of the smallest object [px].
    """
    import cv2

    total = np.zeros(rays.reading.shape, np.float32)
    for table in tables / np.float32(matching_px**2):
        image, size = np.take(table, rays.code), (object_px, object_px)
        window = cv2.boxFilter(image, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
        total += cv2.exp(np.clip(window, -30.0, 30.0)) / len(tables)
    return total


def surface_ratios(
    frames: Sequence[DepthFrame],
    images: Sequence[RayImage],
    through: Bool[np.ndarray, "n h w"],
    used: Bool[np.ndarray, "n h w"],
    tables: Float32[np.ndarray, "kinds n"],
    patch_m: float,
) -> list[Float32[np.ndarray, "h w"]]:
    """Correction of the log-likelihood ratios of the rays through a part for the readings at the surface behind it [nat].

    A specular surface mirrors a lamp into every view from another place, and rays to it drop out as through glass: in a polished
    bowl all of them pass its centre of curvature. Rays that end at the same place of the surface, but pass beside the part, drop
    out there too, whereas behind glass they read the surface. The rates without glass at a place are the mean rates of these
    rays over the views, with those of the context as a prior of one view (unit information, Kass and Wasserman 1995).

    Parameters
    ----------
    frames, images
        Views and their readings.
    through, used
        Rays through the part, and rays that no other part explains (n, h, w).
    tables
        See :func:`reading_tables` [nat].
    patch_m
        Size of a place of the surface, that of the smallest object of interest [m].
    """
    rates = np.exp(np.log(KINDS[0]) - tables[0].reshape(CONTEXTS, 5)[:, 1:])

    def patches(k: int, rays: Bool[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        chosen = rays & (images[k].reading > 0)
        points_m = world_points(frames[k], images[k].predicted_m, chosen)
        cells = np.floor(points_m / patch_m).astype(np.int64) & 0xFFFFF
        return chosen, (cells[:, 0] << 40) | (cells[:, 1] << 20) | cells[:, 2], images[k].code[chosen]

    hit = [patches(k, rays) for k, rays in enumerate(through)]
    keys = np.unique(np.concatenate([key for _, key, _ in hit]))
    sums, views = np.zeros((len(keys), 4)), np.zeros(len(keys))
    for k, rays in enumerate(used & ~through):
        _, key, code = patches(k, rays)
        at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        same = keys[at] == key
        counts = np.bincount(4 * at[same] + code[same] % 5 - 1, minlength=4 * len(keys)).reshape(-1, 4)
        number = counts.sum(axis=1)
        sums += counts / np.maximum(number, 1)[:, None]
        views += number > 0
    found = []
    for chosen, key, code in hit:
        at, context, reading = np.searchsorted(keys, key), code // 5, code % 5 - 1
        image = np.zeros(chosen.shape, np.float32)
        prior = rates[context, reading]
        image[chosen] = np.log(prior * (1 + views[at]) / (prior + sums[at, reading]))
        found.append(image)
    return found


def second_eye_m(images: Sequence[RayImage], focal_px: float, window_px: float) -> float:
    """Posterior median of the baseline of an unknown second eye along the rows, from the shadows beside the edges of opaque things [m].

    A camera that matches two images, or an image and a pattern, reads nothing where its second eye does not see the surface: on one side of
    every depth step, over a width that grows with the baseline. Matching windows fail at steps as well, but on both sides alike. The expected
    surface is that of the other views, so a vessel of glass casts no shadow. A camera that shows no shadows has its second eye at 0.
    Pixels are sorted by the shortest baseline with which they are in a shadow. Those nearer than the true one fail at a rate above one half, all
    others as the pixels on the other side of the steps do; rates have uniform priors. A wrong eye moves a body in proportion to its error, and the
    median has the least absolute one: few edges leave both sides possible, and the mean is then a short baseline that nothing speaks for.

    Parameters
    ----------
    images
        Readings of some views.
    focal_px, window_px
        Focal length, and matching window whose readings count as one [px].
    """
    from scipy.special import betaln
    from scipy.stats import beta

    from ._ray_kernels import projector_shadow

    # Failures and readings in the shadow of an eye to the right and left, by its distance.
    counts = np.zeros((2, len(_TRIED_M), 2))
    for image in images:
        known, failed = image.reading > 0, image.reading > SAME
        for k, eye_m in enumerate(_TRIED_M):
            for side, sign in enumerate((1.0, -1.0)):
                shadow = np.zeros(known.shape, np.uint8)
                projector_shadow(image.predicted_m, sign * focal_px * eye_m, 0.5, shadow)
                counts[side, k] += (
                    np.count_nonzero(failed & (shadow > 0)),
                    np.count_nonzero(known & (shadow > 0)),
                )
    counts /= window_px**2

    def evidence(cells: np.ndarray) -> np.ndarray:
        return np.asarray(betaln(cells[..., 0] + 1, cells[..., 1] - cells[..., 0] + 1))

    each = np.diff(counts, axis=1, prepend=0.0)
    alike = evidence(each.sum(axis=0))
    # An eye to the right, one to the left and none are as probable before.
    logs = [np.log([len(_TRIED_M)])]
    for own, other in ((counts[0], each[1]), (counts[1], each[0])):
        in_shadow = np.log(2) + beta.logsf(0.5, own[:, 0] + 1, own[:, 1] - own[:, 0] + 1)
        logs.append(evidence(own) + in_shadow + np.cumsum(evidence(other) - alike))
    told = np.concatenate([logs[2][::-1], logs[0], logs[1]])
    chances = np.exp(told - told.max())
    below = (np.cumsum(chances) - 0.5 * chances) / chances.sum()
    return float(np.interp(0.5, below, np.concatenate([-_TRIED_M[::-1], [0.0], _TRIED_M])))
