"""``visuohaptic template check``: predict how well an image can be tracked.

reads   an image file; its printed size from --width-m or its dpi value
writes  nothing; with --sheet, a PDF or PNG for printing at exact size

examples
  visuohaptic template check cover.png
  visuohaptic template check cover.png --width-m 0.08 --sheet sheet.pdf
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import tracking
from ....core import files
from ....core.files.plain_json import picked
from ....tracking import templates


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("image", Path, "image file")
    add("--width-m", float, "printed width, where the file has no dpi", low=0, above=True)
    add("--sheet", Path, "PDF or PNG to write")
    add("--paper", "A4", "paper of the sheet: A4, A3 or letter")
    add("--dpi", 300.0, "dots per inch of a PNG sheet")


def run(args: Any) -> dict[str, Any]:
    """Evaluate the image; returns the mapping that ``--json`` prints."""
    template = tracking.Template.from_file(args.image, width_m=args.width_m)
    quality = tracking.template_quality(template)
    width, height = template.size_m
    args.report(f"{'printed size':<24}{1e3 * width:.1f} x {1e3 * height:.1f} mm")
    args.report(f"{'score':<24}{quality.score:.2f} (0 to 1)")
    args.report(f"{'corner noise':<24}{quality.corner_sigma_px:.4f} px at 200 px size and noise 5")
    args.report(f"{'self-similarity':<24}{quality.ambiguity:.2f} when shifted")
    args.report(f"{'features':<24}{quality.features}")
    for problem in quality.problems:
        args.report(f"{'problem':<24}{problem}")
    sheet: dict[str, float] | None = None
    if args.sheet:
        item = templates.SheetItem(template.name, files.read_image(args.image, "grey"), width)
        sheet = templates.save_sheet(args.sheet, [item], paper=args.paper, dpi=args.dpi)
        args.report(f"{'sheet':<24}{args.sheet}")
    return {
        "image": str(args.image),
        "width_m": width,
        "height_m": height,
        **picked(quality, "score corner_sigma_px ambiguity features problems"),
        "sheet_widths_m": sheet,
    }
