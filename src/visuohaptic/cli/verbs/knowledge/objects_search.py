"""``visuohaptic objects search``: find objects with similar features.

reads   a database of objects, and the features of one of them or of a .npy file (NaN: unknown)
writes  the result to stdout

example: visuohaptic objects search --like cup-1 --count 5
"""

from __future__ import annotations

from typing import Any

from ....core import files
from ....core.errors import InputError
from ._objects import add_database, opened

#: Optional modules that the verb imports.
NEEDS = ("pyarrow", "sqlalchemy")


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    query = add.one_of(required=True)
    query("--like", str, "id of an object")
    query("--features", str, ".npy file with one vector")
    add("--kind", "stiffness", "kind of features")
    add("--count", 5, "number of results")
    add_database(add)


def run(args: Any) -> dict[str, Any]:
    """Search; returns the mapping that ``--json`` prints."""
    from ....database.search import index_of

    with opened(args) as database:
        if args.like:
            features = database.get(args.like).features
            if args.kind not in features:
                raise InputError(args.like, f"has no features {args.kind!r}, only {sorted(features)}")
            query = features[args.kind].values
        else:
            query = files.read_npy(args.features, "a .npy file of numbers")
        index = index_of(database, args.kind)
        if not len(index):
            raise InputError(database.where, f"has no object with features {args.kind!r}", field="--kind")
        found = index.nearest(query, args.count)
    for one in found:
        args.report(f"{one.distance:10.4g}  {one.id}")
    return {"found": [{"id": one.id, "distance": one.distance} for one in found]}
