"""Pages that are made from the code: the command line, the changelog, notebooks, and blocks that are not run."""

from __future__ import annotations

import io
import json
import logging
import re
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "src"))

_log = logging.getLogger("mkdocs.hooks")

_COMMANDS = "<!-- commands -->"
_CHANGELOG = "<!-- changelog -->"


def on_files(files: Any, config: Any) -> Any:
    """A page for every notebook; the notebook itself stays beside it, to be downloaded."""
    from mkdocs.structure.files import File

    for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=notebook_page(path)))
    return files


def notebook_page(path: Path) -> str:
    """Text and code of a notebook."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
    title, *rest = parts
    return "\n\n".join([title, f"[Download the notebook]({path.name})", *rest])


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fill in what the code knows; blocks marked ``notest`` look like all others."""
    if _COMMANDS in markdown:
        markdown = markdown.replace(_COMMANDS, commands())
    if _CHANGELOG in markdown:
        # The changelog stands beside ``docs``, its page within.
        text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").replace("](docs/", "](")
        markdown = markdown.replace(_CHANGELOG, text.partition("\n")[2])
    return re.sub(r"^(\s*```python) notest\s*$", r"\1", markdown, flags=re.MULTILINE)


def on_page_content(html: str, **_: Any) -> str:
    """Docstrings name things in the manner of Sphinx, ``:class:`Frame```: keep the name."""
    html = re.sub(r":(?:meth|class|func|mod|attr|exc|data|obj):(<code>)(?:~[\w.]+\.)?", r"\1", html)
    return html


def on_post_build(config: Any, **_: Any) -> None:
    """The search index as a script, which a browser also loads from the disk; the page ``search`` reads it."""
    folder = Path(config["site_dir"]) / "search"
    index = json.loads((folder / "search_index.json").read_text(encoding="utf-8"))
    for entry in index["docs"]:
        entry["text"] = re.sub(r"<[^>]+>", "", entry["text"])
    script = f"var searchIndex = {json.dumps(index['docs'], ensure_ascii=False)};"
    (folder / "search_index.js").write_text(script, encoding="utf-8")


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Warn, which ends a strict build, when a page would load something from elsewhere."""
    if found := re.search(
        r"""<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)=["']?https?://[^>]*>""", output
    ):
        _log.warning("%s loads from elsewhere: %s", page.file.src_path, found[0])
    return output


def commands() -> str:
    """Every verb's ``--help``, from the parser itself."""
    import os

    from visuohaptic.cli.main import VERBS, main

    os.environ["COLUMNS"] = "100"
    parts = ["```text\n" + _printed(main, ["--help"]) + "\n```"]
    for verb, (_, text) in VERBS.items():
        try:
            shown = _printed(main, [*verb.split(), "--help"])
        except RuntimeError:
            shown = f"{text} (not part of this version)"
        parts.append(f"## visuohaptic {verb}\n\n```text\n{shown}\n```")
    return "\n\n".join(parts)


def _printed(main: Any, words: list[str]) -> str:
    stream = io.StringIO()
    with redirect_stdout(stream), redirect_stderr(io.StringIO()):
        code = main(words)
    if code:
        raise RuntimeError(f"visuohaptic {' '.join(words)} ended with code {code}")
    return stream.getvalue().rstrip()
