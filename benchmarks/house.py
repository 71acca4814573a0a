"""Metrics of the code base: structure, size, names and documentation.

    python -m benchmarks.house            print a table
    python -m benchmarks.house --list     print every location behind each figure
    python -m benchmarks.house --json     print the figures as JSON

Reads the source as text and runs none of it. Dead code is what ``vulture`` reports as unused in ``src``, ``tests`` and
``benchmarks``, if it is installed (dependency group ``lint``); names used in a way that it cannot detect
are in ``benchmarks/used_names.txt``, one per line with the reason.
"""

from __future__ import annotations

import argparse
import ast
import gc
import json
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ._mutant import find_constants

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src"
USED_NAMES = Path(__file__).with_name("used_names.txt")
_TARGET = re.compile(r"\b(\w+(?:\.\w+)+):[a-z_]\w*")
MAX_MODULES, MAX_LINES, MAX_FUNCTION_LINES, MAX_ARGUMENTS = 14, 400, 60, 8


@dataclass(frozen=True, slots=True)
class Module:
    """One file of the package."""

    name: str  #: dotted
    path: Path
    text: str
    tree: ast.Module
    nodes: tuple[ast.AST, ...]  #: of the tree

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"

    @property
    def is_kernel(self) -> bool:
        return self.path.name.endswith("_kernels.py")

    def functions(self) -> Iterator[ast.FunctionDef]:
        """Its functions and methods, including nested ones."""
        return (node for node in self.nodes if isinstance(node, ast.FunctionDef))


def read_modules(source: Path = SOURCE) -> dict[str, Module]:
    """Every module below a folder by its dotted name."""
    found = {}
    for path in sorted(source.rglob("*.py")):
        parts = list(path.relative_to(source).with_suffix("").parts)
        if parts[-1] == "__init__":
            parts.pop()
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        found[".".join(parts)] = Module(".".join(parts), path, text, tree, tuple(ast.walk(tree)))
    return found


def code_lines(module: Module) -> int:
    """Lines with code: no docstrings, comments or blank lines."""
    quoted: set[int] = set()
    for node in module.nodes:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.body:
            first = node.body[0]
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                quoted |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    written = ((number, line.strip()) for number, line in enumerate(module.text.split("\n"), 1))
    lines = {number for number, line in written if line and not line.startswith("#")}
    # A text over several lines may hold empty ones, and some that look like comments.
    for node in module.nodes:
        if isinstance(node, ast.Constant | ast.JoinedStr) and node.end_lineno != node.lineno:
            lines |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines - quoted)


def imported_modules(module: Module, modules: dict[str, Module]) -> Iterator[str]:
    """Modules of the package that a module imports; names of a package, ``room.name`` too, are resolved to their definition.

    A text ``package.module:function`` names what is started in a process of its own, as in the commands of a verb's help.
    """
    rooms: dict[str, Module] = {}
    for node in module.nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from (name for name in _TARGET.findall(node.value) if name in modules)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom):
            base = module.name.split(".")
            if node.level:
                base = base[: len(base) - node.level + module.is_package]
                source = ".".join(base + ([node.module] if node.module else []))
            else:
                source = node.module or ""
            for alias in node.names:
                if (found := modules.get(f"{source}.{alias.name}")) is not None:
                    yield found.name
                    if found.is_package:
                        rooms[alias.asname or alias.name] = found
                elif source in modules:
                    yield _defining(modules[source], alias.name, modules)
    for node in module.nodes if rooms else ():
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in rooms:
            yield _defining(rooms[node.value.id], node.attr, modules)


def _defining(module: Module, name: str, modules: dict[str, Module]) -> str:
    """Follow a name of a package through its stub."""
    if module.is_package and (source := _listed(module.path.with_suffix(".pyi")).get(name)) is not None:
        place = f"{module.name}.{source}"
        return place if place in modules else module.name
    return module.name


@cache
def _listed(stub: Path) -> dict[str, str]:
    """Module of each name that a stub imports; none without a stub."""
    if not stub.exists():
        return {}
    nodes = ast.walk(ast.parse(stub.read_text(encoding="utf-8")))
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in reversed(imports) for alias in node.names}


def unreached(modules: dict[str, Module]) -> list[str]:
    """Modules that are not reachable from a verb (except ``reproduce``), task, page or ROS node."""
    package = min(modules, key=len)

    def below(name: str, *places: str) -> bool:
        return f"{name}.".startswith(tuple(f"{package}.{place}." for place in places))

    figures = {name for name in modules if below(name, "reproduce", "cli.verbs.system.reproduce")}
    waiting = [name for name in modules if below(name, "cli", "tasks", "viewer", "ros", "__main__")]
    reached = set(figures)
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting += imported_modules(modules[name], modules)
    return [name for name, module in modules.items() if name not in reached and not module.is_package]


def circles(modules: dict[str, Module]) -> list[list[str]]:
    """Groups of modules that import one another: strongly connected components with more than one."""
    names = list(modules)
    edges = [
        (names.index(name), names.index(other))
        for name, module in modules.items()
        for other in set(imported_modules(module, modules)) - {name}
    ]
    rows, columns = np.array(edges, int).reshape(-1, 2).T
    graph = coo_array((np.ones(len(edges)), (rows, columns)), shape=(len(names), len(names)))
    _, labels = connected_components(graph, connection="strong")
    groups: dict[int, list[str]] = defaultdict(list)
    for name, label in zip(names, labels, strict=True):
        groups[label].append(name)
    return [sorted(group) for group in groups.values() if len(group) > 1]


def dead_code(source: Path) -> list[str] | None:
    """Functions, classes, imports and unreachable lines that nothing uses; None if vulture is not installed."""
    try:
        from vulture import Vulture
    except ImportError:
        return None
    search = Vulture(ignore_decorators=["@*validator*", "@*serializer*"])
    visit = search.visit
    # Without visits to the nodes that have neither names nor children: a third of all.
    bare = ast.expr_context | ast.operator | ast.unaryop | ast.cmpop | ast.boolop
    search.visit = lambda node: None if isinstance(node, bare) else visit(node)
    users = [source.parent / name for name in ("tests", "benchmarks")]
    search.scavenge([source, *(folder for folder in users if folder.is_dir())])
    used = {line.split()[0] for line in USED_NAMES.read_text(encoding="utf-8").splitlines() if line.strip()}
    kinds = {"class", "function", "method", "property", "import", "unreachable_code"}
    return [
        f"{Path(item.filename).relative_to(source)}:{item.first_lineno} {item.message}"
        for item in search.get_unused_code(min_confidence=60)
        if item.typ in kinds and item.name not in used and Path(item.filename).is_relative_to(source)
    ]


def public_names(module: Module) -> set[str]:
    """Functions and classes without underscore, kernels apart; where ``__all__`` lists other names, too, what it lists."""
    for node in module.tree.body:
        if isinstance(node, ast.Assign) and any(getattr(t, "id", "") == "__all__" for t in node.targets):
            try:
                return set(ast.literal_eval(node.value))
            except ValueError:
                return set()
    if module.is_kernel:
        return set()
    defined = (node for node in module.tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef))
    return {node.name for node in defined if not node.name.startswith("_")}


def public_functions(module: Module) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Public functions, and public methods of public classes."""
    names = public_names(module)
    for node in module.tree.body:
        if isinstance(node, ast.FunctionDef) and node.name in names:
            if not any("overload" in ast.unparse(mark) for mark in node.decorator_list):
                yield node.name, node
        elif isinstance(node, ast.ClassDef) and node.name in names:
            for member in node.body:
                if isinstance(member, ast.FunctionDef) and (
                    not member.name.startswith("_") or member.name in ("__init__", "__call__")
                ):
                    yield f"{node.name}.{member.name}", member


def arguments(function: ast.FunctionDef) -> list[str]:
    """Names of the parameters, without self and cls."""
    spec = function.args
    names = [a.arg for a in (*spec.posonlyargs, *spec.args, *spec.kwonlyargs)]
    names += [a.arg for a in (spec.vararg, spec.kwarg) if a is not None]
    return [name for name in names if name not in ("self", "cls")]


def documented(function: ast.FunctionDef, others: str = "") -> bool:
    """Whether the docstring, or one that it stands in for, names every parameter in its section.

    ``others`` is the docstring of the class for ``__init__``, else those of the methods it overrides.
    """
    texts = [ast.get_docstring(function) or "", others]
    sections = "\n".join(text.partition("Parameters\n-")[2] for text in texts)
    lines = {
        word.strip().lstrip("*")
        for line in sections.splitlines()
        if line and not line.startswith(" ")
        for word in line.split(":")[0].split(",")
    }
    return all(name in lines for name in arguments(function))


def overridden(classes: dict[str, ast.ClassDef], holder: str, method: str) -> str:
    """Docstrings of the methods of the same name in the bases of a class of the package."""
    found = []
    for base in classes[holder].bases if holder in classes else ():
        name = ast.unparse(base).partition("[")[0].rpartition(".")[2]
        for member in classes[name].body if name in classes else ():
            if isinstance(member, ast.FunctionDef) and member.name == method:
                found.append(ast.get_docstring(member) or "")
        found.append(overridden(classes, name, method))
    return "\n".join(found)


def measure(source: Path = SOURCE) -> dict[str, list[str]]:
    """Every figure as the list of its locations, for the package in a folder."""
    gc.disable()  # its passes over a million nodes of syntax trees find nothing, and are a quarter of the CPU time
    try:
        return _measured(source)
    finally:
        gc.enable()


def _measured(source: Path) -> dict[str, list[str]]:
    modules = read_modules(source)
    found: dict[str, list[str]] = defaultdict(list)
    found["lines of code"] = [f"{name} {code_lines(module)}" for name, module in modules.items()]
    found["lines not reached (code lines of modules on no path from a verb, task, page or ROS node)"] = [
        f"{name} {code_lines(modules[name])}" for name in unreached(modules)
    ]
    folders = Counter(module.path.parent for module in modules.values() if not module.is_package)
    found[f"folders with more than {MAX_MODULES} modules"] = [
        f"{folder.relative_to(source)} {count}" for folder, count in folders.items() if count > MAX_MODULES
    ]
    classes: dict[str, list[str]] = defaultdict(list)
    commands = {"run", "add_arguments"}
    trees = {
        node.name: node
        for module in modules.values()
        for node in module.tree.body
        if isinstance(node, ast.ClassDef)
    }
    for name, module in modules.items():
        lines = module.text.count("\n")
        if lines > MAX_LINES:
            found[f"files over {MAX_LINES} lines"].append(f"{name} {lines}")
        for function in module.functions():
            if not module.is_kernel and not is_compiled(function):
                length = (function.end_lineno or 0) - function.lineno + 1 - _quoted(function)
                if length > MAX_FUNCTION_LINES or len(arguments(function)) > MAX_ARGUMENTS:
                    found[f"functions over {MAX_FUNCTION_LINES} lines or {MAX_ARGUMENTS} arguments"].append(
                        f"{name}:{function.name} {length} lines, {len(arguments(function))} arguments"
                    )
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef) and node.name in public_names(module):
                classes[node.name].append(name)
        for title, function in public_functions(module):
            if title in commands and ".cli.verbs." in name:
                continue
            holder, _, method = title.partition(".")
            others = (
                ast.get_docstring(trees[holder]) or ""
                if method == "__init__"
                else overridden(trees, holder, method)
            )
            kind = "documented" if documented(function, others) else "not"
            found[f"public functions, parameters {kind}"].append(f"{name}:{title}")
    found["public class names that occur twice"] = [
        f"{name} {' '.join(places)}" for name, places in classes.items() if len(places) > 1
    ]
    found["circles of imports"] = [" <-> ".join(group) for group in circles(modules)]
    found["module constants with a number"] = [
        f"{name}:{constant}" for name, module in modules.items() for constant in find_constants(module.tree)
    ]
    if (dead := dead_code(source)) is not None:
        found["dead code (functions, classes, imports) by vulture"] = dead
    return found


def is_compiled(function: ast.FunctionDef) -> bool:
    """Whether a function is a kernel."""
    return any(
        "kernel" in ast.unparse(mark) or "jit" in ast.unparse(mark) for mark in function.decorator_list
    )


def _quoted(function: ast.FunctionDef) -> int:
    first = function.body[0]
    text = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return (first.end_lineno or 0) - first.lineno + 1 if text and ast.get_docstring(function) else 0


def figures(found: dict[str, list[str]]) -> dict[str, float]:
    """One number for each figure."""
    out: dict[str, float] = {}
    for title, places in found.items():
        if title.startswith("lines"):
            out[title] = sum(int(place.split()[-1]) for place in places)
        elif not title.startswith("public functions"):
            out[title] = len(places)
    good = len(found["public functions, parameters documented"])
    total = good + len(found["public functions, parameters not"])
    out["public functions with all parameters documented, %"] = round(100 * good / max(total, 1), 1)
    for title in (
        f"folders with more than {MAX_MODULES} modules",
        f"files over {MAX_LINES} lines",
        f"functions over {MAX_FUNCTION_LINES} lines or {MAX_ARGUMENTS} arguments",
    ):
        out.setdefault(title, 0)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description="Figures of the rooms, the words and the documentation.")
    parser.add_argument("--list", action="store_true", help="every place behind each figure")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found = measure()
    if args.json:
        print(json.dumps(figures(found), indent=1))
        return
    for title, value in figures(found).items():
        print(f"{value:>10g}  {title}")
    if not any("vulture" in title for title in found):
        print(f"{'-':>10}  dead code: vulture is not installed")
    if args.list:
        for title, places in found.items():
            if title not in ("lines of code", "public functions, parameters documented"):
                print(f"\n{title}:", *places, sep="\n  ")


if __name__ == "__main__":
    main()
