"""Visual prior: candidates of an object with probabilities, before any touch.

Alt 2016, Sec. 6.3.3: vision reduces the number of candidates, touch discriminates between them. The result is therefore a set
of haptic models with probabilities, which sum to 1 together with that of "unknown"; objects that look alike are all in it.
Combination of the evidence: :mod:`.prior_evidence`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int, UInt8

from ...core import InputError, VisuoHapticObject, decode_image
from ..touch.haptic_model import UNKNOWN
from .prior_evidence import PriorSettings, VisualEvidence, posterior
from .shape import ShapeViews, describe_cloud, fit_shape, shape_views
from .visual_words import (
    LocalFeatures,
    WordIndex,
    agreeing_matches,
    find_features,
    nearest_words,
    train_vocabulary,
)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Candidate of an observed object."""

    object_id: str  #: or :data:`UNKNOWN`
    probability: float
    models: tuple[str, ...] = ()  #: haptic models with this appearance; empty for unknown
    matches: int = 0  #: features that are consistent with its best image
    residual_m: float = float("nan")  #: of its shape to the cloud; NaN if not registered
    T_cloud_object: Float[np.ndarray, "4 4"] | None = None  #: pose of its shape; None if not registered


@dataclass(slots=True, eq=False)
class Entry:
    """Stored data of one object."""

    models: tuple[str, ...]
    images: list[LocalFeatures] = field(default_factory=list)
    words: list[Int[np.ndarray, "_"]] = field(default_factory=list)  #: of the quantised images
    shape: ShapeViews | None = None
    context: Counter[str] = field(default_factory=Counter)  #: word -> number of sightings with it
    sightings: int = 0


class VisualPrior:
    """Visual recognition of stored objects; see the module docstring.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> ball = rng.normal(size=(2000, 3))
    >>> ball *= 0.04 / np.linalg.norm(ball, axis=1, keepdims=True)
    >>> prior = VisualPrior()
    >>> prior.add("ball", cloud=ball)
    >>> prior.add("egg", cloud=ball * [1.0, 1.0, 1.6])
    >>> best = prior.candidates(cloud=ball[ball[:, 0] > 0] + 0.5)[0]
    >>> best.object_id, best.probability > 0.8
    ('ball', True)
    """

    def __init__(self, settings: PriorSettings | None = None) -> None:
        """Create a prior without objects.


        Parameters
        ----------
        settings
            Computational effort, and weights of the evidence.
        """
        self.settings = settings or PriorSettings()
        self.entries: dict[str, Entry] = {}
        self._centres = np.zeros((0, 128), np.float32)
        self._trained_on = 0
        self._images: tuple[WordIndex, Int[np.ndarray, "_"], Int[np.ndarray, "_"]] | None = None
        self._views: tuple[Float[np.ndarray, "_ d"], Int[np.ndarray, "_"], Int[np.ndarray, "_"]] | None = None

    @classmethod
    def of_objects(cls, objects: Iterable[VisuoHapticObject]) -> VisualPrior:
        """Prior of the objects of a database: shapes from meshes, features from images of faces, context from last places.

        Parameters
        ----------
        objects
            Objects.
        """
        prior = cls()
        for obj in objects:
            prior.add_object(obj)
        return prior

    def __len__(self) -> int:
        return len(self.entries)

    def add(
        self,
        object_id: str,
        *,
        images: Iterable[UInt8[np.ndarray, "height width *colours"]] = (),
        cloud: Float[np.ndarray, "n 3"] | None = None,
        context: Sequence[str] = (),
        models: Sequence[str] = (),
    ) -> None:
        """Store an object, or add data to a stored one.

        Parameters
        ----------
        object_id
            Name of the candidate; an object or a visual class.
        images
            Images, ideally of single faces with little background.
        cloud
            Points spread evenly over the surface, in the object's frame [m]; replaces an earlier one.
        context
            Words of the place where it was seen, such as ("kitchen", "sink"); each call counts as one sighting.
        models
            Haptic models with this appearance; by default the one of this name.
        """
        if not object_id or object_id == UNKNOWN:
            raise InputError("object_id", f"found {object_id!r}, expected the name of an object")
        found = [find_features(image, max_features=self.settings.features) for image in images]
        shape = None if cloud is None else shape_views(cloud)
        entry = self.entries.setdefault(object_id, Entry(()))
        entry.models = tuple(dict.fromkeys([*entry.models, *models])) or (object_id,)
        entry.images += [features for features in found if len(features)]
        entry.shape = entry.shape if shape is None else shape
        if context:
            entry.context.update(set(context))
            entry.sightings += 1
        self._images = self._views = None  # built again when they are asked for

    def add_object(self, obj: VisuoHapticObject) -> None:
        """Store the appearance of an object of the database.

        Parameters
        ----------
        obj
            Object with a mesh, an image of a face, or the place where it was seen.
        """
        images, cloud = [], None
        if obj.appearance is not None and obj.appearance.template_png:
            where = f"{obj.id}: appearance.template_png"
            images.append(decode_image(obj.appearance.template_png, where, "grey", upright=True))
        shape = obj.geometry
        if (
            shape is not None
            and shape.vertices_m is not None
            and shape.faces is not None
            and len(shape.faces)
        ):
            from ...reconstruction.mesh import SurfaceMesh

            mesh = SurfaceMesh(shape.vertices_m, shape.faces)
            cloud = mesh.sampled(3000, np.random.default_rng(0))[0]
        self.add(obj.id, images=images, cloud=cloud, context=obj.seen.context if obj.seen else ())

    def candidates(
        self,
        image: UInt8[np.ndarray, "height width *colours"] | None = None,
        cloud: Float[np.ndarray, "n 3"] | None = None,
        context: Sequence[str] = (),
        *,
        min_probability: float = 0.01,
    ) -> tuple[Candidate, ...]:
        """Candidates of an observation, most probable first; "unknown" is always included.

        Parameters
        ----------
        image
            Of the object, possibly with background.
        cloud
            Points of the object alone, from one side and in any frame [m].
        context
            Words of the place; unknown words have no effect.
        min_probability
            Less probable candidates are left out.
        """
        evidence = self.evidence(image, cloud, context)
        probability = posterior(evidence, self.settings)
        names = list(self.entries)
        order = np.argsort(-probability, kind="stable")
        found = []
        for i in (int(i) for i in order):
            if i == len(names):
                found.append(Candidate(UNKNOWN, float(probability[i])))
            elif probability[i] >= min_probability:
                matches, residual = evidence.log_matches[i], evidence.log_residual[i]
                found.append(
                    Candidate(
                        names[i],
                        float(probability[i]),
                        self.entries[names[i]].models,
                        0 if np.isnan(matches) else round(float(np.expm1(matches))),
                        float(np.exp(residual)) if i in evidence.poses else float("nan"),
                        evidence.poses.get(i),
                    )
                )
        return tuple(found)

    def evidence(
        self,
        image: UInt8[np.ndarray, "height width *colours"] | None = None,
        cloud: Float[np.ndarray, "n 3"] | None = None,
        context: Sequence[str] = (),
    ) -> VisualEvidence:
        """Evidence of one observation for every stored object, before weighting.

        Parameters
        ----------
        image, cloud, context
            As for :meth:`candidates`.
        """
        features = None if image is None else find_features(image, max_features=self.settings.features)
        matches, weight = self._matches(features)
        residual, poses = self._residuals(cloud)
        return VisualEvidence(self._log_prior(context), matches, weight, residual, poses)

    def _log_prior(self, context: Sequence[str]) -> Float[np.ndarray, "objects"]:
        """Logarithm of 1 / N, and for each word of the ratio of its fractions, smoothed towards the average."""
        entries = list(self.entries.values())
        out = np.full(len(entries), -np.log(max(len(entries), 1)))
        sightings = np.array([entry.sightings for entry in entries], dtype=float)
        strength = self.settings.context_weight
        for word in sorted(set(context)):
            times = np.array([entry.context[word] for entry in entries], dtype=float)
            if times.sum() > 0:
                average = times.sum() / sightings.sum()
                out += np.log((times + strength * average) / (sightings + strength) / average)
        return out

    def _matches(self, seen: LocalFeatures | None) -> tuple[Float[np.ndarray, "objects"], float]:
        out = np.full(len(self.entries), np.nan)
        if seen is None or len(seen) == 0:
            return out, 0.0
        index, owner, number = self._image_index()
        if len(index) == 0:
            return out, 0.0
        out[owner] = 0.0
        entries = list(self.entries.values())
        score = index.scores(seen.descriptors)
        for place in np.argsort(-score, kind="stable")[: self.settings.images_checked]:
            if score[place] <= 0:
                break
            i = int(owner[place])
            agreeing = agreeing_matches(entries[i].images[number[place]], seen)
            out[i] = max(out[i], np.log1p(agreeing))
        return out, min(1.0, len(seen) / 50)

    def _residuals(
        self, cloud: np.ndarray | None
    ) -> tuple[Float[np.ndarray, "objects"], dict[int, Float[np.ndarray, "4 4"]]]:
        out = np.full(len(self.entries), np.nan)
        poses: dict[int, np.ndarray] = {}
        if cloud is None:
            return out, poses
        described = describe_cloud(cloud)
        descriptors, owner, number = self._view_index()
        if len(descriptors) == 0:
            return out, poses
        distance = np.linalg.norm(descriptors - described, axis=1)
        nearest = np.full(len(out), np.inf)
        np.minimum.at(nearest, owner, distance)
        entries = list(self.entries.values())
        for i in np.argsort(nearest, kind="stable")[: self.settings.shapes_checked]:
            shape = entries[i].shape
            if shape is None:
                break  # the remaining objects have no shape
            views = np.flatnonzero(owner == i)
            views = views[np.argsort(distance[views], kind="stable")[: self.settings.views_checked]]
            fits = [fit_shape(shape, cloud, int(number[view])) for view in views]
            best = min(fits, key=lambda fit: fit.residual_m)
            out[i], poses[int(i)] = np.log(max(best.residual_m, 1e-5)), best.T_cloud_object
        # Shapes that were not registered are less similar than those that were.
        others = np.isfinite(nearest) & np.isnan(out)
        out[others] = max(float(np.nanmax(out)), np.log(2 * self.settings.residual_neutral_m))
        return out, poses

    def _image_index(self) -> tuple[WordIndex, np.ndarray, np.ndarray]:
        if self._images is None:
            entries = list(self.entries.values())
            total = sum(len(one) for entry in entries for one in entry.images)
            if total and total >= 2 * self._trained_on:
                everything = np.concatenate([one.descriptors for entry in entries for one in entry.images])
                words = max(1, min(self.settings.words, total // 8))
                self._centres = train_vocabulary(everything, words, np.random.default_rng(0))
                self._trained_on = total
                for entry in entries:
                    entry.words = []
            for entry in entries:
                for one in entry.images[len(entry.words) :]:
                    entry.words.append(nearest_words(one.descriptors, self._centres))
            owner = np.repeat(np.arange(len(entries)), [len(entry.images) for entry in entries])
            number = np.array([k for entry in entries for k in range(len(entry.images))], dtype=np.int64)
            index = WordIndex(self._centres, [one for entry in entries for one in entry.words])
            self._images = index, owner, number
        return self._images

    def _view_index(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self._views is None:
            shapes = [(i, entry.shape) for i, entry in enumerate(self.entries.values()) if entry.shape]
            counts = [len(shape.descriptors) for _, shape in shapes]
            self._views = (
                np.concatenate([shape.descriptors for _, shape in shapes]) if shapes else np.zeros((0, 1)),
                np.repeat(np.array([i for i, _ in shapes], dtype=np.int64), counts),
                np.array([k for count in counts for k in range(count)], dtype=np.int64),
            )
        return self._views


def model_probabilities(candidates: Iterable[Candidate]) -> dict[str, float]:
    """Probabilities of haptic models, as a prior for touch; models of one candidate are equally probable.

    Parameters
    ----------
    candidates
        Of :meth:`VisualPrior.candidates`.
    """
    out: dict[str, float] = {}
    for one in candidates:
        for model in one.models or (one.object_id,):
            out[model] = out.get(model, 0.0) + one.probability / max(len(one.models), 1)
    return out
