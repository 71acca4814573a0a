"""Training data: stiffness features of many variants of each class (Alt 2016, Sec. 6.4.1).

Read from a folder of ``visuohaptic objects build``; stored as one small NPZ file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.errors import InputError
from ...core.files import atomic_path, load_json, read_npz
from .places import HEIGHTS
from .pose_error import pose_error_changes
from .readings import MAX_SIZE_m

#: Required arrays of the file of a feature set.
_ARRAYS = ("features", "width_m", "label", "name", "nonlinear")


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSet:
    """Features of n objects with their classes.

    Examples
    --------
    >>> features, width_m = np.full((3, 16, 4, 3), 5e3), np.full((3, 16, 2), 0.06)
    >>> objects = FeatureSet(features, width_m, ("cup", "cup", "bottle"), ("cup-1", "cup-2", "bottle-1"))
    >>> objects.classes, objects.take(np.array([0, 2])).name
    (('bottle', 'cup'), ('cup-1', 'bottle-1'))
    """

    features: Float[np.ndarray, "n 16 4 3"]  #: i, I [N/m] and II [1]
    width_m: Float[np.ndarray, "n 16 2"]  #: of the undeformed object, across x and across y
    label: tuple[str, ...]  #: class of each object
    name: tuple[str, ...]  #: of each object, unique
    nonlinear: bool = False  #: from curves under large deformation; otherwise I = i and II = 0
    height_m: Float[np.ndarray, "n"] | None = None  #: of each object; None if unknown
    #: Change of log i due to each of c pose errors, see :mod:`.pose_error`; None without maps of the objects.
    pose_errors: Float[np.ndarray, "n c 16 4"] | None = None

    def __post_init__(self) -> None:
        count = len(self.label)
        shapes = [(self.features, (count, HEIGHTS, 4, 3)), (self.width_m, (count, HEIGHTS, 2))]
        if self.height_m is not None:
            shapes.append((self.height_m, (count,)))
        if self.pose_errors is not None:
            copies = np.shape(self.pose_errors)[1] if np.ndim(self.pose_errors) == 4 else 1
            shapes.append((self.pose_errors, (count, max(copies, 1), HEIGHTS, 4)))
        for array, expected in shapes:
            if np.shape(array) != expected:
                raise InputError("FeatureSet", f"found shape {np.shape(array)}, expected {expected}")
        if (widest := np.max(self.width_m, initial=0.0)) > MAX_SIZE_m:
            raise InputError(
                "FeatureSet", f"found a width of {widest:g}, expected metres, up to {MAX_SIZE_m:g}", field="width_m",
                remedy="divide millimetres by 1000",
            )  # fmt: skip
        if len(self.name) != count or len(set(self.name)) < count:
            raise InputError("FeatureSet", "expected one name for each object, all different", field="name")

    def __len__(self) -> int:
        return len(self.label)

    @classmethod
    def of_stiffness(
        cls,
        stiffness_N_per_m: Float[np.ndarray, "n 16 4"],
        width_m: Float[np.ndarray, "n 16 2"],
        label: Sequence[str],
    ) -> FeatureSet:
        """Objects with linear stiffness only: I = i and II = 0.

        Parameters
        ----------
        stiffness_N_per_m
            At the 16 heights on the 4 sides [N/m].
        width_m
            Of the undeformed objects, across x and across y [m].
        label
            Class of each object; numbers become text.

        Raises
        ------
        InputError
            An object has no label, or the shape of another array, or widths are not in metres.
        """
        i = np.asarray(stiffness_N_per_m, dtype=float)
        classes = tuple(map(str, label))
        if len(classes) != len(i):
            said = f"found {len(classes)} labels of {len(i)} objects, expected one for each"
            raise InputError("FeatureSet", said, field="label")
        names = tuple(f"{name}-{k:05d}" for k, name in enumerate(classes))
        width = np.asarray(width_m, dtype=float)
        return cls(np.stack([i, i, np.zeros_like(i)], axis=-1), width, classes, names)

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the classes, sorted."""
        return tuple(sorted(set(self.label)))

    @property
    def number(self) -> Int[np.ndarray, "n"]:
        """Class of each object as an index of ``classes``."""
        place = {name: k for k, name in enumerate(self.classes)}
        return np.array([place[name] for name in self.label], dtype=np.int64)

    def take(self, chosen: Bool[np.ndarray, "n"] | Int[np.ndarray, "m"]) -> FeatureSet:
        """Subset of the objects.

        Parameters
        ----------
        chosen
            Mask of the objects, or their indices.
        """
        index = np.arange(len(self))[chosen]
        known = ("features", "width_m", "height_m", "pose_errors")
        arrays = {name: value[index] for name in known if (value := getattr(self, name)) is not None}
        label, name = (tuple(part[k] for k in index) for part in (self.label, self.name))
        return replace(self, **arrays, label=label, name=name)

    def of_classes(
        self, classes: Sequence[str], groups: Mapping[str, Sequence[str]] | None = None
    ) -> FeatureSet:
        """Objects of the current candidates: some of the classes, several of which may share one name.

        Parameters
        ----------
        classes
            Candidates: names of classes or of groups.
        groups
            Name of a group -> its classes; a group may have the name of one of its classes.

        Raises
        ------
        InputError
            A class does not exist.
        """
        groups = {} if groups is None else groups
        target: dict[str, str] = {}
        for wanted in classes:
            for member in groups.get(wanted, (wanted,)):
                if member not in self.label:
                    raise InputError(
                        "classes", f"found {member!r}, expected one of {', '.join(self.classes)}"
                    )
                target[member] = wanted
        if len(set(target.values())) < 2:
            raise InputError("classes", f"found {len(set(target.values()))} classes, expected at least 2")
        kept = self.take(np.array([name in target for name in self.label]))
        return replace(kept, label=tuple(target[name] for name in kept.label))


def join_feature_sets(parts: Sequence[FeatureSet]) -> FeatureSet:
    """Concatenate feature sets; if a name occurs twice, names are prefixed with the number of their set.

    Parameters
    ----------
    parts
        At least one set, all linear or all from curves. Heights are kept if all sets have them, and effects of pose
        errors if all have the same number of them.

    Raises
    ------
    InputError
        Linear features are mixed with features from curves.
    """
    if len({part.nonlinear for part in parts}) > 1:
        raise InputError(
            "feature sets",
            "found linear features and features from curves, expected one kind",
            field="nonlinear",
        )
    names = [name for part in parts for name in part.name]
    if len(set(names)) < len(names):
        names = [f"{k}/{name}" for k, part in enumerate(parts) for name in part.name]
    heights = [part.height_m for part in parts if part.height_m is not None]
    errors = [part.pose_errors for part in parts if part.pose_errors is not None]
    alike = len(errors) == len(parts) and len({one.shape[1] for one in errors}) == 1
    return FeatureSet(
        np.concatenate([part.features for part in parts]),
        np.concatenate([part.width_m for part in parts]),
        tuple(label for part in parts for label in part.label),
        tuple(names),
        parts[0].nonlinear,
        np.concatenate(heights) if len(heights) == len(parts) else None,
        np.concatenate(errors) if alike else None,
    )


def read_build(folder: Path | str, *, closed: bool = False, fill: float = 0.0) -> FeatureSet:
    """Features of all objects of an ``objects build`` folder, in one state of their contents.

    Objects whose state is not in the build, or with a stiffness that is not finite and positive, are an error:
    a classifier that silently omits objects gives wrong answers.

    Parameters
    ----------
    folder
        Folder of ``visuohaptic objects build``.
    closed
        State of the contents: airtight.
    fill
        Fraction of the volume of a closed container that is liquid.

    Raises
    ------
    InputError
        The folder has no build, the build does not contain the state, or a stiffness is not finite and positive.
    """
    folder = Path(folder)
    listed = _manifest(folder)
    features, widths, heights, labels, names, nonlinear = [], [], [], [], [], False
    pose_errors: list[np.ndarray] = []
    for number, entry in enumerate(listed):
        path = folder / entry["file"]
        data = read_npz(path, "a result of objects build", names=("states", "feature_points_m", "features"))
        states, points = data["states"], data["feature_points_m"]
        try:
            row = np.flatnonzero((states[:, 0] == closed) & (not closed or states[:, 1] == fill))
            values = data["features"][row[0]] if row.size else None
        except (ValueError, IndexError) as error:
            raise InputError(path, f"is not a result of objects build ({error})") from error
        mapped = ("vertices_m", "stiffness_N_per_m")
        surface = [data[key] for key in mapped] if set(mapped) <= set(data) else []
        if values is None:
            raise InputError(
                path,
                f"has no features of the state closed={closed}, fill={fill:g}",
                remedy="add it to the plan's states and build again",
            )
        if values.shape != (HEIGHTS, 4, 3) or points.shape != (HEIGHTS, 4, 3):
            raise InputError(path, f"found features of shape {values.shape}, expected {(HEIGHTS, 4, 3)}")
        if not (np.isfinite(values[..., 0]).all() and (values[..., 0] > 0).all()):
            raise InputError(path, "has stiffness that is not finite and positive", field="features")
        features.append(values)
        # Linear elasticity has no quadratic coefficient.
        nonlinear = nonlinear or bool((np.nan_to_num(values[..., 2]) != 0).any())
        across_x = np.linalg.norm(points[:, 0, :2] - points[:, 1, :2], axis=1)
        across_y = np.linalg.norm(points[:, 2, :2] - points[:, 3, :2], axis=1)
        widths.append(np.stack([across_x, across_y], axis=1))
        # The places are the midpoints of equal intervals of the height.
        heights.append(float(np.ptp(points[:, 0, 2])) * HEIGHTS / (HEIGHTS - 1))
        labels.append(str(entry["class"]))
        names.append(Path(entry["file"]).stem)
        if surface:
            pose_errors.append(
                pose_error_changes(surface[0], surface[1], points, np.random.default_rng(number))
            )
    return FeatureSet(
        np.stack(features),
        np.stack(widths),
        tuple(labels),
        tuple(names),
        nonlinear,
        np.array(heights) if min(heights) > 0 else None,
        np.stack(pose_errors).astype(np.float32) if len(pose_errors) == len(listed) else None,
    )


def save_feature_set(path: Path | str, found: FeatureSet) -> None:
    """Write one NPZ file atomically.

    Parameters
    ----------
    path
        File to write.
    found
        Feature set.
    """
    # Half precision is sufficient: its error is a thousandth of values that are samples of an error.
    extra: dict[str, Any] = {} if found.height_m is None else {"height_m": np.asarray(found.height_m, float)}
    if found.pose_errors is not None:
        extra["pose_errors"] = np.asarray(found.pose_errors, np.float16)
    with atomic_path(path) as temporary:
        np.savez_compressed(
            temporary,
            features=np.asarray(found.features, dtype=float),
            width_m=np.asarray(found.width_m, dtype=float),
            label=np.array(found.label),
            name=np.array(found.name),
            nonlinear=np.array(found.nonlinear),
            **extra,
        )


def load_feature_set(source: Path | str) -> FeatureSet:
    """Read the NPZ file of :func:`save_feature_set`, or the folder of a build.

    Parameters
    ----------
    source
        NPZ file, or folder of a build.

    Raises
    ------
    InputError
        The file does not exist, or is not a feature set.
    """
    path = Path(source)
    if path.is_dir():
        return read_build(path)
    remedy = "make one with classify train"
    data = read_npz(path, "a feature set", names=_ARRAYS, remedy=remedy)
    try:
        found = FeatureSet(
            data["features"],
            data["width_m"],
            tuple(str(text) for text in data["label"]),
            tuple(str(text) for text in data["name"]),
            bool(data["nonlinear"]),
            data.get("height_m"),
            data["pose_errors"].astype(np.float32) if "pose_errors" in data else None,
        )
    except InputError as error:
        raise InputError(path, error.problem, field=error.field, remedy=error.remedy) from error
    except (TypeError, ValueError) as error:
        raise InputError(path, f"is not a feature set ({error})", remedy=remedy) from error
    numbers = {"features": found.features[..., 0], "width_m": found.width_m, "height_m": found.height_m}
    for name, value in (numbers | {"pose_errors": found.pose_errors}).items():
        if value is not None and not np.isfinite(value).all():
            raise InputError(path, "has numbers that are not finite", field=name)
        if name != "pose_errors" and value is not None and not (value > 0).all():
            raise InputError(path, "has numbers that are not positive", field=name)
    return found


def _manifest(folder: Path) -> list[dict[str, str]]:
    path, remedy = folder / "manifest.json", "run visuohaptic objects build first"
    if folder.is_dir() and not path.exists():
        raise InputError(folder, f"has no {path.name}", remedy=remedy)
    found = load_json(
        path,
        "a manifest of objects build",
        lambda data: [{key: str(entry[key]) for key in ("file", "class")} for entry in data["objects"]],
        remedy=remedy,
    )
    if not found:
        raise InputError(path, "lists no objects")
    for entry in found:
        if Path(entry["file"]).is_absolute() or ".." in Path(entry["file"]).parts:
            raise InputError(path, f"found {entry['file']!r}, expected a file inside the folder")
    return found
