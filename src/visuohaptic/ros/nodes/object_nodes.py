"""Services for object properties: class from squeezes, grasp position and force."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from ...core.camera.pose import Pose
from ...core.files.plain_json import dumps, picked
from ...deformation import Contents, WallProperties, load_object, squeeze
from ...grasping import GraspTask, GripperModel, ScoreParameters
from ...grasping.planner import plan_grasps
from ...io.ros import ros_messages as messages
from ...recognition import TouchNoise, load_classifier, read_curves
from ...recognition.touch.belief import update_belief
from ...recognition.touch.steps import contradicted_assumption
from ..wire.graph import LATCHED
from .component import Component, Status
from .parameters import NodeParameters


class ClassifyParameters(NodeParameters):
    """Parameters of the node classify."""

    tree: str = Field("", min_length=1, description=".json of classify train")
    curves: str = Field(
        "", min_length=1, description="CSV file that the squeezes of the object are written to"
    )
    force_noise_N: float = Field(0.1, gt=0.0, lt=1e3, description="standard deviation of one sample [N]")
    deformation_noise_m: float = Field(
        1e-4, ge=0.0, lt=0.1, description="standard deviation of one sample [m]"
    )


class ClassifyNode(Component):
    """``~/classify`` reads the current squeezes, and publishes the class probabilities on ``~/belief``."""

    summary = "recognition by squeezing: service classify, probabilities of the classes out"
    parameter_model = ClassifyParameters

    def configure(self) -> None:
        host, parameters = self.host, self.parameters
        self._classifier = load_classifier(Path(parameters.tree))
        self._noise = TouchNoise(parameters.force_noise_N, parameters.deformation_noise_m)
        self._told = Status(True, "not asked yet")
        self._belief = host.node.advertise("~/belief", "std_msgs/msg/String", LATCHED)
        host.offer("~/classify", self.classify)

    def classify(self) -> Mapping[str, Any]:
        """Class, confidence and probabilities after all squeezes; raises InputError if they cannot be read."""
        readings = read_curves(Path(self.parameters.curves), self._noise)
        wide = any(reading.width_m == reading.width_m for reading in readings)
        model = self._classifier.model(use_width=wide)
        belief = update_belief(model, readings)
        answer = {
            "answer": belief.answer,
            "confidence": belief.confidence,
            "probabilities": belief.as_mapping(),
            "contradiction": contradicted_assumption(model, readings),
            "touches": len(readings),
        }
        self._belief.publish({"data": dumps(answer)})
        self._told = Status(True, "ok", {"answer": belief.answer, "confidence": belief.confidence})
        return answer


class GraspParameters(NodeParameters):
    """Parameters of the node grasp."""

    object: str = Field("", min_length=1, description="container: YAML description, class, or mesh")
    material: str = Field("", description="of the wall; that of the description by default")
    thickness_m: float = Field(0.0, ge=0.0, le=0.1, description="of the wall [m]; 0: that of the description")
    fill: float = Field(0.0, ge=0.0, le=1.0, description="fill level of the contents")
    closed: bool = Field(False, description="enclosed contents")
    opening_m: float = Field(0.11, gt=0.0, le=2.0, description="maximum opening of the hand [m]")
    max_force_N: float = Field(60.0, gt=0.0, le=1e4, description="of one finger [N]")
    max_deformation_m: float = Field(0.005, gt=0.0, le=0.5, description="allowed, of one side [m]")
    friction: float = Field(0.6, gt=0.0, le=10.0, description="coefficient of the fingers")
    squeeze_N: float = Field(5.0, gt=0.0, le=1e4, description="largest force of ~/squeeze, of one tip [N]")


class GraspNode(Component):
    """``~/plan_grasp`` and ``~/squeeze`` for one container; the pose of the best grasp is latched on ``~/grasp``."""

    summary = "grasps of deformable containers: services plan_grasp and squeeze, PoseStamped out"
    parameter_model = GraspParameters

    def configure(self) -> None:
        host, parameters = self.host, self.parameters
        wall = WallProperties(parameters.material or None, parameters.thickness_m or None)
        self._object = load_object(parameters.object, wall=wall)
        self._pose = host.node.advertise("~/grasp", "geometry_msgs/msg/PoseStamped", LATCHED)
        host.offer("~/plan_grasp", self.plan_grasp)
        host.offer("~/squeeze", self.squeeze)

    def _contents(self) -> Contents | None:
        return Contents(fill=self.parameters.fill) if self.parameters.closed else None

    def plan_grasp(self) -> Mapping[str, Any]:
        """The best grasps; raises InputError if the wall's weight is unknown."""
        chosen = self.parameters
        task = GraspTask(
            closed=chosen.closed,
            fill=chosen.fill,
            gripper=GripperModel(chosen.opening_m, 0.01, chosen.max_force_N, chosen.friction),
            parameters=ScoreParameters(max_deformation_m=chosen.max_deformation_m),
        )
        plan = plan_grasps(self._object, task, count=3)
        if plan.grasps and (approach := plan.grasps[0].approach) is not None:
            header = messages.header(self.host.node.now_s(), self._object.name)
            held = Pose.from_matrix(approach.T_object_gripper)
            self._pose.publish({"header": header, "pose": messages.pose(held)})
        names = "score rim first_m second_m width_m force_N deformation_m deformation_sigma_m"
        grasps = [picked(grasp, names) for grasp in plan.grasps]
        return {"grasps": grasps, "reason": plan.reason, "notes": plan.notes}

    def squeeze(self) -> Mapping[str, Any]:
        """Force over deformation at half height, up to ``squeeze_N``."""
        found = squeeze(self._object, force_N=self.parameters.squeeze_N, contents=self._contents())
        own = picked(found, "stiffness_N_per_m stiffness_sigma_N_per_m buckling_force_N remarks")
        return own | picked(found.curve, "deformation_m force_N complete")
