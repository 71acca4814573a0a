"""Numba's analysis of variables, with the same results: sets of names are bits of an integer while they grow."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from numba.core import analysis
from numba.core.ir import Assign, Inst, Loc, Var

Names = dict[int, set[str]]


def variables(statement: Any, value: Any) -> list[Var]:
    """Numba's search for the variables of a statement: the exact type decides first, since most values are of four types.

    Parameters
    ----------
    statement
        Statement of numba's intermediate representation.
    value
        Anything that it contains.
    """
    kind = type(value)
    if kind is Var:
        return [value]
    if kind is str or kind is Loc or kind is int or value is None:
        return []
    if isinstance(value, Inst):
        return list(value.list_vars())
    if isinstance(value, dict):
        value = value.values()
    elif not isinstance(value, (list, tuple)):
        return []
    return [found for one in value for found in variables(statement, one)]


def uses_and_definitions(blocks: dict[int, Any]) -> Any:
    """Variables that each block reads before it assigns them, and those that it assigns.

    Parameters
    ----------
    blocks
        Basic blocks by their offset.
    """
    uses: Names = {}
    definitions: Names = {}
    for offset, block in blocks.items():
        used: set[str] = set()
        defined: set[str] = set()
        for one in block.body:
            extension = analysis.ir_extension_usedefs.get(type(one))
            if extension is not None:
                extension(one, used, defined)
            elif isinstance(one, Assign):
                read = {var.name for var in variables(one, one.value)}
                if one.target.name not in read:
                    defined.add(one.target.name)
                used |= read - defined
            else:
                used.update(var.name for var in one.list_vars() if var.name not in defined)
        uses[offset], definitions[offset] = used, defined
    return analysis._use_defs_result(usemap=uses, defmap=definitions)


def live_at_entry(flow: Any, blocks: dict[int, Any], uses: Names, definitions: Names) -> Names:
    """Variables that are read later than the entry of each block, and are defined before it.

    Parameters
    ----------
    flow
        Graph of the blocks.
    blocks
        Basic blocks by their offset.
    uses, definitions
        Of each block, see :func:`uses_and_definitions`.
    """
    names = list({name: None for some in (uses, definitions) for found in some.values() for name in found})
    place = {name: index for index, name in enumerate(names)}
    live = {offset: _bits(place, uses[offset]) for offset in blocks}
    defined = {offset: _bits(place, definitions[offset]) for offset in blocks}
    order = flow.topo_order()
    after = {offset: [block for block, _ in flow.successors(offset)] for offset in order}
    before = {offset: [block for block, _ in flow.predecessors(offset)] for offset in order}
    reached = {offset: live[offset] | defined[offset] for offset in blocks}
    while _spread(reached, after, order):
        pass
    changed = True
    while changed:
        changed = False
        for offset in reversed(order):
            for block in before[offset]:
                grown = live[block] | live[offset] & reached[block] & ~defined[block]
                changed |= grown != live[block]
                live[block] = grown
    return {offset: _names(names, bits) for offset, bits in live.items()}


def _spread(reached: dict[int, int], after: dict[int, list[int]], order: Iterable[int]) -> bool:
    """Add the bits of each block to those of the blocks after it; whether any has grown."""
    changed = False
    for offset in order:
        for block in after[offset]:
            grown = reached[block] | reached[offset]
            changed |= grown != reached[block]
            reached[block] = grown
    return changed


def _bits(place: dict[str, int], names: Iterable[str]) -> int:
    bits = 0
    for name in names:
        bits |= 1 << place[name]
    return bits


def _names(names: list[str], bits: int) -> set[str]:
    found = set()
    while bits:
        lowest = bits & -bits
        found.add(names[lowest.bit_length() - 1])
        bits ^= lowest
    return found
