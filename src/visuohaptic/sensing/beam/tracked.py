"""Template tracker and beam sensor combined: wrenches from camera frames (Alt 2016, Sec. 3.4)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...core import CalibrationError, Camera, Closing, Frame, InputError, Reason
from ...core.errors import brief_list
from ...tracking import Template, TemplatePose, TemplateTracker, load_templates
from .calibration import calibrate_beam
from .config import BeamSensorConfig
from .records import LoadRecord
from .sensor import BeamReading, BeamSensor, BeamSetup
from .zero import BeamZero


@dataclass(frozen=True, slots=True, eq=False)
class TrackedReading:
    """Reading of one frame: the wrench, and the template poses."""

    reading: BeamReading
    templates: tuple[TemplatePose, ...]  #: the reference and those on the rod; with reasons if lost

    @property
    def t_s(self) -> float:
        """Time of the frame [s]."""
        return self.reading.wrench.t_s

    @property
    def valid(self) -> bool:
        """Whether the wrench is valid."""
        return self.reading.wrench.valid

    @property
    def reason(self) -> Reason:
        """Reason if not valid; ``ok`` when valid."""
        return self.reading.wrench.reason


class TrackedBeam(Closing):
    """A beam sensor that reads camera frames.

    Parameters
    ----------
    setup
        Beam, positions of the templates, correction.
    templates
        At least the reference and those of ``setup.xi``; others are ignored.
    camera
        Intrinsics and distortion.
    zero
        Poses at rest; without them every reading is ``not_zeroed``.
    threaded
        Search for lost templates in a thread, so that a frame never waits (live use).

    Examples
    --------
    ``TrackedBeam.load("sensor.yaml")`` reads camera, templates and zero from files.
    """

    def __init__(
        self,
        setup: BeamSetup,
        templates: Iterable[Template],
        camera: Camera,
        zero: BeamZero | None = None,
        *,
        threaded: bool = False,
    ) -> None:
        by_name = {template.name: template for template in templates}
        requested = [setup.reference, *setup.xi]
        missing = [name for name in requested if name not in by_name]
        if missing:
            raise InputError(
                "templates",
                f"found {brief_list(sorted(by_name)) or 'none'}; {', '.join(missing)} is missing",
                remedy="name the images, or the tags in tags.yaml, as in sensor.yaml",
            )
        self.sensor = BeamSensor(setup, zero)
        self.camera = camera
        self.tracker = TemplateTracker([by_name[name] for name in requested], camera, threaded=threaded)

    @classmethod
    def load(cls, path: Path | str, *, threaded: bool = False) -> TrackedBeam:
        """Read ``sensor.yaml`` and the files that it names; the zero if there is one.

        Parameters
        ----------
        path
            ``sensor.yaml``; the files that it names are relative to its folder.
        threaded
            Search for lost templates in a thread, so that a frame never waits (live use).

        Raises
        ------
        InputError
            A file or field cannot be used, or the camera or the templates are missing.
        """
        setup = BeamSensorConfig.load(path)
        for field, found in (("camera", setup.camera_path), ("templates_folder", setup.templates_path)):
            if found is None:
                raise InputError(
                    path, "is needed to read from images", field=field, remedy="add it, or give --poses"
                )
        assert setup.camera_path is not None
        assert setup.templates_path is not None
        zero = None
        if setup.zero_path is not None and setup.zero_path.is_file():
            zero = BeamZero.load(setup.zero_path, list(setup.xi))
        camera, templates = Camera.load(setup.camera_path), load_templates(setup.templates_path)
        return cls(setup, templates, camera, zero, threaded=threaded)

    @property
    def zeroed(self) -> bool:
        """Whether there are poses at rest."""
        return self.sensor.zero_reference is not None

    def zero(self, frames: Iterable[Frame]) -> BeamZero:
        """Take the zero from frames of an unloaded sensor.

        Parameters
        ----------
        frames
            Frames of the untouched sensor.

        Raises
        ------
        CalibrationError
            Not enough templates were visible, or the sensor moved during zeroing.
        """
        seen = [(frame.t_s, self.track(frame)) for frame in frames]
        if not seen:
            raise CalibrationError(
                "zero", "found no frame, expected at least one", remedy="give frames of the untouched sensor"
            )
        # Templates that the tracker had not yet found at the start are not a fault of the setup.
        whole = [one for one in seen if all(pose.valid for pose in one[1])]
        return self.sensor.zero(whole if 2 * len(whole) >= len(seen) else seen)

    def calibrate(self, frames: Iterable[Frame], loads: Float[np.ndarray, "n 6"]) -> None:
        """Correct the zeroed sensor by frames under known loads; a frame that cannot be read is left out.

        Parameters
        ----------
        frames
            One frame of each load, in their order.
        loads
            Forces and moments on the tip, frame S [N, Nm].

        Raises
        ------
        InputError
            There are not as many loads as frames.
        CalibrationError
            As :func:`.calibrate_beam`.
        """
        read = [self.read(frame).reading.wrench for frame in frames]
        if loads.shape != (len(read), 6):
            raise InputError(
                "loads", f"found shape {loads.shape}, expected {(len(read), 6)}: six values for each frame"
            )
        valid = np.flatnonzero([wrench.valid for wrench in read])
        observed = np.array([[*read[k].force_N, *read[k].moment_Nm] for k in valid]).reshape(-1, 6)
        record = LoadRecord(loads[valid], observed, "wrench", valid + 1)
        # The reference template is already tracked in all these frames and is not reset.
        self.sensor.correction = calibrate_beam(record, self.sensor.setup.beam).correction

    def track(self, frame: Frame) -> tuple[TemplatePose, ...]:
        """Poses of the templates alone.

        Parameters
        ----------
        frame
            The next frame in time order.
        """
        return self.tracker.update(frame)

    def read(self, frame: Frame, *, now_s: float | None = None) -> TrackedReading:
        """Wrench of one frame.

        Parameters
        ----------
        frame
            The next frame in time order.
        now_s
            Time of the reading [s]; frames older than ``max_age_s`` are stale. None: never stale.
        """
        templates = self.track(frame)
        return TrackedReading(self.sensor.read(frame.t_s, templates, now_s=now_s), templates)

    def reset(self) -> None:
        """Reset frames, drift and template positions; the zero is kept."""
        self.tracker.reset()
        self.sensor.reset()

    def close(self) -> None:
        """End the tracker's thread."""
        self.tracker.close()
