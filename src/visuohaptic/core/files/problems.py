"""Messages about invalid fields of a file: found, expected, and suggestions."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from ..errors import brief, cut

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

#: Bounds in pydantic's errors -> their wording here.
_BOUNDS = {"gt": "more than", "ge": "at least", "lt": "less than", "le": "at most"}
_LENGTHS = {"min_length": "at least", "max_length": "at most"}
#: First word of an error type -> what was expected.
_KINDS = {
    "float": "a number",
    "finite": "a finite number",
    "int": "a whole number",
    "bool": "true or false",
    "string": "a text",
    "list": "a list",
    "tuple": "a list",
    "dict": "a mapping of fields",
    "model": "a mapping of fields",
}


def field_problems(error: ValidationError, model: type[BaseModel]) -> list[tuple[str, str]]:
    """Field and problem of every validation error of a model.

    Parameters
    ----------
    error
        Error raised by the model.
    model
        Class of the model; its fields are suggested for unknown names.
    """
    return [
        (".".join(cut(str(part), 60) for part in problem["loc"]) or "file", _said(problem, model))
        for problem in error.errors(include_url=False)
    ]


def _said(problem: Any, model: type[BaseModel]) -> str:
    kind, context, found = problem["type"], problem.get("ctx", {}), brief(problem["input"])
    if kind == "missing":
        return "is missing"
    if kind == "extra_forbidden":
        if problem["loc"] == ("format",):
            return f"found {found}: a file of another kind"
        near = get_close_matches(str(problem["loc"][-1]), sorted(set(_names(model))), n=1)
        return f"unknown field (found {found})" + (f", did you mean {near[0]}?" if near else "")
    if kind == "value_error":
        return f"{context['error']} (found {found})"
    expected = [f"{word} {context[name]}" for name, word in _BOUNDS.items() if name in context]
    expected += [f"{word} {context[name]} entries" for name, word in _LENGTHS.items() if name in context]
    if kind == "literal_error":
        expected.append(str(context["expected"]).replace("'", ""))
    if not expected:
        expected.append(_KINDS.get(kind.partition("_")[0], problem["msg"]))
    return f"found {found}, expected {' and '.join(expected)}"


def _names(model: Any, seen: frozenset[Any] = frozenset()) -> Iterator[str]:
    """Names of all fields of a model and of its nested models."""
    from typing import get_args

    fields = getattr(model, "model_fields", None)
    if fields is None or model in seen:
        for part in () if model in seen else get_args(model):
            yield from _names(part, seen)
        return
    for name, field in fields.items():
        yield field.alias or name
        yield from _names(field.annotation, seen | {model})
