"""``visuohaptic example office``: a map with tagged objects to plan on.

reads
  nothing
writes, into --out
  office.yaml, office.pgm    rooms with a gap and a door (Alt 2016, Fig. 4.6)
  objects.yaml               a stool in the gap, a table before the door, a fixed tower and two bins, with haptic tags
  robot.yaml                 radius, speeds and maximum push force of the robot

example
  visuohaptic example office --out try
  visuohaptic plan try/office.yaml --objects try/objects.yaml --robot try/robot.yaml --start 1.5 0.9 --goal 2.45 1.5 --plot try/plan.png
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import rigs


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--out", Path, "folder to write to", required=True)


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    from .example_foam import report_files

    return report_files(args, rigs.write_office_example(args.out), "example office")
