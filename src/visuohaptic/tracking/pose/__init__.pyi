from .plane_pose import PlanePose as PlanePose
from .plane_pose import estimate_plane_poses as estimate_plane_poses
from .plane_pose import lens_numbers as lens_numbers
from .plane_pose import pose_difference as pose_difference
from .plane_pose import tilted_back as tilted_back
