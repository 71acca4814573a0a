"""The README for a package index, whose pages know no folder: every relative link becomes an absolute one.

python docs/pypi_readme.py https://HOST/OWNER/REPOSITORY > README.pypi.md

Pictures are taken from REPOSITORY/raw/BRANCH, pages from REPOSITORY/blob/BRANCH, as GitHub and GitLab serve them.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"
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


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.stdout.write(absolute(README.read_text(encoding="utf-8"), *sys.argv[1:3]))
