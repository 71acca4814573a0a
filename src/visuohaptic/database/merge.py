"""Fusion of new evidence with existing estimates, and merging of two versions of an object.

Merging two versions is commutative, associative and idempotent, so that databases agree regardless of the order and
number of synchronisations:

- estimates are combined from the union of their evidence, and identical evidence counts once;
- everything else (geometry, stiffness map, name, state, ...) is taken from the version with the newer
  provenance; without times, or at equal times, a deterministic order of the contents decides.

Pushes of one trip, whose tags are samples rather than versions, are merged by :func:`.tags.merge_tags`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np

from ..core import cards
from ..core.errors import InputError
from ..core.objects import (
    Estimate,
    Evidence,
    HapticTag,
    Material,
    ObjectPart,
    ObjectState,
    Provenance,
    Sighting,
    VisuoHapticObject,
)

#: Fields with mappings whose entries are merged individually.
_MAPPINGS = ("state", "features", "parts", "states")


def combine(estimates: Iterable[Estimate]) -> Estimate:
    r"""Combine independent estimates of one property.

    With weights :math:`w_i = 1/\sigma_i^2` the value is :math:`m = \sum w_i x_i / \sum w_i` and its variance
    :math:`(\sum w_i)^{-1} \max(1, Q/(n-1))`, where :math:`Q = \sum w_i (x_i - m)^2`: contradictory estimates
    make the result less certain, not more (Birge 1932). The spread over contacts includes the spreads of the
    estimates and the differences of their values beyond noise.

    If there are exact estimates (sigma 0), all others have zero weight.

    Parameters
    ----------
    estimates
        At least one, all of one property in one unit.
    """
    # In a fixed order, so that the sum is independent of the order of merging.
    some = sorted(estimates, key=lambda e: (e.value, e.sigma, e.spread, e.samples))
    if not some:
        raise InputError("combine", "found no estimate, expected at least one")
    if len(some) == 1:
        return some[0]
    samples = sum(e.samples for e in some)
    used = [e for e in some if e.sigma == 0] or some
    x = np.array([e.value for e in used])
    spread = np.array([e.spread for e in used])
    sigma = np.array([e.sigma for e in used])
    smallest = float(sigma.min())
    w = (smallest / sigma) ** 2 if smallest > 0 else np.ones(len(used))
    w /= w.sum()
    mean = float(w @ x)
    variance = 1.0 / float(np.sum(sigma**-2.0)) if smallest > 0 else 0.0
    if len(used) > 1:
        off2 = (x - mean) ** 2
        q = float(np.sum(off2 / sigma**2)) / (len(used) - 1) if smallest > 0 else 1.0
        variance = variance * max(1.0, q) if smallest > 0 else float(w @ off2) / (len(used) - 1)
        # n/(n-1) with the effective number of estimates; at most 2, as for two equal ones:
        # an uncertain simulation and one good measurement contain no information about the spread.
        fraction = float(w @ w)
        bessel = min(2.0, 1.0 / (1.0 - fraction)) if fraction < 1.0 else 2.0
        between2 = bessel * float(w @ np.maximum(off2 - sigma**2, 0.0))
    else:
        between2 = 0.0
    return Estimate(mean, math.sqrt(variance), math.sqrt(float(w @ spread**2) + between2), samples)


def estimates_of(item: Any, prefix: str = "") -> Iterator[tuple[str, Estimate]]:
    """All estimates inside an object, with their paths ("material.wall_thickness_m").

    Parameters
    ----------
    item
        An object, or a part of one.
    prefix
        Path of that part in the object, with a trailing dot.
    """
    if isinstance(item, Estimate):
        yield prefix, item
    elif isinstance(item, Mapping):
        for name, inner in item.items():
            yield from estimates_of(inner, f"{prefix}.{name}" if prefix else str(name))
    else:
        for name in _branches(item.__class__):
            inner = getattr(item, name)
            if inner is not None:
                yield from estimates_of(inner, f"{prefix}.{name}" if prefix else name)


@cache
def _branches(kind: type) -> tuple[str, ...]:
    """Fields that can contain estimates."""
    if kind is VisuoHapticObject:
        return "material", "tag", "parts", "states"
    if kind is ObjectPart:
        return "material", "tag"
    if kind is ObjectState:
        return ("tag",)
    return tuple(f.name for f in fields(kind)) if kind in (Material, HapticTag) else ()


def add_evidence(known: VisuoHapticObject, *evidence: Evidence) -> VisuoHapticObject:
    """The object after additional observations; known observations change nothing.

    Parameters
    ----------
    known
        The current object.
    evidence
        Observations, each with the path of its property.

    Raises
    ------
    InputError
        The property does not exist.

    Examples
    --------
    >>> simulated = Evidence("material.wall_thickness_m", Estimate(1e-3, 2e-4))
    >>> measured = Evidence("material.wall_thickness_m", Estimate(8e-4, 2e-5))
    >>> cup = add_evidence(VisuoHapticObject("cup"), simulated, measured)
    >>> round(cup.material.wall_thickness_m.value * 1e3, 3)
    0.802
    """
    everything = _all_evidence(known)
    everything.update({_identity(one): one for one in evidence})
    return _with(known, everything)


def merge_objects(one: VisuoHapticObject, other: VisuoHapticObject) -> VisuoHapticObject:
    """Merge two versions of one object by the rules at the top of this module.

    Parameters
    ----------
    one, other
        The versions, in any order.
    """
    if one.id != other.id:
        raise InputError("merge_objects", f"found the objects {one.id!r} and {other.id!r}, expected one id")
    everything = _all_evidence(one)
    if one is other and not one.provenance:
        return _with(one, everything)  # new: nothing to choose or to attribute
    everything |= _all_evidence(other)
    origins = {
        place: max(
            (obj.provenance[place] for obj in (one, other) if place in obj.provenance), key=_provenance_order
        )
        for place in sorted({*one.provenance, *other.provenance})
    }
    changes: dict[str, Any] = {
        "seen": max(filter(None, (one.seen, other.seen)), key=_provenance_order, default=None)
    }
    for f in fields(VisuoHapticObject):
        local, remote = getattr(one, f.name), getattr(other, f.name)
        if f.name in ("id", "evidence", "provenance", "seen"):
            continue
        if f.name not in _MAPPINGS:
            changes[f.name] = _newer(local, remote, one, other, f.name, origins)
            continue
        changes[f.name] = {
            entry: _newer(local.get(entry), remote.get(entry), one, other, f"{f.name}.{entry}", origins)
            for entry in sorted({*local, *remote})
        }
    changes["provenance"] = origins
    return _with(replace(one, **changes), everything)


def _all_evidence(obj: VisuoHapticObject) -> dict[tuple[str, ...], Evidence]:
    """Evidence of an object; an estimate without evidence counts as its own."""
    found = {_identity(one): one for one in obj.evidence}
    named = {one.property for one in obj.evidence}
    for place, estimate in estimates_of(obj):
        if place not in named:
            origin = obj.provenance.get(place) or obj.provenance.get(place.partition(".")[0]) or Provenance()
            one = Evidence(place, estimate, origin)
            found[_identity(one)] = one
    return found


def _identity(one: Evidence) -> tuple[str, ...]:
    """Key that identifies an observation: all of its contents, as strings so that NaN compares equal."""
    e, origin = one.estimate, one.provenance
    # float(): 1 and 1.0 are the same observation.
    numbers = f"{float(e.value)!r} {float(e.sigma)!r} {float(e.spread)!r} {e.samples} {float(origin.t_s)!r}"
    return one.property, numbers, f"{origin.source}\0{origin.version}\0{origin.note}", one.key


def _with(obj: VisuoHapticObject, everything: dict[tuple[str, ...], Evidence]) -> VisuoHapticObject:
    ordered = [everything[identity] for identity in sorted(everything)]
    by_place: dict[str, list[Estimate]] = {}
    for one in ordered:
        by_place.setdefault(one.property, []).append(one.estimate)
    held = dict(estimates_of(obj))
    for place, estimates in by_place.items():
        if (combined := combine(estimates)) != held.get(place):
            obj = _put(obj, place.split("."), combined, place)
    return obj if obj.evidence == tuple(ordered) else replace(obj, evidence=tuple(ordered))


_EMPTY: dict[str, type] = {"material": Material, "tag": HapticTag, "parts": ObjectPart, "states": ObjectState}


def _put(item: Any, steps: list[str], estimate: Estimate, place: str) -> Any:
    """A copy with the estimate at its path; missing intermediate fields are created."""
    name, rest = steps[0], steps[1:]
    if name not in _branches(item.__class__):
        raise InputError(
            place,
            f"there is no such property: {name!r}, expected one of {', '.join(_branches(item.__class__)) or 'none'}",
        )
    if name in ("parts", "states"):
        entries = getattr(item, name)
        if len(rest) < 3:
            raise InputError(place, f"found no property of the entry of {name!r}")
        entry = ".".join(rest[:-2])  # such as "lid 1.5"
        inner = _put(entries.get(entry, _EMPTY[name]()), rest[-2:], estimate, place)
        return replace(item, **{name: {**entries, entry: inner}})
    if name in _EMPTY:
        if not rest:
            raise InputError(place, f"found the whole {name!r}, expected one of its properties")
        return replace(item, **{name: _put(getattr(item, name) or _EMPTY[name](), rest, estimate, place)})
    if rest or not _holds_estimate(item.__class__, name):
        raise InputError(place, f"{name!r} is not a measured property")
    return replace(item, **{name: estimate})


@cache
def _holds_estimate(kind: type, name: str) -> bool:
    return any(f.name == name and "Estimate" in str(f.type) for f in fields(kind))


def _newer(
    local: Any,
    remote: Any,
    one: VisuoHapticObject,
    other: VisuoHapticObject,
    place: str,
    origins: dict[str, Provenance],
) -> Any:
    """The existing value, the newer one, or the first in a deterministic order; records its provenance."""
    there = [(value, obj) for value, obj in ((local, one), (remote, other)) if not _absent(value)]
    if not there:
        return local
    ranked = []
    for value, obj in there:
        origin = obj.provenance.get(place) or obj.provenance.get(place.partition(".")[0])
        # Contents are compared only if the times do not decide, because it requires their hash.
        contents = cards.order_of(value) if len(there) > 1 and local is not remote else ""
        ranked.append((_time(origin), contents, repr(origin), value, origin))
    *_, value, origin = max(ranked, key=lambda entry: entry[:3])
    if origin is not None:
        origins[place] = origin
    return value


def _absent(value: Any) -> bool:
    return value is None or (isinstance(value, str) and value == "")


def _time(origin: Provenance | Sighting | None) -> float:
    return -math.inf if origin is None or math.isnan(origin.t_s) else origin.t_s


def _provenance_order(origin: Provenance | Sighting) -> tuple[float, str]:
    return _time(origin), repr(origin)
