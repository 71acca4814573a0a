"""``visuohaptic completion``: a script with which a shell completes verbs, options and their choices.

writes
  stdout   the script, made from the arguments of this version

To load it in every shell, add source <(visuohaptic completion bash) to ~/.bashrc, the same with zsh to ~/.zshrc after
compinit, and write the script for fish to ~/.config/fish/completions/visuohaptic.fish.

example: visuohaptic completion bash
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from shlex import quote
from typing import Any, NamedTuple


class _Option(NamedTuple):
    """One argument of a verb."""

    flags: tuple[str, ...]  #: none: a word by its place
    valued: bool  #: whether a word follows
    choices: tuple[str, ...]  #: none: any word, often a file
    help: str


class _Verb(NamedTuple):
    """One verb."""

    help: str
    options: tuple[_Option, ...]

    @property
    def placed(self) -> tuple[str, ...]:
        """Choices of words by their place."""
        return tuple(word for option in self.options if not option.flags for word in option.choices)


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("shell", str, "shell that reads the script", choices=tuple(_SCRIPTS))


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    verbs = {name: _Verb(said, tuple(_options(parser))) for name, (said, parser) in args.parsers().items()}
    script = "\n".join(_SCRIPTS[args.shell](verbs, _groups(verbs)))
    args.report(script)
    return {"shell": args.shell, "script": script}


def _options(parser: argparse.ArgumentParser) -> Iterator[_Option]:
    formatter = parser._get_formatter()
    for action in parser._actions:
        said = " ".join(formatter._expand_help(action).split()) if action.help else ""
        choices = tuple(map(str, action.choices or ()))
        yield _Option(tuple(action.option_strings), action.nargs != 0, choices, said)


def _groups(verbs: Mapping[str, _Verb]) -> dict[str, dict[str, str]]:
    """First words of verbs of two words -> their second words and help."""
    found: dict[str, dict[str, str]] = {}
    for name, verb in verbs.items():
        first, _, second = name.partition(" ")
        if second:
            found.setdefault(first, {})[second] = verb.help
    return found


def _first_words(verbs: Mapping[str, _Verb], groups: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """First words and what is said of them."""
    alone = {name: verb.help for name, verb in verbs.items() if " " not in name}
    return alone | {name: ", ".join(seconds) for name, seconds in groups.items()}


def _bash(verbs: Mapping[str, _Verb], groups: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    yield "_visuohaptic() {"
    yield "    local word=${COMP_WORDS[COMP_CWORD]} last=${COMP_WORDS[COMP_CWORD-1]} verb=${COMP_WORDS[1]} words="
    yield f'    case $verb in {"|".join(groups)}) ((COMP_CWORD > 2)) && verb+=" ${{COMP_WORDS[2]}}" ;; esac'
    yield "    case $((COMP_CWORD > 1)):$verb in"
    yield f'        0:*) words="{" ".join(_first_words(verbs, groups))}" ;;'
    for first, seconds in groups.items():
        yield f'        1:{first}) words="{" ".join(seconds)}" ;;'
    for name, verb in verbs.items():
        yield f'        "1:{name}") case $last in'
        for option in verb.options:
            if option.flags and option.valued:
                yield f'            {"|".join(option.flags)}) words="{" ".join(option.choices)}" ;;'
        flags = " ".join(flag for option in verb.options for flag in option.flags)
        yield f'            *) [[ $word == -* ]] && words="{flags}" || words="{" ".join(verb.placed)}" ;;'
        yield "        esac ;;"
    yield "    esac"
    yield '    COMPREPLY=($(compgen -W "$words" -- "$word"))'
    yield "}"
    yield "complete -o default -F _visuohaptic visuohaptic"


def _zsh(verbs: Mapping[str, _Verb], groups: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    def listed(words: Mapping[str, str]) -> str:
        entries = " ".join(quote(f"{word}:{said}") for word, said in words.items())
        return f"local -a found=({entries}); _describe verb found"

    yield "#compdef visuohaptic"
    yield "_visuohaptic() {"
    yield '    local verb="$words[2]" skip=1'
    yield f'    case $verb in {"|".join(groups)}) ((CURRENT > 3)) && verb+=" $words[3]" skip=2 ;; esac'
    yield f"    if ((CURRENT == 2)); then {listed(_first_words(verbs, groups))}; return; fi"
    yield "    shift $skip words; ((CURRENT -= skip))"
    yield "    case $verb in"
    for first, seconds in groups.items():
        yield f"        {first}) {listed(seconds)} ;;"
    for name, verb in verbs.items():
        yield f'        "{name}") _arguments \\'
        for option in verb.options:
            said = "".join(f"\\{letter}" if letter in "[]:\\" else letter for letter in option.help)
            value = _zsh_value(option.choices) * option.valued
            yield from (f"            {quote(f'*{flag}[{said}]{value}')} \\" for flag in option.flags)
        yield f"            {quote('*' + _zsh_value(verb.placed))} ;;"
    yield "    esac"
    yield "}"
    yield "compdef _visuohaptic visuohaptic"


def _zsh_value(choices: tuple[str, ...]) -> str:
    return f":value:({' '.join(choices)})" if choices else ":file:_files"


def _fish(verbs: Mapping[str, _Verb], groups: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    yield "function __visuohaptic_verb"
    yield "    set -l given (commandline -opc)"
    yield "    set -l last (math 1 + (count $argv))"
    yield '    test "$argv" = "$given[2..$last]"'
    yield "end"

    def words(found: Mapping[str, str], count: int, also: str = "") -> Iterator[str]:
        for word, said in found.items():
            where = f"test (count (commandline -opc)) = {count}{also}"
            yield f"complete -c visuohaptic -f -n '{where}' -a {word} -d {quote(said)}"

    yield from words(_first_words(verbs, groups), 1)
    for first, seconds in groups.items():
        yield from words(seconds, 2, f"; and __visuohaptic_verb {first}")
    for name, verb in verbs.items():
        for option in verb.options:
            names = " ".join(
                f"-l {flag[2:]}" if flag.startswith("--") else f"-s {flag[1:]}" for flag in option.flags
            )
            value = f"-x -a '{' '.join(option.choices)}'" if option.choices else "-r" * option.valued
            if option.flags or option.choices:
                where = f"complete -c visuohaptic -n '__visuohaptic_verb {name}' {names}"
                yield f"{where} {value if names else value.replace('-x', '-f')} -d {quote(option.help)}"


_SCRIPTS = {"bash": _bash, "zsh": _zsh, "fish": _fish}
