"""Rows of a long campaign, saved line by line, so that an interrupted campaign can be continued."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from visuohaptic.core.map_tasks import map_tasks

__all__ = ["Journal"]


class Journal:
    """Rows by key, in a file of JSON lines; without a path they are kept in memory only.

    The first line tells what the campaign was; a file of another one is refused. A last line that was cut off is
    dropped.
    """

    def __init__(self, path: Path | None, about: dict[str, Any]) -> None:
        self.path = path
        self.rows: dict[str, Any] = {}
        if path is None:
            return
        if path.exists() and (text := path.read_text(encoding="utf-8")):
            whole = text[: text.rfind("\n") + 1]
            lines = [json.loads(line) for line in whole.splitlines()]
            if not lines or lines[0] != about:
                raise SystemExit(f"{path}: is of another campaign, name another report or remove it")
            self.rows = {line["key"]: line["row"] for line in lines[1:]}
            if whole != text:
                path.write_text(whole, encoding="utf-8")
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(about) + "\n", encoding="utf-8")

    def __contains__(self, key: str) -> bool:
        return key in self.rows

    def put(self, key: str, row: Any) -> None:
        """Store a row; it is on disk when this returns."""
        self.rows[key] = json.loads(json.dumps(row))
        if self.path is not None:
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps({"key": key, "row": row}) + "\n")

    def fill(self, function: Callable[[Any], Any], tasks: Mapping[str, Any], workers: int | str = 1) -> None:
        """Compute the rows that are missing, each from its task; on processes or a cluster, see :func:`map_tasks`."""
        missing = [key for key in tasks if key not in self]
        found = map_tasks(function, [tasks[key] for key in missing], name="campaign", workers=workers)
        for done, (number, row) in enumerate(found, 1):
            self.put(missing[number], row)
            print(f"{missing[number]}: {done} of {len(missing)}", flush=True)
