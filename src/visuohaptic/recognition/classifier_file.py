"""A trained classifier on disk: the tree as JSON, and beside it the training objects as NPZ."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import InputError
from ..core.files import write_text
from .data.data_set import FeatureSet, load_feature_set, save_feature_set
from .touch.haptic_model import HapticModel, ModelSettings, calibrated, fit_model
from .trees.tree_file import load_tree, tree_mapping
from .trees.tree_nodes import ClassificationTree

__all__ = ["Classifier", "load_classifier", "save_classifier"]


@dataclass(frozen=True, slots=True, eq=False)
class Classifier:
    """Tree, training objects with the names of their own classes, and how sure to be."""

    tree: ClassificationTree
    data: FeatureSet
    groups: Mapping[str, Sequence[str]]  #: name -> classes that are answered by this name
    temperature: float = 1.0
    unknown_from: float = 0.5
    #: Temperature and threshold of "unknown" by stiffness alone, which says less; None: the same as with widths.
    plain: tuple[float, float] | None = None

    def model(self, *, use_width: bool = True, prior: Mapping[str, float] | None = None) -> HapticModel:
        """The Bayesian model of the same objects.

        Parameters
        ----------
        use_width
            Widths of the object count as evidence.
        prior
            Of vision, by answer; uniform by default.
        """
        settings = ModelSettings(use_width=use_width)
        fitted = fit_model(self.data, self.groups, settings=settings, prior=prior)
        with_width = self.temperature, self.unknown_from
        return calibrated(fitted, *(with_width if use_width or self.plain is None else self.plain))


def save_classifier(path: Path | str, found: Classifier) -> None:
    """Write the tree as JSON, and the training objects beside it as NPZ.

    Parameters
    ----------
    path
        With the suffix .json; the NPZ file has the same name.
    found
        Classifier.
    """
    path = Path(path)
    if path.suffix != ".json":
        raise InputError(path, f"found suffix {path.suffix!r}, expected .json")
    save_feature_set(path.with_suffix(".npz"), found.data)
    content = tree_mapping(found.tree) | {
        "groups": {name: list(members) for name, members in found.groups.items()},
        "temperature": found.temperature,
        "unknown_from": found.unknown_from,
        "plain": None if found.plain is None else list(found.plain),
    }
    write_text(path, json.dumps(content, indent=1) + "\n")


def load_classifier(path: Path | str) -> Classifier:
    """Read what :func:`save_classifier` wrote.

    Parameters
    ----------
    path
        JSON file of :func:`save_classifier`, with the NPZ file beside it.

    Raises
    ------
    InputError
        A file is missing or damaged, or the two do not belong together.
    """
    path = Path(path)
    tree = load_tree(path)
    data = load_feature_set(path.with_suffix(".npz"))
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        groups = {str(name): tuple(map(str, members)) for name, members in content["groups"].items()}
        temperature, unknown_from = float(content["temperature"]), float(content["unknown_from"])
        # Files of earlier versions do not have it.
        pair = content.get("plain")
        plain = None if pair is None else (float(pair[0]), float(pair[1]))
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise InputError(
            path, f"is not a classifier ({error})", remedy="create one with classify train"
        ) from error
    for warm, threshold in ((temperature, unknown_from), *([plain] if plain else [])):
        if not (0 < warm < 1e3 and 0 < threshold <= 1):
            raise InputError(path, f"found temperature {warm} and unknown_from {threshold}")
    named = {member: name for name, members in groups.items() for member in members}
    if not set(tree.classes) <= {named.get(label, label) for label in data.classes}:
        raise InputError(path.with_suffix(".npz"), "has other classes than the tree beside it")
    return Classifier(tree, data, groups, temperature, unknown_from, plain)
