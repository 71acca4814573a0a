"""Parameters of a node: declared once as a model, with range and description, for ROS and for the command line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict

from ...core.errors import InputError
from ...core.files import checked_model, parse_yaml

__all__ = ["NodeParameters", "Parameter", "declared", "given"]


class NodeParameters(BaseModel):
    """Base of a node's parameters: numbers, texts, switches and lists of them, each with a default.

    A text that must be given has the default ``""`` and a ``min_length``, which the node refuses when it is configured:
    ROS declares parameters before anybody can set them.
    """

    model_config = ConfigDict(extra="forbid", validate_default=True)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter as ROS declares it."""

    name: str
    default: Any
    description: str
    low: float | None  #: smallest value; ``None`` without a bound
    high: float | None  #: largest value
    required: bool  #: whether the default is refused


def declared(model: type[NodeParameters]) -> Iterator[Parameter]:
    """The parameters of a node.

    Parameters
    ----------
    model
        Its parameters.
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
    """Values of parameters from a command line.

    Parameters
    ----------
    words
        As ``name:=value`` (ROS) or ``name=value``; values are YAML, nothing is an empty text.
    model
        Parameters of the node.
    node
        Its name, for messages.
    whole
        Whether those that must be given have to be among them.

    Raises
    ------
    InputError
        A word is not a parameter of the node, or its value not allowed.
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
    """Parameters from values by name.

    Parameters
    ----------
    values
        Those that are not given have their default.
    model
        Parameters of the node.
    node
        Its name, for messages.

    Raises
    ------
    InputError
        With all values that are not allowed.
    """
    return checked_model(f"node {node}", dict(values), model)
