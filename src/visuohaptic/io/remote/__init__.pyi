from .client import RemoteRobot as RemoteRobot
from .client import start_robot as start_robot
from .server import serve_robot as serve_robot
from .wire import PROTOCOLS as PROTOCOLS
from .wire import RemoteTouch as RemoteTouch
