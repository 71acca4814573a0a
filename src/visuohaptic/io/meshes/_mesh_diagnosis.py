"""Locates the defect in a mesh file that could not be read, in the file's own numbering."""

from __future__ import annotations

import re
import struct

from ...core.files.csv_table import is_number


def diagnose(kind: str, data: bytes) -> str:
    """The first defect of an OBJ or STL file; empty if none is found.

    Only for files that could not be read: it parses all lines.

    Parameters
    ----------
    kind
        File suffix, ``.obj`` or ``.stl``.
    data
        Contents of the file.
    """
    if kind == ".obj":
        return _obj(data)
    if kind == ".stl":
        return _stl(data)
    return ""


def first_zero_index(data: bytes) -> str:
    """Locate an index 0 in an OBJ file.

    OBJ indices start at 1; readers silently interpret 0 as the last vertex.

    Parameters
    ----------
    data
        Contents of the file.
    """
    if re.search(rb"^f[^\n]*?[ \t]0+(?=[/ \t\r\n]|$)", data, re.MULTILINE):
        return _obj(data)
    return ""


def _obj(data: bytes) -> str:
    vertices = sum(1 for line in data.splitlines() if line.lstrip()[:2] in {b"v ", b"v\t"})
    seen = faces = 0
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if words[0] == "v":
            seen += 1
            if len(words) < 4 or not all(is_number(word) for word in words[1:4]):
                return f"line {number}: vertex {seen} is {_shown(words[1:])}, expected three numbers"
        if words[0] != "f":
            continue
        faces += 1
        if len(words) < 4:
            return f"line {number}: face {faces} has {len(words) - 1} corners, expected at least 3"
        for word in words[1:]:
            text = word.split("/")[0]
            try:
                index = int(text)
            except ValueError:
                return f"line {number}: face {faces} refers to vertex {text[:20]!r}, expected a whole number"
            if index == 0:
                return f"line {number}: face {faces} refers to vertex 0, OBJ counts from 1"
            if index > vertices or index < -seen:
                return f"line {number}: face {faces} refers to vertex {index}, the file has {vertices}"
    return ""


def _stl(data: bytes) -> str:
    if data[:5].lower() == b"solid" or len(data) < 84:
        return "is neither a complete ASCII STL nor a binary one" if len(data) < 84 else ""
    triangles = struct.unpack("<I", data[80:84])[0]
    there = (len(data) - 84) // 50
    return f"declares {triangles} triangles, but the file has room for {there}" if triangles != there else ""


def _shown(words: list[str]) -> str:
    return repr(" ".join(words)[:40])
