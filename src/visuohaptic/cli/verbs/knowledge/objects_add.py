"""``visuohaptic objects add``: add an object, or new evidence of a known one.

reads   the arguments, and the stored object if there is one
writes  into the database; the data are on the disk when the command returns.
        --estimate PLACE=VALUE+-SIGMA is fused with the stored estimate; SIGMA is its standard deviation, more than 0

example: visuohaptic objects add cup-1 --class cup --estimate material.wall_thickness_m=0.8e-3+-0.02e-3
"""

from __future__ import annotations

from typing import Any

from .... import core
from ....core.errors import InputError
from ._objects import add_database, described, opened

#: Optional modules that the verb imports.
NEEDS = ("pyarrow", "sqlalchemy")

#: Maximum thickness of any wall [m].
THICKEST_m = 0.05


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("id", str, "id of the object, new or known")
    add("--name", "", "name for display")
    add("--class", "", "visual class", dest="visual_class")
    add("--licence", "", "licence of the data, an SPDX identifier")
    add("--state", list, "state, for example lid=open or fill=0.5", metavar="NAME=VALUE")
    add("--estimate", list, "estimate in SI units", metavar="PLACE=VALUE+-SIGMA")
    add("--source", "command line", "origin of the evidence", dest="origin")
    add("--seen", float, "current position in the map [m]", metavar="X Y Z")
    add("--context", list, "words that describe its place, such as kitchen,sink; may be repeated")
    add_database(add)


def run(args: Any) -> dict[str, Any]:
    """Add; returns the mapping that ``--json`` prints."""
    import time

    from ....database.merge import add_evidence
    from ....database.rows import row_of

    origin = core.Provenance(args.origin, time.time())
    evidence = [_evidence(text, origin) for text in args.estimate]
    state = dict(_state(text) for text in args.state)
    seen = None
    words = [word.strip() for text in args.context for word in text.split(",") if word.strip()]
    if words and args.seen is None:
        raise InputError("--context", "found no --seen", remedy="it describes the place where the object is")
    if args.seen is not None:
        if not all(abs(value) < float("inf") for value in args.seen):
            raise InputError("--seen", f"found {args.seen}, expected three finite numbers [m]")
        seen = core.Sighting(tuple(args.seen), 0.05, origin.t_s, context=tuple(words))
    given = {"name": args.name, "visual_class": args.visual_class, "licence": args.licence, "state": state}
    obj = core.VisuoHapticObject(
        args.id, seen=seen, provenance={place: origin for place, value in given.items() if value}, **given
    )
    for item in evidence:
        _plausible(item, obj)
    updated = add_evidence(obj, *evidence)
    row_of(updated, None, None)  # checked before the database is created
    with opened(args, create=True) as database:
        if args.id in database:
            for item in evidence:
                _plausible(item, database.get(args.id))
        return described(database.add(updated))


def _plausible(item: Any, known: Any) -> None:
    """Reject impossible values: a material constant of zero, a wall thicker than the radius of the object."""
    name, value = item.property.rpartition(".")[2], item.estimate.value
    if name not in {"wall_thickness_m", "youngs_modulus_Pa", "density_kg_per_m3"}:
        return
    if value <= 0:
        raise InputError("--estimate", f"found {value:g}, expected more than 0", field=item.property)
    if name != "wall_thickness_m":
        return
    import numpy as np

    limit, of = THICKEST_m, "more than any object has that a hand holds"
    if known.geometry is not None and known.geometry.vertices_m is not None:
        limit, of = (
            float(np.ptp(known.geometry.vertices_m, axis=0).min()) / 2,
            f"half of {known.id}'s smallest extent",
        )
    if value >= limit:
        raise InputError(
            "--estimate",
            f"found a wall of {value:g} m, expected less than {limit:.3g} m, {of}",
            field=item.property,
            remedy="give it in metres",
        )


def _evidence(text: str, origin: Any) -> Any:
    place, _, numbers = text.partition("=")
    value, separator, sigma = numbers.partition("+-")
    try:
        if not separator:
            raise ValueError
        found = core.Estimate(float(value), float(sigma))
    except InputError:
        raise
    except ValueError as error:
        raise InputError("--estimate", f"found {text!r}, expected PLACE=VALUE+-SIGMA") from error
    if found.sigma == 0:
        # Evidence without variance would permanently give all other evidence zero weight.
        raise InputError(
            "--estimate",
            f"found {text!r} with a SIGMA of 0, expected more than 0",
            remedy="give its standard deviation",
        )
    return core.Evidence(place, found, origin)


def _state(text: str) -> tuple[str, str | float]:
    name, separator, value = text.partition("=")
    if not separator or not name:
        raise InputError("--state", f"found {text!r}, expected NAME=VALUE")
    try:
        number = float(value)
    except ValueError:
        return name, value
    if name == "fill" and not 0.0 <= number <= 1.0:
        raise InputError("--state", f"found {text!r}, expected a fill level of 0..1", field="fill")
    return name, number
