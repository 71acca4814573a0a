"""Node parameters: declared once as a model with range and description, for ROS and for the command line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict

from ...core import InputError, checked_model, parse_yaml


class NodeParameters(BaseModel):
    """Base of a node's parameters: numbers, strings, booleans and lists of them, each with a default.

    A required string has the default ``""`` and a ``min_length``, which is rejected at configuration:
    ROS declares parameters before they can be set.
    """

    model_config = ConfigDict(extra="forbid", validate_default=True)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter as declared in ROS."""

    name: str
    default: Any
    description: str
    low: float | None  #: minimum value; ``None`` without a bound
    high: float | None  #: maximum value
    required: bool  #: whether the default is rejected


def declared(model: type[NodeParameters]) -> Iterator[Parameter]:
    """The parameters of a node.

    Parameters
    ----------
    model
        Parameter model of the node.
    """
    for name, field in model.model_fields.items():
        bounds = {
            key: getattr(rule, key)
            for rule in field.metadata
            for key in ("ge", "gt", "le", "lt", "min_length")
            if getattr(rule, key, None) is not None
        }
        low, high = bounds.get("ge", bounds.get("gt")), bounds.get("le", bounds.get("lt"))
        default = field.get_default(call_default_factory=True)
        required = bool(bounds.get("min_length")) and not default
        yield Parameter(name, default, field.description or "", low, high, required)


def given(
    words: Sequence[str], model: type[NodeParameters], node: str, *, whole: bool = True
) -> dict[str, Any]:
    """Parse parameter values from a command line.

    Parameters
    ----------
    words
        ``name:=value`` (ROS) or ``name=value``; values are YAML, an empty value is an empty string.
    model
        Parameters of the node.
    node
        Name of the node, for messages.
    whole
        Whether all required parameters must be included.

    Raises
    ------
    InputError
        A word is not a parameter of the node, or its value is invalid.
    """
    values: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition(":=" if ":=" in word else "=")
        if not equals or not name:
            raise InputError(f"node {node}", f"found {word!r}, expected name:=value")
        values[name] = parse_yaml(text, f"parameter {name}") if text else ""
    missing = (
        {} if whole else {p.name: "later" for p in declared(model) if p.required and p.name not in values}
    )
    checked(values | missing, model, node)
    return values


def checked(values: Mapping[str, Any], model: type[NodeParameters], node: str) -> NodeParameters:
    """Create parameters from values by name.

    Parameters
    ----------
    values
        Values by name; missing ones take their default.
    model
        Parameters of the node.
    node
        Name of the node, for messages.

    Raises
    ------
    InputError
        A required value is missing, or values are invalid; lists all of them.
    """
    if missing := [p.name for p in declared(model) if p.required and not values.get(p.name)]:
        raise InputError(
            f"node {node}",
            f"missing {', '.join(missing)}",
            remedy=f"set it with --param {missing[0]}:=VALUE, or as a parameter of ROS",
        )
    return checked_model(f"node {node}", dict(values), model)
