from .odometry import SequencePoses as SequencePoses
from .odometry import estimate_poses as estimate_poses
