"""What the library runs with: a list of its dependencies as CycloneDX, and known vulnerabilities of their versions.

    python -m benchmarks.audit --out dist/sbom.json     (make audit, which installs pip-audit first)

The list (SBOM) contains every distribution of this environment that the library needs, with or without extras, by its metadata. The
vulnerabilities are those that ``pip-audit`` knows, which asks a service: without it, or without a connection, that is said, and
only the list is written. Exit code 1: a version has a known vulnerability.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from visuohaptic.core.files import write_text

__all__ = ["bill_of_materials", "known_vulnerabilities", "main"]

ROOT = "visuohaptic"
_TIMEOUT_S = 300.0


def _normal(name: str) -> str:
    """Name of a distribution as PyPI compares it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _needed(root: str) -> dict[str, list[str]]:
    """Installed distributions that one needs, each with those that it needs itself, by normal names."""
    found: dict[str, list[str]] = {}
    waiting = [_normal(root)]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        needs = {_normal(Requirement(text).name) for text in metadata.distribution(name).requires or ()}
        found[name] = sorted(one for one in needs - {name} if _is_installed(one))
        waiting += found[name]
    return found


def _is_installed(name: str) -> bool:
    try:
        metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return False
    return True


def bill_of_materials(root: str = ROOT) -> dict[str, Any]:
    """The installed dependencies of a distribution as a CycloneDX 1.5 document.

    Parameters
    ----------
    root
        The distribution.
    """

    def reference(name: str) -> str:
        return f"pkg:pypi/{name}@{metadata.version(name)}"

    def component(name: str, kind: str) -> dict[str, Any]:
        about = metadata.metadata(name).json
        licence = str(about.get("license_expression") or about.get("license") or "")
        # Some distributions have the whole text of their licence in this field.
        named = [{"license": {"name": licence}}] if licence and "\n" not in licence else []
        kinds = [text for text in about.get("classifier") or () if text.startswith("License ::")]
        named = named or [{"license": {"name": text.rpartition(":: ")[2]}} for text in kinds]
        entry = {"type": kind, "bom-ref": reference(name), "name": name, "version": metadata.version(name)}
        return entry | {"purl": reference(name)} | ({"licenses": named} if named else {})

    needed = _needed(root)
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": component(_normal(root), "library")},
        "components": [component(name, "library") for name in sorted(needed) if name != _normal(root)],
        "dependencies": [
            {"ref": reference(name), "dependsOn": [reference(one) for one in needs]}
            for name, needs in sorted(needed.items())
        ],
    }


def known_vulnerabilities(
    document: dict[str, Any], command: tuple[str, ...] = (sys.executable, "-m", "pip_audit")
) -> tuple[list[str] | None, str]:
    """Vulnerabilities of the components of a document, one line each; None if they cannot be known, with the reason.

    Parameters
    ----------
    document
        From :func:`bill_of_materials`.
    command
        How ``pip-audit`` is called.
    """
    pinned = "".join(f"{one['name']}=={one['version']}\n" for one in document["components"])
    with tempfile.TemporaryDirectory() as folder:
        listed = Path(folder, "requirements.txt")
        listed.write_text(pinned, encoding="utf-8")
        options = ["--requirement", str(listed), "--no-deps", "--disable-pip", "--format", "json"]
        try:
            done = subprocess.run(
                [*command, *options], capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return None, str(error)
    try:
        packages = json.loads(done.stdout)["dependencies"]
    except (ValueError, KeyError, TypeError):
        return None, (done.stderr.strip().splitlines() or ["no output"])[-1]
    return [
        f"{one['name']} {one['version']}: {flaw['id']}, fixed in {', '.join(flaw['fix_versions']) or 'no version'}"
        for one in packages
        for flaw in one.get("vulns", ())
    ], ""


def main() -> int:
    """Write the list, and print known vulnerabilities."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("dist/sbom.json"))
    out = parser.parse_args().out
    document = bill_of_materials()
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, json.dumps(document, indent=2) + "\n")
    print(f"{out}: {len(document['components'])} distributions")
    found, reason = known_vulnerabilities(document)
    if found is None:
        print(f"their vulnerabilities are not known here, pip-audit says: {reason}")
        return 0
    print("\n".join(found) or "no known vulnerability")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
