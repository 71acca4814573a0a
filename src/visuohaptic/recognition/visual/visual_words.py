"""Bag of visual words: quantised local features in an inverted index, with geometric verification.

Alt 2016, Sec. 2.3.5 and 6.3.3. SIFT descriptors are compared by the Hellinger kernel (RootSIFT), their words
come from k-means on the stored images, and images are retrieved by the cosine of tf-idf weights
(Sivic and Zisserman 2003). Words have no position: the best images are therefore matched feature by
feature, and only matches that are consistent with one homography count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from ...core.errors import InputError
from ...tracking.points.homography import estimate_homography_robust
from ...tracking.templates.alignment.warp import is_proper

#: Larger images are resized to this side [px]: finer detail is not repeatable from other viewpoints.
SIDE_PX = 800
#: Quantisation steps per unit: RootSIFT values are at most about one half and fit into a byte.
_BYTE_STEPS = 510.0
#: Maximum number of descriptors for the training of a vocabulary.
_TRAINING = 60_000
#: Iterations of Lloyd's algorithm.
_ROUNDS = 6
#: Ratio of nearest to second-nearest distance above which a match is ambiguous; maximum distance of an inlier from a
#: homography [px]; minimum number of significant matches.
RATIO, AGREES_px, MINIMUM = 0.8, 5.0, 6


@dataclass(frozen=True, slots=True, eq=False)
class LocalFeatures:
    """Features of one image."""

    points_px: Float32[np.ndarray, "k 2"]  #: in the original image
    descriptors: UInt8[np.ndarray, "k 128"]  #: RootSIFT

    def __len__(self) -> int:
        return len(self.points_px)


def find_features(
    image: UInt8[np.ndarray, "height width *colours"], *, max_features: int = 300
) -> LocalFeatures:
    """The strongest SIFT features of a grey or colour image.

    Parameters
    ----------
    image
        8 bits; colours are averaged.
    max_features
        Maximum number of features.
    """
    import cv2

    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise InputError(
            "image",
            f"found {image.dtype} {image.shape}, expected uint8 (rows, columns) or (rows, columns, 3)",
        )
    grey = image if image.ndim == 2 else image.mean(axis=2).astype(np.uint8)
    none = LocalFeatures(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8))
    if min(grey.shape) < 16:
        return none
    scale = min(1.0, SIDE_PX / max(grey.shape))
    if scale < 1:
        size = (max(round(grey.shape[1] * scale), 1), max(round(grey.shape[0] * scale), 1))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    points, found = cv2.SIFT.create(max_features).detectAndCompute(np.ascontiguousarray(grey), None)
    if found is None or len(found) == 0:
        return none
    # OpenCV keeps ties beyond the requested number.
    order = np.argsort([-point.response for point in points], kind="stable")[:max_features]
    places = (np.array([points[i].pt for i in order]) + 0.5) / scale - 0.5
    root = np.sqrt(found[order] / np.maximum(found[order].sum(axis=1, keepdims=True), 1e-12))
    return LocalFeatures(
        places.astype(np.float32), np.clip(np.rint(root * _BYTE_STEPS), 0, 255).astype(np.uint8)
    )


def train_vocabulary(
    descriptors: UInt8[np.ndarray, "n 128"], words: int, rng: np.random.Generator
) -> Float32[np.ndarray, "w 128"]:
    """Centres of at most ``words`` clusters of descriptors: k-means in two levels.

    A coarse k-means with about the square root of ``words`` clusters, then one inside each cluster with a fraction of the
    words proportional to its size: the effort grows with ``words ** 1.5`` instead of ``words ** 2``, and the
    subsequent assignment is to the nearest of all centres, so that only the training is approximate.

    Parameters
    ----------
    descriptors
        RootSIFT descriptors of the stored images.
    words
        Maximum number of centres.
    rng
        Source of the initial centres.
    """
    if words < 1 or len(descriptors) < 1:
        raise InputError("train_vocabulary", f"found {len(descriptors)} descriptors for {words} words")
    if len(descriptors) > _TRAINING:
        descriptors = descriptors[np.sort(rng.choice(len(descriptors), _TRAINING, replace=False))]
    data = descriptors.astype(np.float32)
    words = min(words, len(data))
    coarse = _k_means(data, max(round(words**0.5), 1), rng)
    group = nearest_words(data, coarse)
    centres = []
    for k in range(len(coarse)):
        members = data[group == k]
        if len(members):
            fraction = min(max(round(words * len(members) / len(data)), 1), len(members))
            centres.append(_k_means(members, fraction, rng))
    return np.concatenate(centres)


def nearest_words(descriptors: np.ndarray, centres: Float32[np.ndarray, "w 128"]) -> Int[np.ndarray, "n"]:
    """Index of the nearest centre of each descriptor.

    Parameters
    ----------
    descriptors
        RootSIFT descriptors.
    centres
        Vocabulary.
    """
    half = 0.5 * np.einsum("ij,ij->i", centres, centres)
    out = np.empty(len(descriptors), np.int64)
    for start in range(0, len(descriptors), 2048):
        part = descriptors[start : start + 2048].astype(np.float32)
        out[start : start + 2048] = np.argmax(part @ centres.T - half, axis=1)
    return out


def _k_means(
    data: Float32[np.ndarray, "n 128"], count: int, rng: np.random.Generator
) -> Float32[np.ndarray, "k 128"]:
    """Lloyd's algorithm from random members; a centre that loses all members is kept."""
    centres = data[np.sort(rng.choice(len(data), min(count, len(data)), replace=False))]
    for _ in range(_ROUNDS):
        label = nearest_words(data, centres)
        order = np.argsort(label, kind="stable")
        filled, first = np.unique(label[order], return_index=True)
        sums = np.add.reduceat(data[order], first, axis=0)
        centres = centres.copy()
        centres[filled] = sums / np.diff(np.append(first, len(data)))[:, None]
    return centres


class WordIndex:
    """Inverted index with tf-idf weights, for the retrieval of stored images that share rare words with a new image.

    Parameters
    ----------
    centres
        The vocabulary, of :func:`train_vocabulary`.
    images
        Words of each stored image, of :func:`nearest_words`.
    """

    def __init__(self, centres: Float32[np.ndarray, "w 128"], images: Sequence[Int[np.ndarray, "_"]]) -> None:
        self._centres = centres
        self._count = len(images)
        lengths = np.array([len(one) for one in images], dtype=np.int64)
        together = np.concatenate(list(images)) if len(images) else np.zeros(0, np.int64)
        place = np.repeat(np.arange(self._count), lengths) * len(centres) + together
        cells, times = np.unique(place, return_counts=True)
        document, word = cells // len(centres), cells % len(centres)
        self._rarity = np.log((1.0 + self._count) / (1.0 + np.bincount(word, minlength=len(centres))))
        # Square root of the count: the features of a repeated pattern are not independent.
        weight = np.sqrt(times) * self._rarity[word]
        length = np.sqrt(np.bincount(document, weight**2, minlength=self._count))
        weight = weight / np.maximum(length, 1e-12)[document]
        order = np.lexsort((document, word))
        self._starts = np.searchsorted(word[order], np.arange(len(centres) + 1))
        self._documents, self._weights = document[order], weight[order]

    def __len__(self) -> int:
        return self._count

    def scores(self, descriptors: UInt8[np.ndarray, "k 128"]) -> Float[np.ndarray, "images"]:
        """Cosine of the word weights of an image with each stored one, 0..1.

        Parameters
        ----------
        descriptors
            Of the new image.
        """
        out = np.zeros(self._count)
        if len(descriptors) == 0:
            return out
        words, times = np.unique(nearest_words(descriptors, self._centres), return_counts=True)
        weight = np.sqrt(times) * self._rarity[words]
        weight = weight / max(float(np.linalg.norm(weight)), 1e-12)
        for word, w in zip(words, weight, strict=True):
            part = slice(self._starts[word], self._starts[word + 1])
            out[self._documents[part]] += w * self._weights[part]
        return out


def agreeing_matches(stored: LocalFeatures, seen: LocalFeatures) -> int:
    """Number of matches consistent with one homography from the stored to the new image; 0 below :data:`MINIMUM`.

    The ratio of nearest to second-nearest distance is below :data:`RATIO` (Lowe; Alt 2016, Sec. 2.3.1 with the inequality
    reversed), and each new feature is used once. Matches at one place count once, as they are not independent.

    Parameters
    ----------
    stored, seen
        Features of a stored and of a new image.
    """
    if len(stored) < MINIMUM or len(seen) < MINIMUM:
        return 0
    a, b = stored.descriptors.astype(np.float32), seen.descriptors.astype(np.float32)
    squared = np.einsum("ij,ij->i", a, a)[:, None] + np.einsum("ij,ij->i", b, b)[None] - 2.0 * (a @ b.T)
    rows = np.arange(len(a))
    nearest = np.argmin(squared, axis=1)
    best = squared[rows, nearest]
    squared[rows, nearest] = np.inf
    good = np.flatnonzero(best < RATIO**2 * squared.min(axis=1))
    # The best stored feature of each seen one.
    good = good[np.argsort(best[good], kind="stable")]
    good = good[np.unique(nearest[good], return_index=True)[1]]
    if len(good) < MINIMUM:
        return 0
    source = stored.points_px[good].astype(np.float64)
    target = seen.points_px[nearest[good]].astype(np.float64)
    try:
        robust = estimate_homography_robust(source, target, threshold=AGREES_px, minimum=MINIMUM, seed=0)
    except InputError:  # collinear points do not determine a homography
        return 0
    if not robust.valid:
        return 0
    agreeing = source[robust.inliers]
    low, high = agreeing.min(axis=0), agreeing.max(axis=0)
    frame = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    # A mirrored or folded image is not a view of a plane.
    if not (is_proper(robust.matrix, frame) or is_proper(-robust.matrix, frame)):
        return 0
    different = min(len(np.unique(np.round(side[robust.inliers] / 4), axis=0)) for side in (source, target))
    return int(different) if different >= MINIMUM else 0
