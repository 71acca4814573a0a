"""The list of dependencies, compared with what pip says; vulnerabilities through a stand-in for pip-audit."""

from __future__ import annotations

import json
import sys
from importlib.metadata import version

import pytest

from benchmarks import audit


@pytest.fixture(scope="module")
def document() -> dict:
    return audit.bill_of_materials()


def test_every_dependency_is_listed_once_with_its_installed_version(document: dict) -> None:
    listed = {one["name"]: one["version"] for one in document["components"]}
    assert len(listed) == len(document["components"])
    assert all(version(name) == number for name, number in listed.items())
    assert {"numpy", "numba", "llvmlite", "scipy", "opencv-python-headless"} <= set(listed), (
        "llvmlite: of numba"
    )
    assert "visuohaptic" not in listed


def test_references_of_the_document_lead_somewhere(document: dict) -> None:
    known = {one["bom-ref"] for one in (*document["components"], document["metadata"]["component"])}
    assert {one["ref"] for one in document["dependencies"]} == known
    assert {to for one in document["dependencies"] for to in one["dependsOn"]} <= known
    numba = next(one for one in document["dependencies"] if one["ref"].startswith("pkg:pypi/numba@"))
    assert f"pkg:pypi/llvmlite@{version('llvmlite')}" in numba["dependsOn"]


FLAW = {"id": "PYSEC-0", "fix_versions": ["9.9"]}


@pytest.mark.parametrize(
    ("program", "found", "reason"),
    [
        ("print('{}')", None, "no output"),
        ("import sys; sys.exit('no connection')", None, "no connection"),
        ("print(DATA)", ["numpy 1.0: PYSEC-0, fixed in 9.9"], ""),
        ("print(DATA.replace('PYSEC', 'X').replace('vulns', 'none'))", [], ""),
    ],
)
def test_what_cannot_be_known_is_said(document: dict, program: str, found: list | None, reason: str) -> None:
    told = json.dumps({"dependencies": [{"name": "numpy", "version": "1.0", "vulns": [FLAW]}]})
    command = (sys.executable, "-c", f"DATA = {told!r}; {program}")
    assert audit.known_vulnerabilities(document, command) == (found, reason)
