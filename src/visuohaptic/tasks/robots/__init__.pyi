from .lerobot import LeRobotBase as LeRobotBase
from .lerobot import LeRobotCamera as LeRobotCamera
from .lerobot import LeRobotGripper as LeRobotGripper
from .lerobot import LeRobotLink as LeRobotLink
from .repeater import Repeater as Repeater
