"""The tested versions satisfy ``pyproject.toml``, and all of them are pinned."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())

#: What ``constraints.txt`` was made on.
TESTED = {"python_version": "3.11", "platform_machine": "x86_64", "sys_platform": "linux"}


def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pairs = [line.split("==") for line in lines if not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in pairs}


def requirements() -> Iterator[Requirement]:
    """All that the Makefile installs: core, the extras of ``all`` and the groups."""
    extras = PROJECT["project"]["optional-dependencies"]
    left = [*PROJECT["project"]["dependencies"], "visuohaptic[all]"]
    left += [text for group in PROJECT["dependency-groups"].values() for text in group]
    seen: set[str] = set()
    while left:
        one = Requirement(left.pop())
        if one.name == "visuohaptic":
            left += [text for extra in one.extras - seen for text in extras[extra]]
            seen |= one.extras
        elif one.marker is None or one.marker.evaluate(TESTED):
            yield one


def test_every_dependency_is_pinned_to_a_version_in_its_range():
    pinned = pins()
    old = {
        str(one): pinned.get(canonicalize_name(one.name), "not pinned")
        for one in requirements()
        if not one.specifier.contains(pinned.get(canonicalize_name(one.name), "0"), prereleases=True)
    }
    assert old == {}, "make constraints.txt anew, in an environment in which the tests pass"


def test_the_file_holds_names_and_versions_only():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = [line for line in lines if not line.startswith("#")]
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in pinned)
    assert pinned == sorted(set(pinned), key=str.lower)
    assert "://" not in "".join(lines)


def test_the_makefile_installs_with_it():
    makefile = (ROOT / "Makefile").read_text()
    assert "-c constraints.txt" in makefile
    assert re.search(r"/\.installed-%: .*constraints\.txt", makefile), (
        "a new version is a reason to install again"
    )
