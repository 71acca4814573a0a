"""Files that are either whole or not there, and YAML read through a schema."""

from __future__ import annotations

import os
import reprlib
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from .errors import InputError

if TYPE_CHECKING:
    from pydantic import BaseModel

    Model = TypeVar("Model", bound=BaseModel)

__all__ = ["atomic_path", "load_yaml", "load_yaml_model", "read_text", "save_yaml", "write_text"]

#: YAML files larger than this are refused before they are parsed (bytes).
MAX_YAML_BYTES = 16 * 1024 * 1024
#: Mappings with more entries are refused: merge keys multiply what the file holds.
MAX_YAML_ENTRIES = 100_000

_BRIEF = reprlib.Repr()
_BRIEF.maxlevel, _BRIEF.maxstring, _BRIEF.maxother, _BRIEF.maxlong = 3, 60, 60, 60


@contextmanager
def atomic_path(target: Path | str) -> Iterator[Path]:
    """Write to the yielded temporary path; on success it replaces ``target``.

    The data is flushed to the disk before the rename, so that after a power
    cut either the old or the new file is there, never half of one.

    Raises
    ------
    InputError
        The folder does not exist or cannot be written, or ``target`` is a folder itself.
    """
    target = Path(target)
    if not target.parent.is_dir():
        raise InputError(target, "its folder does not exist", remedy=f"create {target.parent}")
    if target.is_dir():
        raise InputError(target, "is a folder, expected the name of a file to write")
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{target.stem}.", suffix=f".part{target.suffix}", dir=target.parent
        )
    except OSError as error:
        raise InputError(target, f"cannot be written ({error.strerror})") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb+") as written:
            os.fsync(written.fileno())
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(target: Path | str, text: str) -> None:
    """Write a whole UTF-8 text file, or nothing."""
    with atomic_path(target) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_text(path: Path | str, max_bytes: int, *, error: type[InputError] = InputError) -> str:
    """Text of a UTF-8 file whose size was looked at first; a byte order mark is taken off.

    Raises
    ------
    InputError
        As ``error``: the file is missing, larger than ``max_bytes`` or not UTF-8.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise error(path, f"has {size} bytes, expected at most {max_bytes}")
        return path.read_text(encoding="utf-8-sig")
    except OSError as problem:
        raise error(path, f"cannot be read ({problem.strerror})") from problem
    except UnicodeDecodeError as problem:
        raise error(path, f"is not UTF-8 text (byte {problem.start})") from problem


def load_yaml(path: Path | str) -> Any:
    """Read a YAML file safely.

    Raises
    ------
    InputError
        The file is missing, too large, not UTF-8 or not YAML.
    """
    import yaml

    path = Path(path)
    text = read_text(path, MAX_YAML_BYTES)

    class Loader(yaml.SafeLoader):
        """Safe, and no more entries by merged mappings than a file could hold."""

        def flatten_mapping(self, node: Any) -> None:
            super().flatten_mapping(node)
            if len(node.value) > MAX_YAML_ENTRIES:
                raise yaml.constructor.ConstructorError(
                    None, None, f"a mapping of more than {MAX_YAML_ENTRIES} entries", node.start_mark
                )

    try:
        return yaml.load(text, Loader)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or type(error).__name__
        raise InputError(path, f"is not valid YAML: {problem}", field=line) from error


def load_yaml_model(path: Path | str, model: type[Model]) -> Model:
    """Read a YAML file into a pydantic model; all problems are reported at once.

    Raises
    ------
    InputError
        With every field that is missing, unknown or of the wrong kind.
    """
    from pydantic import ValidationError

    data = load_yaml(path)
    if not isinstance(data, dict):
        raise InputError(path, f"found {type(data).__name__}, expected a mapping of fields")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False, include_context=False)
        first = ".".join(str(part) for part in problems[0]["loc"]) or "file"
        texts = []
        for index, problem in enumerate(problems):
            place = ".".join(str(part) for part in problem["loc"]) or "file"
            # Not repr: of nested aliases it would be as large as the memory.
            found = _BRIEF.repr(problem["input"])
            found = found if len(found) <= 60 else found[:57] + "..."
            said = f"{problem['msg']} (found {found})"
            texts.append(said if index == 0 else f"{place}: {said}")
        raise InputError(path, "; ".join(texts), field=first) from error


def save_yaml(path: Path | str, data: dict[str, Any]) -> None:
    """Write plain data (numbers, texts, lists, mappings) as YAML, whole or not at all."""
    import yaml

    write_text(path, yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100))
