"""A small example recording for the finger sensor: a gripper with foam and an AprilTag closes on a bottle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ..simulation.rendering.effects import CameraEffects
from .foam_example import write_truth, write_video
from .squeeze_rig import BOTTLE
from .virtual_gripper import GripperSensor

#: The example: closing speed [m/s], and start of the recording before the contact [s].
_CLOSE_M_S, _BEGIN_S = 0.03, 0.9
#: Illumination of its videos.
_DAYLIGHT = CameraEffects(1.0, 1.5, vignetting=0.2)
_CLOSING, _OPENING = 20, 20  #: frames each way


def write_gripper_example(
    folder: Path | str, *, seed: int = 1, on_message: Callable[[str], None] = lambda text: None
) -> Path:
    """Write sensor files, two videos and the truth of a finger with foam and an AprilTag.

    ``rest.mp4`` shows the open gripper, ``grip.mp4`` how it closes on a bottle and opens again;
    ``truth.csv`` contains time, force and position of the finger (t_s, force_N, position_m).

    Parameters
    ----------
    folder, seed, on_message
        As in :func:`~visuohaptic.rigs.foam_example.write_example`.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rng, maker = np.random.default_rng(seed), GripperSensor(stripe=False, effects=_DAYLIGHT)
    maker.write(folder, rng)
    on_message("rendering rest.mp4")
    still = maker.gripper(rng=rng)
    write_video(folder / "rest.mp4", (still.frame().image for _ in range(20)))
    gripper, truth = maker.gripper(BOTTLE, rng=rng), []
    gripper.move(0.0, _CLOSE_M_S)
    gripper.skip_to(_BEGIN_S)

    def images() -> Iterator[UInt8[np.ndarray, "rows columns"]]:
        for index in range(_CLOSING + _OPENING):
            if index == _CLOSING:
                gripper.move(gripper.drive.open_m, _CLOSE_M_S)
            frame = gripper.frame()
            now = gripper.truth(frame.t_s)
            truth.append((frame.t_s - _BEGIN_S, now.force_N, now.position_m))
            yield frame.image

    on_message("rendering grip.mp4")
    write_video(folder / "grip.mp4", images())
    write_truth(folder, ("t_s", "force_N", "position_m"), truth)
    return folder
