"""Fetch requested containers: which of them is examined next.

Every container has a chain of remaining steps, each with an expected duration and a probability that the container is still
requested after it: looking tells whether it is transparent, squeezing its class and contents. With ``P`` the probability that
a chain ends with a delivered container and ``T`` its expected duration, which ends early where a step excludes the container,
the chain with the largest ``P / T`` is continued (:func:`next_container`). This index minimises the expected time until the
first delivery, and the mean time of delivery where all are requested: by exchange of two chains; a chain whose step succeeded
has a larger index than before (Gittins 1979; Dumitriu, Tetali, Winkler 2003, On playing golf with two balls).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from ..core.errors import InputError

_Key = TypeVar("_Key", bound=Hashable)

#: Words of a request: the property that each requires, and the number of containers.
_COUNTS = {"every": True, "all": True, "a": False, "an": False, "one": False}
_SEEN = {"transparent": True, "clear": True, "opaque": False}
_LIDS, _FILLS = {"closed": True, "open": False}, {"filled": True, "full": True, "empty": False}
_ANY = ("container", "vessel")
#: A container is brought if it is requested with a higher probability, and left if with a lower one than the rest: of twenty
#: decisions one may be wrong.
DECIDED = 0.95


@dataclass(frozen=True, slots=True)
class ContainerBelief:
    """What is known of one container; by default nothing."""

    transparent: float = 0.5  #: probability
    closed: float = 0.5  #: probability of a closed lid
    filled: float = 0.5  #: probability that it is not empty
    classes: Mapping[str, float] = field(
        default_factory=dict
    )  #: probability of each class; empty: nothing is known


@dataclass(frozen=True, slots=True)
class FetchRequest:
    """A request for one container, or all of them, with the required properties; ``None``: not required.

    Examples
    --------
    >>> request = FetchRequest.parse("every transparent bottle", ["bottle", "smoothie"])
    >>> request.every, request.transparent, request.class_name
    (True, True, 'bottle')
    >>> request.probability(ContainerBelief(transparent=1.0, classes={"bottle": 0.9, "smoothie": 0.1}))
    0.9
    """

    every: bool = True  #: all of them, or any one
    transparent: bool | None = None
    closed: bool | None = None
    filled: bool | None = None
    class_name: str | None = None

    @classmethod
    def parse(cls, text: str, classes: Collection[str]) -> FetchRequest:
        """Read a request: a number (``every``, ``a``), adjectives, and a class or ``container``.

        Parameters
        ----------
        text
            As ``every transparent bottle``, ``an empty container``; adjectives are transparent, opaque, open, closed, filled,
            and empty.
        classes
            Known classes.

        Raises
        ------
        InputError
            A word is missing or unknown, or contradicts another.
        """
        count, *adjectives, noun = text.lower().split() if len(text.split()) > 1 else ("", "")
        nouns = {name: name for name in classes} | dict.fromkeys(_ANY)
        if noun not in nouns:  # plural
            noun = noun.removesuffix("s")
        found: dict[str, bool] = {}
        for word in adjectives:
            part = next((p for p, w in _ADJECTIVES.items() if word in w), "")
            if not part or part in found:
                expected = ", ".join(word for words in _ADJECTIVES.values() for word in words)
                raise InputError("request", f"found {word!r}, expected one of {expected}, one of each kind")
            found[part] = _ADJECTIVES[part][word]
        if count not in _COUNTS or noun not in nouns:
            raise InputError(
                "request",
                f"found {text!r}, expected {', '.join(_COUNTS)}, then adjectives, then {', '.join(nouns)}",
                remedy='for example "every transparent bottle"',
            )
        return cls(_COUNTS[count], class_name=nouns[noun], **found)

    def probability(self, belief: ContainerBelief, of: Collection[str] = ()) -> float:
        """Probability that a container has the required properties.

        Parameters
        ----------
        belief
            What is known of it.
        of
            Names of the properties that count; all by default.
        """
        result = 1.0
        for name in of or (*_ADJECTIVES, "class_name"):
            value = getattr(self, name)
            if value is None:
                continue
            if name == "class_name":
                # Nothing is known: as probable as not.
                result *= belief.classes.get(value, 0.0) if belief.classes else 0.5
            else:
                true = getattr(belief, name)
                result *= true if value else 1.0 - true
        return result


_ADJECTIVES = {"transparent": _SEEN, "closed": _LIDS, "filled": _FILLS}


@dataclass(frozen=True, slots=True)
class FetchStep:
    """A step towards the delivery of a container."""

    duration_s: float  #: expected
    passes: float = 1.0  #: probability that the container is still requested after it


def deliveries_per_s(steps: Sequence[FetchStep]) -> float:
    """Probability of a delivery by the expected duration of the steps up to it, or to the one that excludes it [1/s].

    Parameters
    ----------
    steps
        Remaining steps in their order, one at least.
    """
    reached, duration_s = 1.0, 0.0
    for step in steps:
        duration_s += reached * step.duration_s
        reached *= step.passes
    return reached / duration_s if duration_s > 0.0 else math.inf


def next_container(chains: Mapping[_Key, Sequence[FetchStep]]) -> _Key:
    """The container whose next step comes first; of equal ones the first.

    Parameters
    ----------
    chains
        Remaining steps of each container that may be requested, one at least.

    Examples
    --------
    >>> look, squeeze = FetchStep(6.0, 0.5), FetchStep(60.0, 0.5)
    >>> next_container({"new": (look, squeeze), "seen": (squeeze,)})  # 1 in 144 s, or in 120 s
    'seen'
    """
    return max(chains, key=lambda key: deliveries_per_s(chains[key]))
