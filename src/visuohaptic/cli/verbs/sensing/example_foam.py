"""``visuohaptic example foam``: a recording to try the sensor on.

reads
  nothing
writes, into --out
  strain_stress.csv          what a press recorded of the foam
  camera.yaml, sensor.yaml   the camera, and the strip in front of it
  rest.mp4, push.mp4         the untouched strip; a cylinder pressed into it and taken back
  truth.csv                  t_s, force_N, depth_m of the physics, to compare with

example
  visuohaptic example foam --out try
  visuohaptic calibrate foam try/strain_stress.csv --width 0.02 --height 0.01 --out try/foam.yaml --plot try/foam.png
  visuohaptic sense foam --config try/sensor.yaml --source try/rest.mp4 --zero
  visuohaptic sense foam --config try/sensor.yaml --source try/push.mp4 --csv try/run.csv --out try/run.mcap
"""

from __future__ import annotations

from typing import Any

from ._example import NEEDS, add_arguments, written

__all__ = ["NEEDS", "add_arguments", "run"]


def run(args: Any) -> dict[str, Any]:
    """Do it; the mapping is what ``--json`` prints."""
    from ....rigs.foam_example import write_example

    return written(args, write_example, "example foam")
