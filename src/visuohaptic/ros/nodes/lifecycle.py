"""A component as a ROS 2 lifecycle node: declared parameters, and the states of ``lifecycle_msgs``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ...core import Closing, InputError
from ..transports import RclpyProcess, RclpyTopics, RosOptions
from .component import Component
from .parameters import Parameter, declared
from .running import Running


def _entity(steps: Mapping[str, Callable[[], bool]]) -> Any:
    """The component as a managed entity of rclpy's lifecycle."""
    from rclpy.lifecycle import ManagedEntity, TransitionCallbackReturn

    def callback(step: Callable[[], bool]) -> Callable[[Any, Any], Any]:
        return lambda *_: TransitionCallbackReturn.SUCCESS if step() else TransitionCallbackReturn.FAILURE

    return type("Entity", (ManagedEntity,), {name: callback(step) for name, step in steps.items()})()


class LifecycleProcess(Closing):
    """A component with a ROS lifecycle; a context manager.

    Parameters
    ----------
    name
        Name of the node.
    kind
        Class of the component.
    values
        Parameters by name that override the defaults; those in ``arguments`` override these.
    options
        Domain and namespace.
    arguments
        ROS command line, such as ``("--ros-args", "-p", "config:=sensor.yaml")``.

    Raises
    ------
    MissingExtraError
        rclpy is not available.
    InputError
        The arguments are not valid ROS arguments, or set a parameter to an invalid value.
    """

    def __init__(
        self,
        name: str,
        kind: type[Component],
        values: Mapping[str, Any],
        options: RosOptions | None = None,
        arguments: Sequence[str] = (),
    ) -> None:
        self._process = RclpyProcess(name, options, arguments, managed=True)
        self._inner = self._process.inner
        self.running = Running(kind, lambda: RclpyTopics(self._inner), self._inner.get_logger().error)
        self._names = [parameter.name for parameter in declared(kind.parameter_model)]
        attempt = self.running.attempt
        steps = {
            "on_configure": lambda: attempt(lambda: self.running.configure(self._values())),
            "on_activate": lambda: attempt(self.running.activate),
            "on_deactivate": lambda: attempt(self.running.deactivate),
        }
        ends = ("on_cleanup", "on_shutdown", "on_error")
        steps |= dict.fromkeys(ends, lambda: attempt(self.running.close))
        try:
            for parameter in declared(kind.parameter_model):
                self._declare(parameter, values.get(parameter.name, parameter.default))
            self._inner.add_on_set_parameters_callback(self._allow)
            self._inner.add_managed_entity(_entity(steps))
        except BaseException:
            self._process.close()
            raise

    def _declare(self, parameter: Parameter, value: Any) -> None:
        from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

        described = ParameterDescriptor(description=parameter.description)
        if parameter.low is not None or parameter.high is not None:
            whole = isinstance(parameter.default, int)
            kind, span, far = (
                (int, IntegerRange, 2**63 - 1) if whole else (float, FloatingPointRange, math.inf)
            )
            low = kind(-far if parameter.low is None else parameter.low)
            high = kind(far if parameter.high is None else parameter.high)
            described_range = "integer_range" if whole else "floating_point_range"
            setattr(described, described_range, [span(from_value=low, to_value=high)])
        try:
            self._inner.declare_parameter(parameter.name, value, described)
        except Exception as error:
            raise InputError(
                f"node {self._inner.get_name()}", " ".join(str(error).split()), field=parameter.name
            ) from error

    def _values(self) -> dict[str, Any]:
        found = {name: self._inner.get_parameter(name).value for name in self._names}
        # ROS returns lists as arrays.
        return {name: value.tolist() if hasattr(value, "tolist") else value for name, value in found.items()}

    def _allow(self, changes: Sequence[Any]) -> Any:
        from rcl_interfaces.msg import SetParametersResult

        if self.running.configured and (fixed := [p.name for p in changes if p.name in self._names]):
            reason = f"{', '.join(fixed)}: fixed while the node is configured; clean it up first"
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def start(self) -> None:
        """Configure and activate immediately, without a lifecycle manager.

        Raises
        ------
        VisuohapticError
            Why that failed.
        """
        for trigger in (self._inner.trigger_configure, self._inner.trigger_activate):
            trigger()
            if self.running.problem is not None:
                raise self.running.problem

    def deactivate(self) -> None:
        """Deactivate after a failure of the component: a lifecycle manager may restart it."""
        self._inner.trigger_deactivate()

    def close(self) -> None:
        """Clean up and leave the graph; may be called repeatedly."""
        self.running.close()
        self._process.close()
