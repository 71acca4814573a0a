"""Where to grasp what gives way, and how hard (Alt 2016, Sec. 6.2)."""

from .confirm import Confirmation, confirm_grasp
from .feasibility import FeasibilityMap, Spill, Verdict, feasibility_map, spill_of
from .force import GripperModel, Handling, Load, object_load, required_force_N
from .match import DeformedShape, ShapeMatch, match_shape, predicted_shape
from .planner import Grasp, GraspPlan, GraspTask, multi_contact, plan_grasps, plan_map
from .score import GraspScores, ScoreParameters, deformation_score, grasp_scores

__all__ = [
    "Confirmation",
    "DeformedShape",
    "FeasibilityMap",
    "Grasp",
    "GraspPlan",
    "GraspScores",
    "GraspTask",
    "GripperModel",
    "Handling",
    "Load",
    "ScoreParameters",
    "ShapeMatch",
    "Spill",
    "Verdict",
    "confirm_grasp",
    "deformation_score",
    "feasibility_map",
    "grasp_scores",
    "match_shape",
    "multi_contact",
    "object_load",
    "plan_grasps",
    "plan_map",
    "predicted_shape",
    "required_force_N",
    "spill_of",
]
