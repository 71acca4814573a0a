"""Size of the part of the foam sensor that decides whether a frame is read, and how accurately.

python -m benchmarks.foam_guards   prints the lines of code and the thresholds of each of its modules, and their sums

A threshold is a comparison (not for equality) with a number other than 0 and 1, or with a constant that is one; places
that compare with the same constant are one. Fixed parts of a likelihood, and the states and columns of arrays, are none.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.house import SOURCE, code_lines, read_modules

#: The modules of ``sensing.foam`` between the contours and the force.
GUARDS = (
    "edges",
    "posterior",
    "shadowed",
    "deflection",
    "validity",
    "_chain_kernels",
    "_light_kernels",
    "_posterior_kernels",
    "_texture_kernels",
)


def thresholds(tree: ast.Module) -> Iterator[str]:
    """The constants, and the comparisons with literal numbers, each once.

    Parameters
    ----------
    tree
        A module.
    """
    indices = {
        name.id
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call)
        for name in ast.walk(node.targets[0])
        if isinstance(name, ast.Name)
    }
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare) and not isinstance(
            node.ops[0], ast.Eq | ast.NotEq | ast.Is | ast.In
        ):
            names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and n.id.isupper()}
            places = {
                id(n) for sub in ast.walk(node) if isinstance(sub, ast.Subscript) for n in ast.walk(sub.slice)
            }
            numbers = (n.value for n in ast.walk(node) if isinstance(n, ast.Constant) and id(n) not in places)
            if named := names - indices - STATES:
                found.update(dict.fromkeys(named))
            elif any(isinstance(n, int | float) and n not in (0, 1) for n in numbers):
                found[ast.unparse(node)] = None
    yield from found


#: States of an edge and columns of tables, which other modules define.
STATES = frozenset({"FOAM", "SHADOW", "OCCLUDER", "NOTHING"})


def measure(source: Path = SOURCE, names: Sequence[str] = GUARDS) -> dict[str, tuple[int, list[str]]]:
    """Lines of code and thresholds of some modules of the foam sensor.

    Parameters
    ----------
    source
        Folder that contains the package.
    names
        Its modules.
    """
    modules = read_modules(source / "visuohaptic" / "sensing" / "foam")
    return {name: (code_lines(modules[name]), sorted(thresholds(modules[name].tree))) for name in names}


def main() -> None:
    """Print the figures."""
    argparse.ArgumentParser(prog="python -m benchmarks.foam_guards", description=__doc__).parse_args()
    found = measure()
    for name, (lines, limits) in found.items():
        print(f"{name}: {lines} lines, {len(limits)} thresholds", *limits, sep="\n    ")
    total = sum(lines for lines, _ in found.values()), sum(len(limits) for _, limits in found.values())
    print(f"all: {total[0]} lines, {total[1]} thresholds")


if __name__ == "__main__":
    main()
