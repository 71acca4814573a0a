"""``visuohaptic example beam``: a recording to try the beam sensor on.

reads
  nothing
writes, into --out
  sensor.yaml, beam.yaml     the sensor, and the rod with the values of its data sheet
  camera.yaml, templates/    the camera, and the tags on base and rod
  rest.mp4, push.mp4         the untouched rod; forces along Y and Z, then a combined load
  truth.csv                  t_s, fx_N, fy_N, fz_N, mx_Nm, my_Nm, mz_Nm of the simulated physics

example
  visuohaptic example beam --out try
  visuohaptic sense beam --config try/sensor.yaml --source try/rest.mp4 --zero
  visuohaptic sense beam --config try/sensor.yaml --source try/push.mp4 --csv try/run.csv --out try/run.mcap
"""

from __future__ import annotations

from typing import Any

from .... import rigs
from .example_foam import NEEDS, add_arguments, written

__all__ = ["NEEDS", "add_arguments", "run"]


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    return written(args, rigs.write_beam_example, "example beam")
