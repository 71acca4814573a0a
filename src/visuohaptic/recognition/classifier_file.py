"""File of a trained classifier: tree and curves as JSON, and the training objects in an NPZ file next to it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from ..core import InputError, from_dict, to_dict
from ..core.files import check_target, load_json, write_text
from .data import FeatureSet, SqueezedObject, TouchProtocol, load_feature_set, save_feature_set
from .touch import HapticModel, ModelSettings, class_statistics, fit_model, learn_from_curves, with_prior
from .trees import ClassificationTree, load_tree, tree_mapping

#: Temperature, log odds, tail and correlation of a :class:`.HapticModel`.
Calibration = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Classifier:
    """Trained classifier: training objects with their class names, squeezed objects, a tree, and the calibration."""

    groups: Mapping[str, Sequence[str]]  #: name -> classes that share this name as their answer
    tree: ClassificationTree | None = None  #: of the training objects
    data: FeatureSet | None = None  #: training objects with complete features
    squeezed: tuple[SqueezedObject, ...] = ()  #: training objects with measured curves
    #: With widths, and with stiffness alone, which is less informative.
    calibration: tuple[Calibration, Calibration] = ((1.0, 0.0, 1.0, 0.0), (1.0, 0.0, 1.0, 0.0))
    #: Cache of fitted models: use of widths -> model.
    fitted: dict[bool, HapticModel] = field(default_factory=dict, repr=False)

    def model(self, *, use_width: bool = True, prior: Mapping[str, float] | None = None) -> HapticModel:
        """The Bayesian model of the same objects.

        Parameters
        ----------
        use_width
            Whether widths of the object are evidence.
        prior
            Visual prior by answer; uniform by default.
        """
        if use_width not in self.fitted:
            warm, odds, tail, common = self.calibration[0 if use_width else 1]
            self.fitted[use_width] = replace(
                self._learn(ModelSettings(use_width=use_width)),
                temperature=warm,
                unknown_log_odds=odds,
                tail=tail,
                # Real readings of the classes contain the errors of their simulation.
                correlation=0.0 if self.squeezed else common,
            )
        return with_prior(self.fitted[use_width], prior)

    def required_tree(self) -> ClassificationTree:
        """The tree.

        Raises
        ------
        InputError
            The classifier was trained with curves only.
        """
        if self.tree is None:
            raise InputError(
                "classifier", "has no tree: it was trained by curves alone", remedy="use classify run"
            )
        return self.tree

    def _learn(self, settings: ModelSettings) -> HapticModel:
        if not self.squeezed:
            assert self.data is not None  # a classifier has objects or curves
            return fit_model(self.data, self.groups, settings=settings)
        known = None if self.data is None else class_statistics(self.data, settings, TouchProtocol())
        return learn_from_curves(self.squeezed, known, self.groups, settings=settings)


@dataclass(frozen=True, slots=True, eq=False)
class _Card:
    """Contents of the JSON file besides the tree."""

    groups: dict[str, tuple[str, ...]]
    calibration: tuple[Calibration, Calibration]
    objects: bool  #: whether there are training objects with complete features
    squeezed: tuple[SqueezedObject, ...]


def save_classifier(path: Path | str, found: Classifier) -> None:
    """Write tree and curves as JSON, and the training objects to an NPZ file next to it.

    Parameters
    ----------
    path
        Path with the suffix .json; the NPZ file has the same name.
    found
        Classifier.
    """
    path = check_target(path, (".json",))
    if found.data is not None:
        save_feature_set(path.with_suffix(".npz"), found.data)
    card = _Card(
        {name: tuple(members) for name, members in found.groups.items()},
        found.calibration,
        found.data is not None,
        found.squeezed,
    )
    content = ({} if found.tree is None else tree_mapping(found.tree)) | to_dict(card)
    write_text(path, json.dumps(content, indent=1) + "\n")


def load_classifier(path: Path | str) -> Classifier:
    """Read a classifier written by :func:`save_classifier`.

    Parameters
    ----------
    path
        JSON file of :func:`save_classifier`, with the NPZ file next to it.

    Raises
    ------
    InputError
        A file is missing or damaged, or the two files do not match.
    """
    path = Path(path)

    names, remedy = [field.name for field in fields(_Card)], "create one with classify train"

    def parsed(content: Any) -> _Card:
        try:
            return from_dict(_Card, {name: content[name] for name in names}, where=path)
        except InputError as error:
            raise InputError(path, error.problem, field=error.field, remedy=remedy) from error

    card = load_json(path, "a classifier", parsed, remedy=remedy)
    for warm, odds, tail, common in card.calibration:
        if not (0 < warm < 1e3 and abs(odds) < 1e3 and 0 < tail < 1e3 and 0 <= common <= 1):
            problem = f"found temperature {warm}, log odds {odds}, tail {tail} and correlation {common}"
            raise InputError(path, problem, field="calibration")
    found = Classifier(card.groups, squeezed=card.squeezed, calibration=card.calibration)
    if card.squeezed and not card.objects:
        return found
    tree = load_tree(path)
    data = load_feature_set(path.with_suffix(".npz"))
    named = {member: name for name, members in found.groups.items() for member in members}
    if not set(tree.classes) <= {named.get(label, label) for label in data.classes}:
        raise InputError(path.with_suffix(".npz"), "has other classes than its tree")
    return replace(found, tree=tree, data=data)
