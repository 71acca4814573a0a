"""The page of a package index, which knows no folder: every relative link of the README becomes an absolute one.

A build hook of hatchling (``pyproject.toml``): ``make wheel REPOSITORY=https://HOST/OWNER/REPOSITORY`` sets the environment
variable below, without which the README stays as it is. Pictures are taken from REPOSITORY/raw/BRANCH, pages from
REPOSITORY/blob/BRANCH, as GitHub and GitLab serve them.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

README = Path(__file__).resolve().parents[1] / "README.md"
#: Environment variable with the address of the repository.
VARIABLE = "VISUOHAPTIC_REPOSITORY"
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")


def absolute(text: str, repository: str, branch: str = "main") -> str:
    """Replace the relative links of a page at the top of the repository."""

    def link(match: re.Match[str]) -> str:
        picture, words, target = match.groups()
        if "://" in target or target.startswith("#"):
            return match[0]
        return (
            f"{picture}[{words}]({repository.rstrip('/')}/{'raw' if picture else 'blob'}/{branch}/{target})"
        )

    return _LINK.sub(link, text)


def get_metadata_hook() -> type:
    """The class that hatchling asks for the README of a distribution."""
    from hatchling.metadata.plugin.interface import MetadataHookInterface

    class ReadmeHook(MetadataHookInterface):
        def update(self, metadata: dict[str, Any]) -> None:
            text, repository = README.read_text(encoding="utf-8"), os.environ.get(VARIABLE)
            text = absolute(text, repository) if repository else text
            metadata["readme"] = {"content-type": "text/markdown", "text": text}

    return ReadmeHook
