"""Untrusted YAML: plain data of bounded size, and schemas that report all problems at once."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ..errors import InputError, brief_list
from .atomic import write_text
from .problems import field_problems
from .regular import MAX_HAND_BYTES, read_text

if TYPE_CHECKING:
    import yaml
    from pydantic import BaseModel

    Model = TypeVar("Model", bound=BaseModel)

#: Limit of the size that the expansion of aliases may add: number of values plus characters. Nine levels of
#: ``[*a, *a, ...]`` in 500 bytes would add 10^8, the anchors of a hand-written file a few thousand.
MAX_ALIAS_SIZE = 1_000_000
#: Maximum length of an integer that is converted: 64 bits in binary, with underscores.
_MAX_DIGITS = 100
_INTEGER = "tag:yaml.org,2002:int"
_FLOAT = "tag:yaml.org,2002:float"


@cache
def _loader() -> Any:
    """Loader of YAML 1.1 without base 60, long integers and alias expansion attacks."""
    import re

    import yaml

    class Loader(yaml.SafeLoader):
        def get_single_node(self) -> yaml.Node | None:
            node = super().get_single_node()
            if node is not None:
                _check_aliases(node)
            return node

        def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
            _check_number(node)
            value = int(super().construct_yaml_int(node))
            if not -(2**63) <= value < 2**64:
                raise _refused(node, "an integer of more than 64 bits; quote it if it is a string")
            return value

        def construct_yaml_float(self, node: yaml.ScalarNode) -> float:
            _check_number(node)
            return float(super().construct_yaml_float(node))

    Loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in kinds if tag not in (_INTEGER, _FLOAT)]
        for first, kinds in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    # As in PyYAML's resolver, without its last alternative: 1:30 is a string, not 90.
    Loader.add_implicit_resolver(
        _INTEGER,
        re.compile(r"^[-+]?(?:0b[0-1_]+|0[0-7_]+|0|[1-9][0-9_]*|0x[0-9a-fA-F_]+)$"),
        list("-+0123456789"),
    )
    Loader.add_implicit_resolver(
        _FLOAT,
        re.compile(
            r"^(?:[-+]?[0-9][0-9_]*\.[0-9_]*(?:[eE][-+][0-9]+)?|\.[0-9][0-9_]*(?:[eE][-+][0-9]+)?"
            r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
        ),
        list("-+0123456789."),
    )
    Loader.add_constructor(_INTEGER, Loader.construct_yaml_int)
    Loader.add_constructor(_FLOAT, Loader.construct_yaml_float)
    return Loader


def _refused(node: yaml.Node, problem: str) -> Exception:
    from yaml.constructor import ConstructorError

    return ConstructorError(None, None, f"found {problem}", node.start_mark)


def _check_number(node: yaml.ScalarNode) -> None:
    """Check integers with explicit tags (``!!int 59:59``), which bypass the resolver."""
    if len(node.value) > _MAX_DIGITS:
        raise _refused(node, f"a number of {len(node.value)} characters, expected at most {_MAX_DIGITS}")
    if ":" in node.value:
        raise _refused(node, "a number in base 60, expected base 10")


def _check_aliases(root: yaml.Node) -> None:
    """Compute the size after alias expansion, before anything is expanded."""
    size: dict[int, int] = {}  # of each node, with aliases expanded
    written = 0  # of all nodes, each counted once
    open_nodes: set[int] = set()
    stack = [(root, False)]
    while stack:
        node, left = stack.pop()
        key = id(node)
        if isinstance(node.value, str):
            parts = []
        else:
            parts = [one for item in node.value for one in (item if isinstance(item, tuple) else (item,))]
        if left:
            open_nodes.discard(key)
            own = 1 + (len(node.value) if isinstance(node.value, str) else 0)
            written += own
            size[key] = own + sum(size[id(part)] for part in parts)
        elif key in open_nodes:
            raise _refused(node, "an alias that contains itself")
        elif key not in size:
            open_nodes.add(key)
            stack.append((node, True))
            stack.extend((part, False) for part in parts)
    if size[id(root)] - written > MAX_ALIAS_SIZE:
        raise _refused(root, f"aliases that expand to more than {MAX_ALIAS_SIZE} values and characters")


def parse_yaml(text: str, where: object) -> Any:
    """Plain data of a YAML document.

    Numbers in base 60 (``1:30``) remain strings; alias expansion is limited to ``MAX_ALIAS_SIZE``.

    Parameters
    ----------
    text
        One document.
    where
        Source file or argument, for messages.

    Raises
    ------
    InputError
        It is not YAML, or alias expansion is too large; with the line.
    """
    import yaml

    try:
        return yaml.load(text, _loader())
    except Exception as error:  # besides YAMLError: errors of int(), float() or datetime() for tagged values
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or type(error).__name__
        raise InputError(where, f"is not valid YAML: {problem}", field=line) from error


def load_yaml(path: Path | str) -> Any:
    """Plain data of a YAML file; see :func:`parse_yaml`.

    Parameters
    ----------
    path
        The file, at most 16 MiB.

    Raises
    ------
    InputError
        The file is missing, not a regular file, too large, not UTF-8 or not YAML.
    """
    return parse_yaml(read_text(path, MAX_HAND_BYTES), path)


def load_yaml_model(path: Path | str, model: type[Model]) -> Model:
    """Read a YAML file into a pydantic model; all problems are reported at once.

    Parameters
    ----------
    path
        The file, at most 16 MiB.
    model
        Pydantic model that the file must match.

    Raises
    ------
    InputError
        Lists the fields that are missing, unknown or of the wrong type; of very many, the first.
    """
    data = load_yaml(path)
    if not isinstance(data, dict):
        raise InputError(path, f"found {type(data).__name__}, expected a mapping of fields")
    return checked_model(path, data, model)


def checked_model(where: Path | str, data: dict[str, Any], model: type[Model]) -> Model:
    """Plain data as a pydantic model; all problems are reported at once.

    Parameters
    ----------
    where
        The file or other source of the data.
    data
        Values by field.
    model
        Pydantic model that the data must match.

    Raises
    ------
    InputError
        Lists the fields that are missing, unknown or of the wrong type; of very many, the first.
    """
    from pydantic import ValidationError

    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = field_problems(error, model)
        # A file of another type lacks most fields: report only the cause.
        wrong_kind = [(place, said) for place, said in problems if place in ("kind", "format")]
        first, text = (problems := wrong_kind or problems)[0]
        texts = [text, *(f"{place}: {said}" for place, said in problems[1:])]
        raise InputError(where, brief_list(texts, "; "), field=first) from error


def save_yaml(path: Path | str, data: dict[str, Any]) -> None:
    """Write plain data (numbers, strings, lists, mappings) as YAML, atomically.

    Parameters
    ----------
    path
        File that is created or replaced.
    data
        Plain data, in the order to be written.
    """
    import yaml

    write_text(path, yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100))
