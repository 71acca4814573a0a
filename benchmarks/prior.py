"""The visual prior: is the true object among the candidates, are the probabilities calibrated, CPU time of a query.

    python -m benchmarks prior

The variable ``PRIOR_OBJECTS`` (default 1000, the campaign 10000) is the number of objects for the time of a query.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from visuohaptic.recognition.touch import UNKNOWN
from visuohaptic.recognition.visual import LocalFeatures, ShapeViews, VisualPrior
from visuohaptic.recognition.visual.prior import Entry

from . import harness
from ._forecasts import calibration_error
from ._prior_calibration import Example, calibrate_prior
from ._prior_world import containers, label, scene_with, seen_cloud


def run() -> list[dict[str, Any]]:
    """All rows."""
    return shapes() + pictures() + times(int(os.environ.get("PRIOR_OBJECTS", "1000")))


def shapes(variants: int = 6, looks: int = 160, seed: int = 3) -> list[dict[str, Any]]:
    """Containers by their point clouds; cups of both kinds are unknown.

    A cup with a rim beside stored cups would be no test: a rim is what sight cannot tell and touch is for.
    """
    rng = np.random.default_rng(seed)
    things = containers(variants)
    unknown = ("cup", "cup-rim")
    prior = VisualPrior()
    for name, mesh in things.items():
        if name.split("/")[0] not in unknown:
            prior.add(name, cloud=mesh.sampled(3000, rng)[0])

    def look() -> Example:
        strange = rng.random() < 0.2
        some = [name for name in things if (name.split("/")[0] in unknown) == strange]
        name = some[rng.integers(len(some))]
        return Example(UNKNOWN if strange else name, cloud=seen_cloud(things[name], rng))

    rows = _judged("shape", prior, [look() for _ in range(looks)], lambda one: one.split("/")[0])
    note = f"{len(prior)} containers of 7 classes, one side seen with 1.5 mm noise and holes, 1/5 unknown"
    return [{**row, "note": note} for row in rows]


def pictures(count: int = 150, looks: int = 600, seed: int = 4) -> list[dict[str, Any]]:
    """Labels in scenes; some are unknown."""
    rng = np.random.default_rng(seed)
    prior = VisualPrior()
    for number in range(count):
        prior.add(f"label {number}", images=[label(number)])

    def look() -> Example:
        strange = rng.random() < 0.2
        number = int(rng.integers(count, 2 * count) if strange else rng.integers(count))
        scene = scene_with(label(number), rng, hardness=float(rng.uniform(0.5, 1.8)))
        return Example(UNKNOWN if strange else f"label {number}", image=scene)

    rows = _judged("picture", prior, [look() for _ in range(looks)], lambda one: one)
    note = f"{count} drawn labels, tilted, blurred and half covered in scenes, 1/5 unknown"
    return [{**row, "note": note} for row in rows]


def times(count: int, seed: int = 5) -> list[dict[str, Any]]:
    """One query against many objects: random features and views of realistic size."""
    rng = np.random.default_rng(seed)
    prior = VisualPrior()
    bank = np.concatenate([_features(number).descriptors for number in range(40)])
    views = _views(rng)
    for number in range(count):
        chosen = bank[rng.integers(0, len(bank), 150)].astype(int) + rng.integers(-25, 26, (150, 128))
        entry = Entry((f"o{number}",))
        places = rng.uniform(0, 300, (150, 2)).astype(np.float32)
        entry.images.append(LocalFeatures(places, np.clip(chosen, 0, 255).astype(np.uint8)))
        base = views[number % len(views)]
        moved = base.descriptors + rng.normal(0, 0.05, base.descriptors.shape).astype(np.float32)
        entry.shape = ShapeViews(base.points_m, base.directions, moved)
        prior.entries[f"o{number}"] = entry
    cloud = seen_cloud(containers(1, classes=("bottle",))["bottle/0"], rng)
    scene = scene_with(label(1), rng)
    began = time.process_time()
    prior.candidates(image=scene, cloud=cloud)
    first_s = time.process_time() - began
    note = f"{count} objects"
    return [
        {
            "name": f"{name} of {count} objects, CPU",
            "ours": harness.cpu_seconds(work, repeats=3) * 1e3,
            "unit": "ms",
            "higher_is_better": False,
            "note": note,
        }
        for name, work in (
            ("question with a picture", lambda: prior.candidates(image=scene)),
            ("question with a cloud", lambda: prior.candidates(cloud=cloud)),
        )
    ] + [
        {
            "name": f"building the indexes of {count} objects, CPU",
            "ours": first_s,
            "unit": "s",
            "higher_is_better": False,
            "note": note,
        }
    ]


def _features(number: int) -> LocalFeatures:
    from visuohaptic.recognition.visual import find_features

    return find_features(label(number))


def _views(rng: np.random.Generator) -> list[ShapeViews]:
    from visuohaptic.recognition.visual import shape_views

    return [shape_views(mesh.sampled(3000, rng)[0]) for mesh in containers(2).values()]


def _judged(
    kind: str, prior: VisualPrior, looks: list[Example], group: Callable[[str], str]
) -> list[dict[str, Any]]:
    """Calibrated on one half of the views, evaluated on the other."""
    half = len(looks) // 2
    prior.settings = calibrate_prior(prior, looks[:half])
    first, third, classes, listed, confidence, right, rejected = [], [], [], [], [], [], []
    kept = []
    for one in looks[half:]:
        found = prior.candidates(one.image, one.cloud, one.context, min_probability=0.0)
        names = [candidate.object_id for candidate in found]
        by_group: dict[str, float] = {}
        for candidate in found:
            name = group(candidate.object_id)
            by_group[name] = by_group.get(name, 0.0) + candidate.probability
        best = max(by_group, key=lambda name: by_group[name])
        confidence.append(by_group[best])
        right.append(best == group(one.truth))
        if one.truth == UNKNOWN:
            rejected.append(best == UNKNOWN)
            continue
        known = [name for name in names if name != UNKNOWN]
        first.append(known[0] == one.truth)
        third.append(one.truth in known[:3])
        classes.append(group(known[0]) == group(one.truth))
        kept.append(best != UNKNOWN)
        listed.append(next(c.probability for c in found if c.object_id == one.truth) >= 0.01)
    rows = {
        "top 1": (np.mean(first), 0.0),
        "top 3": (np.mean(third), 0.0),
        "class of top 1": (np.mean(classes), 0.0),
        "right one listed (probability >= 1 %)": (np.mean(listed), 0.0),
        "known and not called unknown": (np.mean(kept), 0.95),
        "unknown and called so": (np.mean(rejected), 0.9),
    }
    out = [
        {"name": f"{kind}: {name}", "ours": float(value), "unit": "1", "higher_is_better": True}
        | ({"floor": floor} if floor else {})
        for name, (value, floor) in rows.items()
    ]
    error = calibration_error(np.array(confidence), np.array(right))
    return [
        *out,
        {"name": f"{kind}: calibration error", "ours": error, "unit": "1", "floor": 0.05, "aim": 0.02},
    ]
