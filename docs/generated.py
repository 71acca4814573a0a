"""Writes what the source already says: the pages of the API, and the tables of rooms in the architecture page.

python docs/generated.py          write them
python docs/generated.py --check  say which are not what would be written; exit code 1
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "visuohaptic"
API = ROOT / "docs" / "api"
ARCHITECTURE = ROOT / "docs" / "architecture.md"


def idea(package: Path) -> str:
    """First sentence of a package's docstring."""
    text = ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def rooms(package: Path) -> list[Path]:
    """A package and all packages inside it, those without modules of their own apart."""
    return sorted({path.parent for path in package.rglob("__init__.py")})


def modules(room: Path) -> list[str]:
    """Dotted names of the public modules of a room."""
    folder = "visuohaptic." + ".".join(room.relative_to(SOURCE).parts)
    return [f"{folder}.{path.stem}" for path in sorted(room.glob("[a-z]*.py"))]


def packages() -> list[Path]:
    """Packages with a public interface."""
    return sorted(path.parent for path in SOURCE.glob("*/__init__.py") if path.parent.name != "cli")


def api_page(package: Path) -> str:
    """The page of one package: each room with its idea and its modules."""
    lines = [f"# visuohaptic.{package.name}", "", idea(package), ""]
    for room in rooms(package):
        if room != package and modules(room):
            lines += [f"## {room.relative_to(SOURCE).as_posix().replace('/', '.')}", "", idea(room), ""]
        for name in modules(room):
            lines += [f"::: {name}", ""]
    return "\n".join(lines)


def index_page() -> str:
    """The table of packages."""
    rows = [
        f"| [`visuohaptic.{package.name}`]({package.name}.md) | {idea(package)} |" for package in packages()
    ]
    return "\n".join(["# API", "", "| package | idea |", "|---|---|", *rows, ""])


def contracts() -> list[dict[str, object]]:
    """Layers of the house and of its rooms, as import-linter holds them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    return [contract for contract in settings["contracts"] if contract["type"] == "layers"]


def floors_table() -> str:
    """Floor, packages and their ideas, from the first contract."""
    layers = [layer for layer in contracts()[0]["layers"] if layer != "__main__"]
    rows = ["| floor | package | idea |", "|---|---|---|"]
    for floor, layer in zip(range(len(layers))[::-1], layers, strict=True):
        names = layer.split(" | ")
        ideas = [idea(SOURCE / name) if (SOURCE / name).is_dir() else "the version" for name in names]
        rows.append(f"| {floor} | {', '.join(f'`{name}`' for name in names)} | {' '.join(ideas)} |")
    return "\n".join(rows)


def rooms_table() -> str:
    """Every room: what it is for, how many names it offers, and the rooms beside it that it may import."""
    below: dict[str, list[str]] = {}
    for contract in contracts()[1:]:
        container = contract["containers"][0].removeprefix("visuohaptic.")
        layers = [layer.split(" | ") for layer in contract["layers"]]
        for index, layer in enumerate(layers):
            for name in layer:
                below[f"{container}.{name}"] = [other for lower in layers[index + 1 :] for other in lower]
    rows = ["| room | idea | public names | may import, of its package |", "|---|---|---|---|"]
    for package in packages():
        for room in rooms(package):
            name = room.relative_to(SOURCE).as_posix().replace("/", ".")
            if "." not in name or not modules(room):
                continue
            imports = ", ".join(f"`{other}`" for other in below.get(name, ()))
            rows.append(f"| `{name}` | {idea(room)} | {len(exported(room))} | {imports} |")
    return "\n".join(rows)


def exported(room: Path) -> list[str]:
    """Public names of a room, by its stub or its ``__all__``."""
    stub = room / "__init__.pyi"
    tree = ast.parse((stub if stub.exists() else room / "__init__.py").read_text(encoding="utf-8"))
    return [alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]


def architecture() -> str:
    """The page with its tables between their markers replaced."""
    text = ARCHITECTURE.read_text(encoding="utf-8")
    for name, table in (("floors", floors_table()), ("rooms", rooms_table())):
        pattern = rf"(<!-- {name} -->\n).*?(\n<!-- end of {name} -->)"
        text, count = re.subn(pattern, lambda m, table=table: f"{m[1]}{table}{m[2]}", text, flags=re.DOTALL)
        if count != 1:
            raise SystemExit(f"{ARCHITECTURE}: found {count} places <!-- {name} -->, expected 1")
    return text


def generated() -> dict[Path, str]:
    """Every generated page with its text."""
    pages = {API / f"{package.name}.md": api_page(package) for package in packages()}
    return {**pages, API / "index.md": index_page(), ARCHITECTURE: architecture()}


def main() -> int:
    """Write the pages, or tell which are out of date."""
    pages = generated()
    stale = [
        path for path, text in pages.items() if not path.exists() or path.read_text(encoding="utf-8") != text
    ]
    stale += sorted(set(API.glob("*.md")) - set(pages))
    for path in stale:
        print(path.relative_to(ROOT))
        if "--check" not in sys.argv:
            path.unlink() if path not in pages else path.write_text(pages[path], encoding="utf-8")
    return int(bool(stale) and "--check" in sys.argv)


if __name__ == "__main__":
    sys.exit(main())
