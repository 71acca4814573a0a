"""The command ``visuohaptic``: finds the verb, loads only that verb's module, and turns errors into one line.

A verb is a line of ``VERBS`` (what it does) and a module with

- ``add_arguments(add)``, its arguments;
- ``run(args) -> dict | None``, the work; the mapping is what ``--json`` prints;
- its docstring, whose first line names it; the rest, what it reads and writes with an example, is the
  end of its help;
- optionally ``NEEDS: tuple[str, ...]``, modules beyond the core that it always imports on its way, and
  ``needs(args) -> set[str]``, those that depend on the arguments; what an argument of several verbs needs
  is in ``_extras``. All are checked before it runs;
- optionally ``KERNELS: tuple[str, ...]``, packages or modules whose kernels it needs, the last ones first, or
  ``kernels(args)``: while the command compiles the first ones, another process compiles the last ones.

A verb whose work was done in part only sets ``args.exit_code``.

Exit codes: 0 done, 1 internal error, 2 bad input or usage, 3 valid input without a solution (no plan),
130 interrupted, 141 the reader of the output has closed it.
"""

from __future__ import annotations

import argparse
import importlib
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from types import ModuleType

from .._version import __version__
from ..core.errors import VisuohapticError
from ._arguments import (
    Add,
    Parser,
    UsageError,
    almost,
    check_figure,
    given_options,
    with_signed_axes,
    wrong_argument,
)
from ._console import Arguments, Console, OutputClosedError

#: Heading of the overview -> room of ``cli.verbs``, verb and one line of help; kept here so that the overview imports
#: no verb.
_TABLE: Mapping[str, tuple[tuple[str, str, str], ...]] = {
    "first steps": (
        ("system", "demo", "run the end-to-end demo on a simulated robot; --quick shows a recorded one"),
        ("system", "start", "set up a foam sensor step by step, from a camera to live newtons"),
        ("examples", "example foam", "write a small simulated recording of a foam sensor"),
        ("examples", "example beam", "write a small simulated recording of a beam sensor"),
        ("examples", "example gripper", "write a small simulated recording of a gripper's finger"),
        ("examples", "example glass", "write a small simulated depth sequence of clear bottles"),
        ("examples", "example office", "write a map with tagged objects to plan on"),
        ("examples", "example task", "run a task in its simulated world and write its trace"),
        ("system", "doctor", "check every library, and show what to install"),
    ),
    "force and motion from a camera": (
        ("sensing", "sense foam", "measure force and shape with a strip of foam that a camera watches"),
        ("sensing", "sense beam", "measure force and moment, six axes, with templates on a bending rod"),
        ("sensing", "sense scene", "track obstacles ahead, the motion of the floor and the pushed object"),
        ("sensing", "track", "track printed templates and AprilTags, and estimate their 6D poses"),
        ("sensing", "compare", "compare a measured force with a scale or with another run"),
    ),
    "set-up and calibration": (
        ("system", "cameras", "list the cameras that are connected"),
        ("system", "defaults", "write a configuration file: every setting, its default and what it means"),
        (
            "sensing",
            "calibrate foam",
            "fit a foam's stress-strain curve, or report why the data are unsuitable",
        ),
        ("sensing", "calibrate beam", "fit a beam sensor's compliance from known loads"),
        ("sensing", "calibrate camera", "estimate a camera's intrinsics and lens distortion"),
        ("sensing", "calibrate stripe", "learn the colours of a stripe on the foam from one image"),
        ("sensing", "template sheet", "write a print-ready sheet of AprilTags 36h11"),
        ("sensing", "template check", "predict how well an image can be detected and tracked as a template"),
    ),
    "maps and navigation": (
        ("planning", "map inspect", "summarise a map, and where a robot can drive on it"),
        ("planning", "map build", "build an occupancy map from laser scans and odometry"),
        ("planning", "map graph", "compute distance, cost, skeleton graph and regions of a map"),
        ("planning", "plan", "plan navigation among movable obstacles: where to drive, what to push"),
    ),
    "surfaces and transparent objects": (
        ("geometry", "reconstruct", "fuse a depth sequence into a surface, and detect transparent parts"),
        (
            "geometry",
            "complete",
            "complete a surface by touch where it was not seen, and plan the next touch",
        ),
        ("geometry", "recording info", "summarise a recording: topics, frames, duration, damage"),
        (
            "geometry",
            "recording capture",
            "record a depth sequence with a RealSense or Orbbec camera and a printed tag",
        ),
        ("geometry", "recording import", "convert depth images and poses of another layout into a sequence"),
        ("geometry", "recording recover", "restore the recording of a run that was interrupted"),
    ),
    "containers and grasps": (
        ("planning", "stiffness", "compute the stiffness of a container at every surface point"),
        ("planning", "squeeze", "compute force against deformation of one pinch on a container"),
        ("planning", "grasp", "plan grasps on deformable containers"),
    ),
    "objects and recognition": (
        (
            "knowledge",
            "classify train",
            "train a classification tree and a touch planner, or a model of states",
        ),
        ("knowledge", "classify plan", "show the planned touches in their order"),
        ("knowledge", "classify run", "classify an object from touches, and plan the next touch"),
        ("knowledge", "objects list", "list the objects of a database"),
        ("knowledge", "objects show", "show all that is known of one object"),
        ("knowledge", "objects add", "add an object, or new evidence of a known one"),
        ("knowledge", "objects import", "import objects from folders with cards"),
        ("knowledge", "objects export", "export objects as folders with cards"),
        ("knowledge", "objects sync", "synchronise with a shared database"),
        ("knowledge", "objects search", "find the objects with the most similar features"),
        ("knowledge", "objects recognise", "rank what a seen object may be, with probabilities"),
        ("knowledge", "objects build", "compute stiffness maps and features of whole container classes"),
    ),
    "robots, display and reproduction": (
        ("system", "ros bridge", "run the sensors as a ROS 2 node: image topics in, forces out"),
        ("system", "ros node", "run one lifecycle node of ROS 2: sensors, tracking, planning, recognition"),
        ("system", "ros echo", "list the topics of a robot, or print the messages of one"),
        ("system", "ros launch", "run several nodes from a launch file, with or without ROS"),
        ("system", "view", "show objects, maps with plans, surfaces and classifications in the browser"),
        ("system", "reproduce", "reproduce figures and tables of the dissertation and compare the values"),
        ("system", "warmup", "compile all kernels now, so that later starts are fast"),
        ("system", "completion", "print a script with which bash, zsh or fish completes the command line"),
    ),
}

#: Verb -> module and one line of help.
VERBS: Mapping[str, tuple[str, str]] = {
    verb: (f"visuohaptic.cli.verbs.{room}.{verb.replace(' ', '_')}", text)
    for entries in _TABLE.values()
    for room, verb, text in entries
}

#: What to do about an unexpected error, without and with --verbose.
_ADVICE = ("run again with --verbose for the traceback", "please report it with the traceback below")
_GLOBAL_FLAGS = {"--json", "--verbose", "-v", "--quiet", "-q"}

_OVERVIEW = """\
visuohaptic {version}: force and shape from a camera, and what a robot does with them

usage: visuohaptic VERB [options]

{verbs}

options of every verb:
  -h, --help         show what the verb reads and writes, with an example
  --json             print the result as JSON on stdout, everything else on stderr
  -v, --verbose      print more, with a traceback for an unexpected error
  -q, --quiet        print errors only
  --version          print the version

Start with: visuohaptic demo --quick, or, with your own camera: visuohaptic start"""


def main(argv: Sequence[str] | None = None, verbs: Mapping[str, tuple[str, str]] = VERBS) -> int:
    """Run one verb and return the exit code.

    Parameters
    ----------
    argv
        The words after ``visuohaptic``; those of this process by default.
    verbs
        The registry; tests hand over their own.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")  # errors of cameras are reported by this library
    for stream in (sys.stdout, sys.stderr):
        if callable(reconfigure := getattr(stream, "reconfigure", None)):
            reconfigure(errors="replace")  # a sigma on an ASCII terminal is no reason to fail
    console = Console(
        json="--json" in words,
        quiet=bool({"-q", "--quiet"} & set(words)),
        verbose=bool({"-v", "--verbose"} & set(words)),
    )
    try:
        return _run(words, console, verbs, meanwhile=argv is None)
    except OutputClosedError:
        # Python would complain once more when it flushes stdout at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except KeyboardInterrupt:
        console.error("interrupted")
        return 130
    except VisuohapticError as error:
        console.error(str(error))
        return 2
    except OSError as error:
        console.error(f"{error.filename or 'input or output'}: {error.strerror or error}")
        return 2
    except MemoryError as error:
        console.error(f"the memory does not suffice ({str(error) or 'none is left'}); use a smaller input")
        return 2
    except Exception as error:  # noqa: BLE001 - the last line of defence: one line, never a traceback
        console.error(f"unexpected {type(error).__name__}: {error}; {_ADVICE[console.verbose]}")
        if console.verbose:
            import traceback

            traceback.print_exc()
        return 1


def _run(words: list[str], console: Console, verbs: Mapping[str, tuple[str, str]], *, meanwhile: bool) -> int:
    verb, rest = _find_verb(words, verbs)
    if verb is None:
        flags = set(words)
        if "--version" in flags:
            sys.stdout.write(f"visuohaptic {__version__}\n")
        else:
            console.json = False
            console.report(_overview(verbs))
        return 0
    if words_of_group := _group(verb, verbs):
        if not {"-h", "--help"} & set(rest):
            raise UsageError(f"{verb}: incomplete verb, expected {_listed(words_of_group)}")
        console.report(_overview({name: verbs[name] for name in words_of_group}))
        return 0
    module = _load(verb, verbs)
    parser = verb_parser(verb, module, verbs)
    try:
        args = parser.parse_args(with_signed_axes(rest), namespace=Arguments())
    except SystemExit as stop:  # argparse has printed the help
        return int(stop.code or 0)
    args.given = given_options(parser, args)
    if problem := wrong_argument(args):
        raise UsageError(f"{verb}: {problem}")
    console = Console(json=args.json, quiet=args.quiet, verbose=args.verbose)
    console.start_logging()
    args.console = console
    args.parsers = lambda: {
        name: (said, verb_parser(name, _load(name, verbs), verbs)) for name, (_, said) in verbs.items()
    }
    from ._extras import compiling

    with compiling(module, args) if meanwhile else nullcontext():
        result = _do(verb, module, args)
    if result is not None:
        console.result(result)
    return args.exit_code


def _do(verb: str, module: ModuleType, args: argparse.Namespace) -> Mapping[str, object] | None:
    """Run a verb when all that it needs is there."""
    from ._extras import check_needs, library_of, missing_library_error

    check_needs(verb, module, args)
    check_figure(args)
    try:
        return module.run(args)
    except VisuohapticError:
        raise
    except ImportError as error:
        if error.name is None or library_of(error.name) is None:
            raise
        raise missing_library_error(error, verb) from error


def verb_parser(
    verb: str, module: ModuleType, verbs: Mapping[str, tuple[str, str]] = VERBS
) -> argparse.ArgumentParser:
    """The parser of one verb, with the options that every verb has.

    Parameters
    ----------
    verb
        Its words, as ``sense foam``.
    module
        Where its arguments are added.
    verbs
        The registry, with its line of help.
    """
    text = verbs[verb][1]
    parser = Parser(
        prog=f"visuohaptic {verb}",
        description=f"{text[:1].upper()}{text[1:]}.",
        epilog=_folded((module.__doc__ or "").partition("\n\n")[2]) or None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        conflict_handler="resolve",  # an option of the verb's own wins
    )
    common = parser.add_argument_group("options of every verb")
    for flags, text in (
        (("--json",), "print the result as JSON on stdout, everything else on stderr"),
        (("-v", "--verbose"), "print more, with a traceback for an unexpected error"),
        (("-q", "--quiet"), "print errors only"),
    ):
        common.add_argument(*flags, action="store_true", help=text)
    module.add_arguments(Add(parser))
    return parser


def _find_verb(words: list[str], verbs: Mapping[str, tuple[str, str]]) -> tuple[str | None, list[str]]:
    """The verb (or group of verbs) that the words name, and the words that are left for it."""
    lead = 0
    while lead < len(words) and words[lead].startswith("-"):
        if words[lead] not in _GLOBAL_FLAGS | {"-h", "--help", "--version"}:
            raise UsageError(f"unknown option {words[lead]} before the verb; see visuohaptic --help")
        lead += 1
    front, named = words[:lead], words[lead:]
    if not named or "--version" in front:
        return None, []
    for count in (2, 1):
        candidate = " ".join(named[:count])
        if candidate in verbs or (count == 1 and _group(candidate, verbs)):
            rest = front + named[count:]
            if candidate not in verbs and len(named) > 1 and not named[1].startswith("-"):
                raise _unknown(" ".join(named[:2]), verbs)
            return candidate, rest
    both = " ".join(named[:2])
    raise _unknown(both if almost(both, verbs) else named[0], verbs)


def _group(name: str, verbs: Mapping[str, tuple[str, str]]) -> list[str]:
    """Verbs that begin with a word that is no verb itself."""
    return [] if name in verbs else [verb for verb in verbs if verb.startswith(name + " ")]


def _unknown(name: str, verbs: Mapping[str, tuple[str, str]]) -> UsageError:
    # A group alone is a word that people write, too.
    words = {verb: verb for verb in verbs} | {
        verb.partition(" ")[0]: verb.partition(" ")[0] for verb in verbs
    }
    words |= {verb.replace(" ", "-"): verb for verb in verbs}
    near = almost(name, words)
    advice = f"did you mean '{words[near]}'?" if near else "see visuohaptic --help"
    return UsageError(f"unknown verb '{name}'; {advice}")


def _listed(names: Sequence[str]) -> str:
    quoted = [f"'{name}'" for name in names]
    return quoted[0] if len(quoted) == 1 else ", ".join(quoted[:-1]) + " or " + quoted[-1]


def _load(verb: str, verbs: Mapping[str, tuple[str, str]]) -> ModuleType:
    name = verbs[verb][0]
    try:
        return importlib.import_module(name)
    except VisuohapticError:
        raise
    except ImportError as error:
        if error.name == name:
            raise UsageError(f"the verb '{verb}' is not part of this version ({__version__})") from error
        from ._extras import missing_library_error

        raise missing_library_error(error, verb) from error


def _overview(verbs: Mapping[str, tuple[str, str]]) -> str:
    width = max(len(verb) for verb in verbs) + 2
    blocks = {heading: [verb for _, verb, _ in entries] for heading, entries in _TABLE.items()}
    if verbs is not VERBS:
        blocks = {"verbs": list(verbs)}
    lines = "\n\n".join(
        "\n".join([f"{heading}:", *(f"  {verb:<{width}}{verbs[verb][1]}" for verb in names)])
        for heading, names in blocks.items()
    )
    return _folded(_OVERVIEW.format(version=__version__, verbs=lines))


def _folded(text: str) -> str:
    """Lines folded to the width of the terminal, below the start of their second column; commands can still be copied."""
    columns, lines = shutil.get_terminal_size().columns, []
    for line in text.split("\n"):
        first = re.match(r" *(\S.*? {2,}(?=\S))?", line)
        indent = " " * (first.end() if first else 0)
        command = re.search(r"(^ *|[Ee]xamples?:? +|: )visuohaptic [a-z]", line)
        lines += [line] if command else textwrap.wrap(line, columns, subsequent_indent=indent) or [""]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
