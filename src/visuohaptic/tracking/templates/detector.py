"""Detection of templates anywhere in an image: tags by their code, images by SIFT features.

Alt 2016, Sec. 2.3.1 and 2.3.3. A match is accepted if its descriptor distance is below 0.8
times that of the second nearest (Lowe; the dissertation prints the opposite inequality). A detection
is an initial estimate: the tracker refines it on all pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from ...core.errors import InputError
from ..points.homography import apply_homography, estimate_homography, estimate_homography_robust
from .alignment.esm import align
from .alignment.esm_pyramid import EsmSettings
from .alignment.warp import is_proper
from .template import Template


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """Effort and acceptance thresholds of the detection."""

    ratio: float = 0.8  #: nearest over second-nearest descriptor distance of a good match
    threshold_px: float = 4.0  #: maximum error of an inlier of a homography
    min_matches: int = 8  #: minimum number of inliers
    max_features: int = 4000  #: maximum number in a whole image
    max_side_px: int = 1280  #: larger images are downscaled for features, and not doubled for small tags
    max_region_features: int = 600  #: maximum number in a region, where the template fills a large part
    max_region_side_px: int = 240  #: maximum side of a region; the tracker uses all its pixels anyway
    ncc_nearby: float = 0.75  #: minimum correlation of a purely translated image
    #: the same for a tag; any two of the 587 tags, in any direction, stay below 0.76
    ncc_nearby_tag: float = 0.85


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """A template found in an image."""

    name: str
    homography: Float[np.ndarray, "3 3"]  #: template pixels to image pixels, accurate to about a pixel
    support: int  #: number of inliers; 4 for a tag, 0 if found by correlation


def detect_templates(
    templates: tuple[Template, ...],
    image: UInt8[np.ndarray, "height width"],
    settings: DetectorSettings | None = None,
    *,
    region: tuple[int, int, int, int] | None = None,
    last_seen: Mapping[str, Float[np.ndarray, "3 3"]] | None = None,
    seed: int = 0,
) -> dict[str, Detection]:
    """Detect templates; the result contains only those found.

    Parameters
    ----------
    templates
        Templates to detect.
    image
        Grey image.
    settings
        Effort and thresholds.
    region
        x0, y0, x1, y1: search only there.
    last_seen
        Homographies from before the templates were lost. With a region, each is first searched as a
        translated copy: that takes a tenth of the time of feature detection.
    seed
        Seed of the random sampling.
    """
    settings = settings or DetectorSettings()
    x0, y0 = 0, 0
    if region is not None:
        x0, y0 = max(region[0], 0), max(region[1], 0)
        image = image[y0 : max(region[3], 0), x0 : max(region[2], 0)]
    if min(image.shape) < 16:
        return {}
    shift = np.array([[1, 0, x0], [0, 1, y0], [0, 0, 1.0]])
    found: dict[str, Detection] = {}
    if region is not None and last_seen:
        for template in templates:
            if template.name in last_seen:
                start = np.linalg.inv(shift) @ last_seen[template.name]
                found |= _shifted(template, image, start, settings)
    left = tuple(template for template in templates if template.name not in found)
    tags = tuple(template for template in left if template.tag_id is not None)
    images = tuple(template for template in left if len(template.descriptors) >= 2)
    if tags:
        found |= _tags(tags, image, settings.max_side_px)
    if images:
        side, features = settings.max_side_px, settings.max_features
        if region is not None:
            side, features = settings.max_region_side_px, settings.max_region_features
        found |= _tagless(images, image, settings, seed, side, features)
    return {
        name: Detection(name, shift @ detection.homography, detection.support)
        for name, detection in found.items()
    }


def _tags(templates: tuple[Template, ...], image: np.ndarray, max_side_px: int) -> dict[str, Detection]:
    """Detect tags by their code, those not found in the image of twice the size: small and blurred ones."""
    import cv2

    found = _coded(templates, image)
    left = tuple(template for template in templates if template.name not in found)
    if left and max(image.shape) <= max_side_px:
        # The contours of the search are whole pixels, which is a large part of a cell of two or three.
        twice = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        half = np.array([[0.5, 0, -0.25], [0, 0.5, -0.25], [0, 0, 1.0]])
        for name, detection in _coded(left, twice).items():
            found[name] = Detection(name, half @ detection.homography, detection.support)
    return found


def _coded(templates: tuple[Template, ...], image: np.ndarray) -> dict[str, Detection]:
    """Tags whose code is read; the corners are only an initial estimate."""
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    # The search over window sizes dominates the cost; two sizes cover tags from 20 px upwards.
    parameters.adaptiveThreshWinSizeMin = 7
    parameters.adaptiveThreshWinSizeMax = 27
    parameters.adaptiveThreshWinSizeStep = 20
    parameters.minMarkerPerimeterRate = 0.02
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    # All of the five bits that the code can correct: by chance, 3e-5 of other quadrilaterals are taken for one given tag, and
    # its pixels are compared afterwards.
    parameters.errorCorrectionRate = 1.0
    # Blur mixes neighbouring cells: their middles are read.
    parameters.perspectiveRemoveIgnoredMarginPerCell = 0.3
    parameters.perspectiveRemovePixelPerCell = 8
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(image)
    result: dict[str, Detection] = {}
    if ids is None:
        return result
    numbers = [int(number) for number in ids.ravel()]
    # A number that is seen twice is ambiguous.
    seen = {
        number: quad.reshape(4, 2).astype(np.float64)
        for number, quad in zip(numbers, corners, strict=True)
        if numbers.count(number) == 1
    }
    for template in templates:
        if template.tag_id is not None and template.tag_id in seen:
            try:
                homography = estimate_homography(template.tag_corners, seen[template.tag_id])
            except InputError:
                continue
            if is_proper(homography, template.esm.corners):
                result[template.name] = Detection(template.name, homography, 4)
    return result


def _shifted(
    template: Template, image: np.ndarray, start: np.ndarray, settings: DetectorSettings
) -> dict[str, Detection]:
    """Find a template with about the previous size and orientation anywhere in the image, by correlation."""
    corners = apply_homography(start, template.esm.corners)
    height, width = image.shape
    low, high = corners.min(axis=0), corners.max(axis=0)
    # Maximum displacement at which at least half of it is inside the image.
    reach = float(
        np.max([*(0.5 * (low + high)), width - 0.5 * (low[0] + high[0]), height - 0.5 * (low[1] + high[1])])
    )
    reach = min(max(reach, 0.0), 2.0 * float((high - low).max()))
    found = align(template.esm, image, start, EsmSettings(search_px=reach))
    enough = settings.ncc_nearby if template.tag_id is None else settings.ncc_nearby_tag
    if not (found.valid and found.ncc >= enough and _is_sane(found.homography, template)):
        return {}
    return {template.name: Detection(template.name, found.homography, 0)}


def _tagless(
    templates: tuple[Template, ...],
    image: np.ndarray,
    settings: DetectorSettings,
    seed: int,
    side: int,
    features: int,
) -> dict[str, Detection]:
    """Detect images by SIFT, ratio test and robust homography."""
    import cv2

    scale = min(1.0, side / max(image.shape))
    if scale < 1:
        size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    points, descriptors = cv2.SIFT.create(features).detectAndCompute(image, None)
    result: dict[str, Detection] = {}
    if descriptors is None or len(descriptors) < 2:
        return result
    # Pixel centres: the centre of the first small pixel is at (1/scale - 1)/2 of the large image.
    place = (np.array([point.pt for point in points]) + 0.5) / scale - 0.5
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    for template in templates:
        pairs = matcher.knnMatch(template.descriptors, descriptors, k=2)
        good = [
            best for best, second in (pair for pair in pairs if len(pair) == 2)
            if best.distance < settings.ratio * second.distance
        ]  # fmt: skip
        if len(good) < settings.min_matches:
            continue
        source = template.keypoints[[match.queryIdx for match in good]]
        target = place[[match.trainIdx for match in good]]
        robust = estimate_homography_robust(
            source,
            target,
            threshold=settings.threshold_px / scale,
            minimum=settings.min_matches,
            seed=seed,
        )
        if not robust.valid or not is_proper(robust.matrix, template.esm.corners):
            continue
        # Inliers must be at different positions: repeated ones are no evidence.
        different = len(np.unique(np.round(source[robust.inliers] / 4), axis=0))
        if different >= settings.min_matches and _is_sane(robust.matrix, template):
            result[template.name] = Detection(template.name, robust.matrix, int(robust.inliers.sum()))
    return result


def _is_sane(homography: np.ndarray, template: Template) -> bool:
    """Whether the quadrilateral has a trackable size, and no side is ten times another."""
    corners = apply_homography(homography, template.esm.corners)
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    reference = np.linalg.norm(np.roll(template.esm.corners, -1, axis=0) - template.esm.corners, axis=1)
    ratio = sides / reference
    return bool(ratio.min() > 0.05 and ratio.max() < 10 * ratio.min())
