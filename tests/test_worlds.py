"""The worlds that make the evidence share no code with the library they judge."""

import ast
from pathlib import Path

WORLDS = Path(__file__).parent / "worlds"


def _imported(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add(node.module or "")
    return names


def test_no_world_imports_the_library_or_its_benchmarks():
    for path in sorted(WORLDS.rglob("*.py")):
        for name in _imported(path):
            assert name.split(".")[0] not in {"visuohaptic", "benchmarks"}, f"{path.name}: {name}"
            assert not name.startswith("tests.") or name.startswith("tests.worlds"), path.name
