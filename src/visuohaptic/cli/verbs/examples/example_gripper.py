"""``visuohaptic example gripper``: a recording to try the foam sensor of a gripper's finger on.

reads
  nothing
writes, into --out
  camera.yaml, sensor.yaml   the camera above the gripper, and the foam on its finger
  strain_stress.csv          stress-strain data of the foam, as a press records it
  foam.yaml                  the foam's calibration
  rest.mp4, grip.mp4         the open gripper; it closes on a bottle and opens again
  truth.csv                  t_s, force_N, position_m of the simulated physics

example
  visuohaptic example gripper --out try
  visuohaptic sense foam --config try/sensor.yaml --source try/rest.mp4 --zero
  visuohaptic sense foam --config try/sensor.yaml --source try/grip.mp4 --csv try/run.csv --out try/run.mcap
"""

from __future__ import annotations

from typing import Any

from .... import rigs
from .example_foam import NEEDS, add_arguments, written

__all__ = ["NEEDS", "add_arguments", "run"]


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    return written(args, rigs.write_gripper_example, "example gripper")
