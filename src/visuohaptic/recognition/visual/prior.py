"""What an object may be, by sight: candidates with probabilities, before any touch.

Alt 2016, Sec. 6.3.3: vision narrows the choice, touch decides. The answer is therefore a set of haptic models
with probabilities, which sum to 1 together with that of "unknown"; objects that look alike stay together in it.

With the prior pi_i of object i, the number n of agreeing matches of its best picture, and the residual r of its
shape on the cloud, the odds against an object that is not stored are

    pi_i / pi_unknown * ((1 + n) / (1 + n_0)) ** a * (r_0 / r) ** b * prod_w P(w | i) / P(w)

over the words w of the scene's context; without agreeing matches, exp(-c) stands for the first power: blur and
cover take all matches at once, so that none is no smaller number of the same kind. The second power is at least
exp(-d): now and then ICP fails on the right object. The exponents a, b, the neutral points n_0, r_0, c and d are fitted on examples by their log loss (:func:`calibrate_prior`), so that probabilities mean
what they say. Evidence that is
not there, as no picture of an object, leaves its odds as they are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from ...core.errors import InputError
from ...core.files import decode_image
from ...core.objects import VisuoHapticObject
from ..touch.haptic_model import UNKNOWN
from .shape import ShapeViews, describe_cloud, fit_shape, shape_views
from .visual_words import (
    LocalFeatures,
    WordIndex,
    agreeing_matches,
    find_features,
    nearest_words,
    train_vocabulary,
)

__all__ = ["Candidate", "Example", "PriorSettings", "VisualPrior", "calibrate_prior", "model_probabilities"]


@dataclass(frozen=True, slots=True)
class PriorSettings:
    """Effort, and what evidence is worth; the latter from :func:`calibrate_prior`."""

    features: int = 300  #: local features of a picture, at most
    words: int = 4096  #: of the vocabulary, at most
    pictures_checked: int = 20  #: the best by words, whose geometry is checked
    shapes_checked: int = 12  #: the best by descriptor, that ICP is tried on
    views_checked: int = 2  #: of each of these
    unknown_prior: float = 0.1  #: probability that an object is not stored, before anything is seen
    matches_exponent: float = 7.0  #: a
    matches_neutral: float = 4.7  #: n_0; fewer than 6 matches are counted as none
    none_against: float = 2.2  #: c
    residual_exponent: float = 6.0  #: b
    residual_neutral_m: float = 0.002  #: r_0
    misfit_against: float = 14.0  #: d; how often a fit fails is known from examples only
    most_evidence: float = 14.0  #: of picture or shape alone, either way; logarithm of odds
    context_weight: float = 2.0  #: sightings that the average of all objects counts for


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """What a seen object may be."""

    object_id: str  #: or :data:`UNKNOWN`
    probability: float
    models: tuple[str, ...] = ()  #: haptic models that look like this; none for unknown
    matches: int = 0  #: features that agree with its best picture
    residual_m: float = float("nan")  #: of its shape on the cloud; NaN where it was not tried
    T_cloud_object: Float[np.ndarray, "4 4"] | None = None  #: pose of its shape; none where not tried


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """Something seen, and what it is, to calibrate with."""

    truth: str  #: id, or :data:`UNKNOWN`
    image: UInt8[np.ndarray, "height width *colours"] | None = None
    cloud: Float[np.ndarray, "n 3"] | None = None
    context: tuple[str, ...] = ()


@dataclass(slots=True, eq=False)
class Entry:
    """What is stored of one object."""

    models: tuple[str, ...]
    pictures: list[LocalFeatures] = field(default_factory=list)
    words: list[Int[np.ndarray, "_"]] = field(default_factory=list)  #: of the first of the pictures
    shape: ShapeViews | None = None
    context: Counter[str] = field(default_factory=Counter)  #: how often it was seen beside which word
    sightings: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class _Evidence:
    """What one look says, before it is weighed; one value for each stored object."""

    log_prior: Float[np.ndarray, "objects"]  #: with the context; without the share of unknown
    log_matches: Float[np.ndarray, "objects"]  #: log(1 + n); NaN for no evidence
    matches_weight: float  #: 0..1, small where the picture has little to match
    log_residual: Float[np.ndarray, "objects"]  #: log(r / m); NaN for no evidence
    poses: Mapping[int, Float[np.ndarray, "4 4"]]


class VisualPrior:
    """Objects by sight; see the top of this module.

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
        self.settings = settings or PriorSettings()
        self.entries: dict[str, Entry] = {}
        self._centres = np.zeros((0, 128), np.float32)
        self._trained_on = 0
        self._pictures: tuple[WordIndex, Int[np.ndarray, "_"], Int[np.ndarray, "_"]] | None = None
        self._views: tuple[Float[np.ndarray, "_ d"], Int[np.ndarray, "_"], Int[np.ndarray, "_"]] | None = None

    @classmethod
    def of_objects(
        cls, objects: Iterable[VisuoHapticObject], settings: PriorSettings | None = None
    ) -> VisualPrior:
        """From a database: meshes give shapes, pictures of faces features, last places context."""
        prior = cls(settings)
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
        """Store an object, or more of one that is known.

        Parameters
        ----------
        object_id
            What candidates are called by; an object or a visual class.
        images
            Pictures, best of single faces without much around.
        cloud
            Points spread evenly over the surface, in the object's frame [m]; replaces an earlier one.
        context
            Words of the place where it was seen, as ("kitchen", "sink"); each call counts as one sighting.
        models
            Haptic models that look like this; by default the one of this name.
        """
        if not object_id or object_id == UNKNOWN:
            raise InputError("object_id", f"found {object_id!r}, expected the name of an object")
        found = [find_features(image, most=self.settings.features) for image in images]
        shape = None if cloud is None else shape_views(cloud)
        entry = self.entries.setdefault(object_id, Entry(()))
        entry.models = tuple(dict.fromkeys([*entry.models, *models])) or (object_id,)
        entry.pictures += [features for features in found if len(features)]
        entry.shape = entry.shape if shape is None else shape
        if context:
            entry.context.update(set(context))
            entry.sightings += 1
        self.forget_indexes()

    def add_object(self, obj: VisuoHapticObject, *, points: int = 3000) -> None:
        """Store what the database knows of the looks of an object."""
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
            cloud = mesh.sampled(points, np.random.default_rng(0))[0]
        self.add(obj.id, images=images, cloud=cloud, context=obj.seen.context if obj.seen else ())

    def candidates(
        self,
        image: UInt8[np.ndarray, "height width *colours"] | None = None,
        cloud: Float[np.ndarray, "n 3"] | None = None,
        context: Sequence[str] = (),
        *,
        least: float = 0.01,
    ) -> tuple[Candidate, ...]:
        """What is seen may be these, the most probable first; "unknown" is always among them.

        Parameters
        ----------
        image
            Of the object, with whatever is around it.
        cloud
            Points of the object alone, from one side and in any frame [m].
        context
            Words of the place; those that were never stored say nothing.
        least
            Less probable ones are left out.
        """
        evidence = self._look(image, cloud, context)
        probability = _probabilities(evidence, self.settings)
        names = list(self.entries)
        order = np.argsort(-probability, kind="stable")
        found = []
        for i in (int(i) for i in order):
            if i == len(names):
                found.append(Candidate(UNKNOWN, float(probability[i])))
            elif probability[i] >= least:
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

    def forget_indexes(self) -> None:
        """Build what is searched anew at the next question: the entries have changed."""
        self._pictures = self._views = None

    # ---- inside

    def _look(self, image: np.ndarray | None, cloud: np.ndarray | None, context: Sequence[str]) -> _Evidence:
        features = None if image is None else find_features(image, most=self.settings.features)
        matches, weight = self._matches(features)
        residual, poses = self._residuals(cloud)
        return _Evidence(self._log_prior(context), matches, weight, residual, poses)

    def _log_prior(self, context: Sequence[str]) -> Float[np.ndarray, "objects"]:
        """Logarithm of 1 / N, and for each word of the ratio of its shares, smoothed towards the average."""
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
        index, owner, number = self._picture_index()
        if len(index) == 0:
            return out, 0.0
        out[owner] = 0.0
        entries = list(self.entries.values())
        score = index.scores(seen.descriptors)
        for place in np.argsort(-score, kind="stable")[: self.settings.pictures_checked]:
            if score[place] <= 0:
                break
            i = int(owner[place])
            agreeing = agreeing_matches(entries[i].pictures[number[place]], seen)
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
                break  # from here on there are none
            views = np.flatnonzero(owner == i)
            views = views[np.argsort(distance[views], kind="stable")[: self.settings.views_checked]]
            fits = [fit_shape(shape, cloud, int(number[view])) for view in views]
            best = min(fits, key=lambda fit: fit.residual_m)
            out[i], poses[int(i)] = np.log(max(best.residual_m, 1e-5)), best.T_cloud_object
        # Those that were not tried look less like it than any that was.
        others = np.isfinite(nearest) & np.isnan(out)
        out[others] = max(float(np.nanmax(out)), np.log(2 * self.settings.residual_neutral_m))
        return out, poses

    def _picture_index(self) -> tuple[WordIndex, np.ndarray, np.ndarray]:
        if self._pictures is None:
            entries = list(self.entries.values())
            total = sum(len(one) for entry in entries for one in entry.pictures)
            if total and total >= 2 * self._trained_on:
                everything = np.concatenate([one.descriptors for entry in entries for one in entry.pictures])
                words = max(1, min(self.settings.words, total // 8))
                self._centres = train_vocabulary(everything, words, np.random.default_rng(0))
                self._trained_on = total
                for entry in entries:
                    entry.words = []
            for entry in entries:
                for one in entry.pictures[len(entry.words) :]:
                    entry.words.append(nearest_words(one.descriptors, self._centres))
            owner = np.repeat(np.arange(len(entries)), [len(entry.pictures) for entry in entries])
            number = np.array([k for entry in entries for k in range(len(entry.pictures))], dtype=np.int64)
            index = WordIndex(self._centres, [one for entry in entries for one in entry.words])
            self._pictures = index, owner, number
        return self._pictures

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
    """Probabilities of haptic models, as a prior for touch; models of one candidate share evenly."""
    out: dict[str, float] = {}
    for one in candidates:
        for model in one.models or (one.object_id,):
            out[model] = out.get(model, 0.0) + one.probability / max(len(one.models), 1)
    return out


def calibrate_prior(prior: VisualPrior, examples: Sequence[Example]) -> PriorSettings:
    """What evidence is worth, by the smallest mean log loss of the examples; set it as ``prior.settings``.

    Parameters
    ----------
    prior
        With the objects of the examples.
    examples
        Looks that were not stored themselves, with unknown objects among them in about the share that is
        expected later: it becomes the prior of unknown. Only the worth of evidence that occurs in them is
        changed.
    """
    names = [*prior.entries, UNKNOWN]
    for one in examples:
        if one.truth not in names:
            raise InputError(
                "examples",
                f"found the truth {one.truth!r}, which is not stored",
                remedy=f"call it {UNKNOWN!r}",
            )
    if len(examples) < 10:
        raise InputError("examples", f"found {len(examples)}, expected 10 or more")
    looks = [prior._look(one.image, one.cloud, one.context) for one in examples]
    truth = [names.index(one.truth) for one in examples]
    with_image = any(np.isfinite(look.log_matches).any() for look in looks)
    with_shape = any(np.isfinite(look.log_residual).any() for look in looks)
    unknowns = sum(one.truth == UNKNOWN for one in examples)
    old = replace(prior.settings, unknown_prior=(unknowns + 1) / (len(examples) + 2))
    if with_shape:
        # From 14 on nothing is ever cut off, and the search would not find the way down.
        old = replace(old, misfit_against=min(old.misfit_against, 3.0))
    names_free = ["matches_exponent", "matches_neutral", "none_against"] * with_image
    names_free += ["residual_exponent", "residual_neutral_m", "misfit_against"] * with_shape
    if not names_free:
        raise InputError("examples", "found no picture and no cloud that says anything")

    def settings(logs: np.ndarray) -> PriorSettings:
        changes: dict[str, Any] = {n: float(np.exp(x)) for n, x in zip(names_free, logs, strict=True)}
        return replace(old, **changes)

    def loss(logs: np.ndarray) -> float:
        now = settings(logs)
        fractions = [_probabilities(look, now)[i] for look, i in zip(looks, truth, strict=True)]
        # The most probable values, where each is expected within a factor of e of where it starts:
        # a few examples must not make evidence worth anything.
        pull = 0.5 * float(np.sum((logs - start) ** 2)) / len(looks)
        return float(-np.mean(np.log(np.maximum(fractions, 1e-9)))) + pull

    from scipy.optimize import minimize

    start = np.log([getattr(old, name) for name in names_free])
    found = minimize(loss, start, method="Nelder-Mead", options={"maxfev": 400, "xatol": 0.01, "fatol": 1e-5})
    return settings(found.x)


def _probabilities(evidence: _Evidence, settings: PriorSettings) -> Float[np.ndarray, "objects_and_unknown"]:
    """Of each stored object and, last, of unknown."""
    most = settings.most_evidence
    picture = settings.matches_exponent * (evidence.log_matches - np.log1p(settings.matches_neutral))
    picture = np.where(evidence.log_matches == 0, -settings.none_against, picture)
    picture = np.where(picture < 0, evidence.matches_weight * picture, picture)
    shape = settings.residual_exponent * (np.log(settings.residual_neutral_m) - evidence.log_residual)
    shape = np.maximum(shape, -settings.misfit_against)
    odds = evidence.log_prior + np.log1p(-settings.unknown_prior)
    for part in (picture, shape):
        odds = odds + np.clip(np.nan_to_num(part, nan=0.0), -most, most)
    score = np.append(odds, np.log(settings.unknown_prior))
    score = np.exp(score - score.max())
    return np.asarray(score / score.sum())
