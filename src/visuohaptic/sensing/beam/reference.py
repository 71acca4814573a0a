"""A reference template that is fixed relative to the camera: its noise can be averaged."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.camera.pose import Pose
from ...core.geometry import so3_log
from ...core.measurement import Reason


class SteadyReference:
    """Mean pose of the reference while camera and sensor base are rigidly connected.

    The lever arm from the reference to the tip converts the reference's small
    rotation noise into half of the noise of F_Y; a mean over ``frames`` frames
    removes it. A bump of the camera is detected by the distance of the new poses
    from the mean: the first such frames are ``moved``, then the mean restarts.
    Corners of a print err together, by more than the tracker declares: the
    covariance of a frame is scaled by the mean squared distance of earlier frames,
    with the declared covariance as one more.

    Parameters
    ----------
    frames
        Maximum number of frames in the mean; older ones are forgotten exponentially.
    patience
        Number of consecutive deviating frames after which the new pose is accepted.
    """

    #: Squared Mahalanobis distance, 6 degrees of freedom, that one valid frame in ten million exceeds.
    LIMIT = 45.0

    def __init__(self, frames: int = 100, patience: int = 5) -> None:
        self.frames, self.patience = frames, patience
        self.pose: Pose | None = None
        self.covariance: Float[np.ndarray, "6 6"] = np.full((6, 6), np.nan)
        self._count = 0
        self._deviating = 0
        self._squares = 0.0
        self._held = False

    def hold(self) -> None:
        """Freeze the current mean."""
        self._held = True

    def update(self, pose: Pose, covariance: Float[np.ndarray, "6 6"]) -> Reason:
        """Process one pose; ``moved`` if it does not agree with the previous ones.

        Parameters
        ----------
        pose
            ``T_camera_reference`` in one frame.
        covariance
            Its covariance, axes of the camera [m, rad].
        """
        if self._held:
            return Reason.OK
        if self.pose is None:
            self.pose, self.covariance, self._count = pose, covariance, 1
            return Reason.OK
        turn = so3_log(pose.rotation @ self.pose.rotation.T)
        offset = np.concatenate([pose.translation_m - self.pose.translation_m, turn])
        distance = float(offset @ np.linalg.solve(covariance + self.covariance, offset))
        # The first frame has no distance, and stands for the declared covariance.
        if distance > self.LIMIT * max(1.0, (6.0 + self._squares) / (6.0 * self._count)):
            self._deviating += 1
            if self._deviating >= self.patience:
                self.pose, self.covariance, self._count, self._deviating = pose, covariance, 1, 0
                self._squares = 0.0
            return Reason.MOVED
        self._deviating = 0
        self._squares = (self._squares + distance) * min(1.0, self.frames / (self._count + 1))
        self._count = min(self._count + 1, self.frames)
        gain = 1 / self._count
        step = gain * offset
        self.pose = Pose(
            Pose.from_rotation_vector(step[3:], np.zeros(3)).rotation @ self.pose.rotation,
            self.pose.translation_m + step[:3],
        )
        self.covariance = (1 - gain) ** 2 * self.covariance + gain**2 * covariance
        return Reason.OK
