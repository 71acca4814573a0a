# The front door: the names that most programs need, imported at first use.

# Sense: frames to forces, poses, motion and haptic tags
from .core import ForceProfile as ForceProfile
from .core import HapticTag as HapticTag
from .core import Wrench as Wrench
from .report import force_over_time as force_over_time
from .sensing.beam import BeamSensor as BeamSensor
from .sensing.foam import FingerSensor as FingerSensor
from .sensing.foam import FoamSensor as FoamSensor
from .sensing.foam.material import calibrate_foam as calibrate_foam
from .sensing.push import tag_from_push as tag_from_push
from .sensing.scene import SceneTracker as SceneTracker
from .tracking.templates import Template as Template
from .tracking.templates import TemplateTracker as TemplateTracker

# Map and plan: drive there, and push aside what is in the way
from .io.maps import OccupancyMap as OccupancyMap
from .navigation.graph import assign_regions as assign_regions
from .navigation.graph import build_graph as build_graph
from .navigation.planning import make_plan as make_plan
from .navigation.plots import plot_path_plan as plot_path_plan
from .navigation.problem import MovableObject as MovableObject
from .navigation.problem import PlanningProblem as PlanningProblem
from .navigation.problem import RobotModel as RobotModel
from .navigation.problem import load_objects as load_objects

# Reconstruct and complete: depth images to surfaces, transparent parts by touch
from .reconstruction import SurfaceMesh as SurfaceMesh
from .reconstruction import plot_completion as plot_completion
from .reconstruction import reconstruct as reconstruct
from .reconstruction.completion import Completion as Completion
from .reconstruction.completion import Touch as Touch

# Elasticity and grasp: stiffness of a container, and where to hold it
from .deformation.maps import object_map as object_map
from .deformation.maps import plot_map as plot_map
from .deformation.shapes import load_object as load_object
from .grasping import GraspTask as GraspTask
from .grasping import plan_grasps as plan_grasps

# Recognise: what an object is, by touch and by sight
from .recognition import FeatureSet as FeatureSet
from .recognition import HapticClassifier as HapticClassifier
from .recognition import VisualPrior as VisualPrior
from .recognition.trees import plot_tree as plot_tree

# Remember: the object database of a robot, and of many
from .core import VisuoHapticObject as VisuoHapticObject
from .database import ObjectDatabase as ObjectDatabase
from .database import open_database as open_database

# Run a robot: what it has to offer, and the tasks that it can do
from .core import FrameSource as FrameSource
from .core import Gripper as Gripper
from .core import MobileBase as MobileBase
from .core import ProbeArm as ProbeArm
from .tasks.manipulation import complete_by_touch as complete_by_touch
from .tasks.manipulation import grasp_and_lift as grasp_and_lift
from .tasks.manipulation import squeeze as squeeze
from .tasks.mobile import explore_obstacle as explore_obstacle
from .tasks.mobile.travel import travel as travel

# Camera and recordings: frames in, measurements out
from .core import Camera as Camera
from .core import Pose as Pose
from .core import VisuohapticError as VisuohapticError
from .io import find_cameras as find_cameras
from .io import open_camera as open_camera
from .io import open_source as open_source
from .io.sinks import MeasurementWriter as MeasurementWriter
from .viewer import LivePage as LivePage

__version__: str
