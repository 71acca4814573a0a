from .gripper import RosGripper as RosGripper
from .mobile_base import RosBase as RosBase
from .probe_arm import RosArm as RosArm
