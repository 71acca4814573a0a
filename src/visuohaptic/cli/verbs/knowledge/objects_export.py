"""``visuohaptic objects export``: export objects as folders.

reads   a database of objects
writes  for each object a folder with card.yaml, arrays.parquet and mesh.glb

example: visuohaptic objects export cup-1 --licence CC-BY-4.0 --out kitchen_export
"""

from __future__ import annotations

from typing import Any

from ._objects import add_database, opened

#: Optional modules that the verb imports.
NEEDS = ("pyarrow", "sqlalchemy", "trimesh")


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("id", str, "ids of the objects (all)", nargs="*")
    add("--out", str, "folder to write to, created if necessary", required=True)
    add("--licence", "", "licence of objects without one, an SPDX identifier")
    add_database(add)


def run(args: Any) -> dict[str, Any]:
    """Export; returns the mapping that ``--json`` prints."""
    from ....database.exchange import export_objects

    with opened(args) as database:
        known = [one.id for one in database.summaries()]
        ids = list(dict.fromkeys(args.id)) or known
        for one in sorted(set(ids) - set(known)):
            database.get(one)  # refused before anything is written
        count = export_objects((database.get(one) for one in ids), args.out, licence=args.licence)
    return {"folder": args.out, "exported": count}
