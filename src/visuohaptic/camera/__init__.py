"""The camera: pinhole with distortion and rolling shutter, poses, casting to a plane, frames."""

from .frame import Frame
from .model import Camera
from .plane import PlaneView
from .pose import Pose

__all__ = ["Camera", "Frame", "PlaneView", "Pose"]
