"""Documentation, help texts and messages use the terms of the field: phrases that were replaced do not come back."""

from __future__ import annotations

import ast
import io
import json
import re
import tokenize
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "visuohaptic"

#: Phrase as a regular expression -> what to write instead.
PHRASES = {
    r"\banew\b": "again",
    r"\baskew\b": "oblique",
    r"\bat home\b": "locally",
    r"\bbeside (?:the|its) (?:truth|numbers)\b": "compared with the truth",
    r"\bby the clock\b": "wall time",
    r"\bcame of it\b": "the result",
    r"\bcomes down to\b": "the effective settings",
    r"\bdear(?:er)?\b": "expensive",
    r"\b(?:in|without|no) doubt\b": "uncertain",
    r"\beverybody\b": "everyone",
    r"\bfor (?:eyes|people)\b": "for display",
    r"\bfore(?:told|seen?|tells?|sight)\b": "predict",
    r"\bforgiv": "reset the failure counter",
    r"\bgives? way\b": "deforms, buckles, moves",
    r"\bgreed": "heuristic weight",
    r"\bgo(?:es)? on (?:after|by|where|with|from)\b": "continue, resume",
    r"\bhalf-made\b": "incomplete",
    r"\bheld against\b": "compared with",
    r"\bhold (?:a|an) \w+ (?:force )?against\b": "compare with",
    r"\bhonest (?:uncertainty|,)": "calibrated",
    r"\bit ends with\b": "press Ctrl-C to stop",
    r"\bjudged?\b": "evaluate, test",
    r"\bkindred\b": "similar",
    r"\blaid on (?:each other|the map|its own map)\b": "matched, aligned",
    r"\bmade (?:again|anew|up|whole)\b": "reproduced, invented, restored",
    r"\bmistakes? of ours\b": "internal error",
    r"\bnothing was (?:tuned|chosen) on\b": "not used for tuning",
    r"\b(?:meshes|scenes|problems|people|pictures) of others\b": "third-party",
    r"\bof (?:yours|ours)\b": "your own, our",
    r"\bpage of this machine\b": "page served on this machine",
    r"\bput out\b": "print",
    r"\bsay(?:s|ing)? (?:what|where)\b": "state, report",
    r"\bso many\b": "n, how many",
    r"\bspoilt\b": "corrupted",
    r"\bstands? (?:for itself|in the log)\b": "is logged",
    r"\bstrangers?\b": "unknown class, new user",
    r"\bthe answer says\b": "the result states",
    r"\bthe whole story\b": "the end-to-end demo",
    r"\btold (?:by|apart|nothing|of|the|to)\b": "given, distinguished, estimated",
    r"\btells? (?:apart|most|the|them|what|where|which|how|nothing)\b": "determine, distinguish, state",
    r"\bwanted\b": "requested, target",
    r"\bway round\b(?!,)": "detour",
    r"\bwhat came\b": "the result",
    r"\bwithout reserve\b": "with probability 1",
}

#: Further phrases of docstrings and comments; "greedy" is a term there.
PROSE = {phrase: instead for phrase, instead in PHRASES.items() if phrase != r"\bgreed"} | {
    r"\bby what\b": "name the quantity",
    r"\bbelieved\b": "estimated",
    r"\bbrush": "push aside",
    r"\bcan bear\b": "limit",
    r"\bcarr(?:y|ies) out\b": "execute",
    r"\bfor good\b": "permanently",
    r"\bgo(?:es)? on\b": "continue",
    r"\bharmless when repeated\b": "may be called repeatedly",
    r"\bin the way\b": "obstacle, occlude",
    r"\bis none of\b": "name what it is",
    r"\blaid (?:on|through)\b": "matched, fitted",
    r"\bmay be (?:off|so)\b": "error, standard deviation",
    r"\bmust not\b": "state the limit or the reason",
    r"\b(?:any|no)body\b": "name the caller or the sensor",
    r"\b(?:says?|said) (?:anything|at|less|little|much|nothing|something|that)\b": "show, measure, state",
    r"\btakes? down\b": "record",
    r"\bthe text\b": "the dissertation",
    r"\btrusted\b": "valid, reliable, used",
}
#: Further phrases of messages: errors, warnings, reasons, labels.
MESSAGES = PROSE | {
    r"\b(?:are|is) no (?:container|indices|message|number|record|touch)\b": "is not a ...",
    r"\bbeside\b": "next to, near",
    r"\bfelt\b": "measured",
    r"\b(?:has|is) gone\b": "lost the connection, was closed",
    r"\bis cut\b": "is truncated",
    r"\bis left of\b": "remains of",
    r"\bmake room\b": "free disk space",
    r"\bmeanwhile\b": "in the meantime",
    r"\b(?:met (?:no|some)thing|nothing met)\b": "no contact, contact",
    r"\bof one (?:name|size)\b": "the same name",
    r"\bround (?:the|it)\b": "around",
    r"\bsays?\b": "declares, states, reports",
    r"\bsomething else than\b": "name what was found",
    r"\btaken back\b": "cancelled",
    r"\bwhatever is\b": "regardless of",
}
#: Packages whose docstrings and comments are in the terms of the field.
PLAIN = (
    "cli",
    "database",
    "deformation",
    "demo",
    "grasping",
    "io",
    "navigation",
    "recognition",
    "reconstruction",
    "report",
    "reproduce",
    "rigs",
    "sensing",
    "simulation",
    "tasks",
    "viewer",
)
#: Names of classes, functions, parameters and variables that were replaced, and the packages without them.
NAMES = re.compile(r"_*(?:[Tt]hings?|told|asked|wanted|(?:most|MOST|least|LEAST)_(?!squares)\w+)")
NAMED = (
    "cli",
    "database",
    "deformation/maps",
    "deformation/nonlinear",
    "deformation/shapes",
    "demo",
    "grasping",
    "io",
    "report",
    "reproduce",
    "rigs",
    "sensing/beam",
    "sensing/push",
    "sensing/readers",
    "sensing/scene",
    "simulation",
    "tasks",
    "viewer",
)

#: Pages whose text comes from the code of a package.
GENERATED = {"gallery.md", "reliability.md"}
PAGES = sorted(
    [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")]
    + [p for p in (ROOT / "docs").rglob("*.md") if p.parent.name != "api" and p.name not in GENERATED]
)


def found(text: str, phrases: dict[str, str] = PHRASES) -> list[str]:
    """The phrases in a text, with what to write instead."""
    flat = " ".join(text.split())
    return [
        f"...{flat[max(0, hit.start() - 30) : hit.end() + 20]}...: write {instead}"
        for phrase, instead in phrases.items()
        for hit in re.finditer(phrase, flat, re.IGNORECASE)
    ]


def prose(text: str) -> str:
    """A page without its code and the generated tables of rooms."""
    text = re.sub(r"^ *```.*?^ *```", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"`[^`]+`", "`code`", text)
    return re.sub(r"<!-- (rooms|floors) -->.*?<!-- end of \1 -->", "", text, flags=re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_has_none_of_the_replaced_phrases(page: Path) -> None:
    assert found(prose(page.read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize(
    "path", sorted((ROOT / "docs/notebooks").glob("*.ipynb")), ids=lambda path: path.stem
)
def test_a_notebook_has_none_of_the_replaced_phrases(path: Path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    assert found(text) == []


def texts(nodes: Iterable[ast.AST]) -> list[str]:
    """The strings of a module of several words, without its docstrings."""
    docs = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    found = [node for node in nodes if isinstance(node, ast.Constant) and id(node) not in docs]
    return [node.value for node in found if isinstance(node.value, str) and " " in node.value.strip()]


def docstrings_and_comments(text: str, nodes: Iterable[ast.AST]) -> list[str]:
    """The docstrings of a module without the lines of parameter names, and its comments."""
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docs = [ast.get_docstring(node) or "" for node in nodes if isinstance(node, kinds)]
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    comments = [token.string for token in tokens if token.type == tokenize.COMMENT]
    return [re.sub(r"^\w+(?:, \w+)*$", "", doc, flags=re.MULTILINE) for doc in docs] + comments


def names(nodes: Iterable[ast.AST]) -> set[str]:
    """The names that a module defines or uses."""
    kinds = (ast.ClassDef, ast.FunctionDef)
    return (
        {node.name for node in nodes if isinstance(node, kinds)}
        | {node.arg for node in nodes if isinstance(node, ast.arg)}
        | {node.id for node in nodes if isinstance(node, ast.Name)}
        | {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    )


def nodes_of(module: str) -> list[ast.AST]:
    """All nodes of a module's syntax tree."""
    return list(ast.walk(ast.parse(module)))


@pytest.mark.parametrize(
    "path", sorted(SOURCE.rglob("*.py")), ids=lambda path: path.relative_to(SOURCE).as_posix()
)
def test_a_module_is_in_the_terms_of_the_field(path: Path) -> None:
    """Its messages and help texts, its docstrings and comments, and its names; each module is parsed once."""
    module, room = path.read_text(encoding="utf-8"), path.relative_to(SOURCE).as_posix()
    nodes = nodes_of(module)
    assert [hit for text in texts(nodes) for hit in found(text, MESSAGES)] == []
    if room.startswith(tuple(f"{one}/" for one in PLAIN)):
        assert [hit for text in docstrings_and_comments(module, nodes) for hit in found(text, PROSE)] == []
    if room.startswith(tuple(f"{one}/" for one in NAMED)):
        assert [name for name in sorted(names(nodes)) if NAMES.fullmatch(name)] == []


def test_the_rooms_are_there() -> None:
    assert [room for room in (*PLAIN, *NAMED) if not (SOURCE / room / "__init__.py").is_file()] == []


def test_the_names_of_a_module_are_searched() -> None:
    module = (
        "class Thing:\n    most_m: float\n\n    def f(self, wanted): return self._told + least_squares(1)\n"
    )
    found = {name for name in names(nodes_of(module)) if NAMES.fullmatch(name)}
    assert found == {"Thing", "most_m", "wanted", "_told"}


def test_a_comment_and_a_docstring_are_searched_and_a_parameter_name_is_not() -> None:
    module = '"""Nobody asks.\n\nParameters\n----------\nwanted\n    A mask.\n"""\nx = 1  #: goes on\n'
    assert (
        len([hit for text in docstrings_and_comments(module, nodes_of(module)) for hit in found(text, PROSE)])
        == 2
    )


def test_a_part_of_a_message_is_searched_and_a_docstring_is_not() -> None:
    module = '''"""It says so."""\nraise ValueError(f"{x}: the header says {y}")\n'''
    assert len([hit for text in texts(nodes_of(module)) for hit in found(text, MESSAGES)]) == 1


def test_the_search_ignores_line_breaks_and_case() -> None:
    (hit,) = found("What the foam\nForeTells is read")
    assert "predict" in hit
    assert found("the container buckles, and the result states why") == []
