"""``visuohaptic template sheet``: write AprilTags for printing at exact size.

reads   nothing
writes  --out, a PDF or PNG; list the tags in tags.yaml to track them (see `visuohaptic defaults templates`)

example: visuohaptic template sheet --ids 0 1 2 --size-m 0.04 --out tags.pdf
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ....tracking import templates


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--ids", int, "numbers in the family, 0..586", nargs="+", required=True)
    add("--size-m", float, "side of the black border", required=True, low=0, above=True)
    add("--out", Path, "PDF or PNG to write", required=True)
    add("--paper", "A4", "A4, A3 or letter")
    add("--dpi", 300.0, "dots per inch of a PNG")


def run(args: Any) -> dict[str, Any]:
    """Write the sheet; returns the mapping that ``--json`` prints."""
    items = [templates.tag_item(number, args.size_m) for number in args.ids]
    widths = templates.save_sheet(args.out, items, paper=args.paper, dpi=args.dpi)
    sizes = [widths[item.label] * templates.TAG_CELLS / (templates.TAG_CELLS + 2) for item in items]
    for number, size in zip(args.ids, sizes, strict=True):
        args.report(f"{'tag ' + str(number):<24}size_m: {size:.6f}")
    args.report(f"written to {args.out}")
    return {"out": str(args.out), "size_m": dict(zip(map(str, args.ids), sizes, strict=True))}
