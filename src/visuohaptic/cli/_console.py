"""Output of the verbs: results to stdout, everything else to stderr."""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from types import TracebackType
from typing import Any, Generic, Self, TextIO, TypeVar

from ..core.errors import InputError
from ._result_text import result_lines

Item = TypeVar("Item")

#: Seconds after which a plain progress line is due ...
PLAIN_SECONDS = 5.0
#: ... or after this fraction of the work, but never more often than once per second.
PLAIN_SHARE = 0.1


class OutputClosedError(Exception):
    """The reader of the output has closed it (``visuohaptic ... | head``)."""


#: Exit code of a valid problem without a result: there is no plan, or no frame could be measured.
NO_RESULT = 3


class Arguments(argparse.Namespace):
    """Arguments of a verb, and its console."""

    json: bool  #: the result goes to stdout as JSON, every report to stderr
    verbose: bool
    quiet: bool
    console: Console
    parsers: Callable[[], dict[str, tuple[str, argparse.ArgumentParser]]]  #: help and parser of every verb
    exit_code: int = 0  #: a verb sets another when only part of its work was done
    given: frozenset[str] = frozenset()  #: options whose value is not the default, as ``--plot``

    def refuse(self, options: str, problem: str, remedy: str = "") -> None:
        """Reject options that cannot be combined with the others.

        Parameters
        ----------
        options
            Separated by spaces; the first that is given is named.
        problem, remedy
            Of the error.

        Raises
        ------
        InputError
            One of them is given.
        """
        for option in options.split():
            if option in self.given:
                raise InputError(option, problem, remedy=remedy)

    def report(self, text: str = "") -> None:
        """Print a line of text.

        Parameters
        ----------
        text
            One line, without its end.
        """
        self.console.report(text)

    def progress(self, work: Iterable[Item] | int, description: str) -> Progress[Item]:
        """Show the progress of a long task; iterate over it, or call its ``advance``.

        Parameters
        ----------
        work
            What to iterate over, or the number of steps.
        description
            What is being done, one or two words.
        """
        return self.console.progress(work, description)


class Console:
    """Text, JSON, progress and errors of a command.

    Parameters
    ----------
    json
        The result goes to stdout as JSON, everything else to stderr.
    quiet
        Errors only.
    verbose
        Log messages of all levels.
    """

    def __init__(self, *, json: bool = False, quiet: bool = False, verbose: bool = False) -> None:
        self.json = json
        self.quiet = quiet
        self.verbose = verbose
        self._reported = False

    def report(self, text: str = "") -> None:
        """Print a line of text: on stdout, or on stderr when stdout carries JSON.

        Parameters
        ----------
        text
            One line, without its end.
        """
        self._reported = True
        if not self.quiet:
            _write(sys.stderr if self.json else sys.stdout, text)

    def result(self, value: Any) -> None:
        """Print the result as JSON where requested, otherwise as lines if the verb printed nothing.

        Parameters
        ----------
        value
            Mappings, sequences, dataclasses, numbers and texts.
        """
        from ..core.files.plain_json import dumps, plain  # with NumPy, which no help needs

        if self.json:
            _write(sys.stdout, dumps(value))
        elif not self._reported and not self.quiet:
            for line in result_lines(plain(value)):
                _write(sys.stdout, line)

    def error(self, text: str) -> None:
        """Print an error on one line.

        Parameters
        ----------
        text
            What was found, what was expected, where, and what to do.
        """
        _write(sys.stderr, "visuohaptic: error: " + " ".join(text.split()))

    def progress(self, work: Iterable[Item] | int, description: str) -> Progress[Item]:
        """Progress over an iterable, or over a number of steps that the caller advances.

        Parameters
        ----------
        work, description
            As of :meth:`Arguments.progress`.
        """
        return Progress(work, description, quiet=self.quiet)

    def line(self) -> LiveLine:
        """One line that shows the current state, used as a context manager."""
        return LiveLine(quiet=self.quiet)

    def start_logging(self) -> None:
        """Send the library's log to stderr."""
        level = logging.ERROR if self.quiet else logging.DEBUG if self.verbose else logging.WARNING
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(_LogLine())
        logger = logging.getLogger("visuohaptic")
        logger.handlers[:] = [handler]
        logger.setLevel(level)
        logger.propagate = False
        # Its only message of that level: why the first run takes longer.
        logging.getLogger("visuohaptic.core.kernels.compiler").setLevel(
            level if self.quiet else min(level, logging.INFO)
        )


class _LogLine(logging.Formatter):
    """``visuohaptic: warning: text``, in the format of the errors; information without its level."""

    def format(self, record: logging.LogRecord) -> str:
        level = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
        text = f"visuohaptic: {level}{record.getMessage()}"
        return f"{text}\n{self.formatException(record.exc_info)}" if record.exc_info else text


def _write(stream: TextIO, text: str) -> None:
    try:
        stream.write(text + "\n")
        stream.flush()
    except BrokenPipeError as error:
        raise OutputClosedError from error


class LiveLine:
    """The current state: on a terminal one line that is overwritten, elsewhere one line per second.

    Parameters
    ----------
    quiet
        Show nothing.
    stream
        Where it is shown; stderr by default.
    clock
        Seconds of a monotonic clock.
    """

    def __init__(
        self,
        *,
        quiet: bool = False,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._quiet, self._clock = quiet, clock
        self._stream = stream if stream is not None else sys.stderr
        self._over = self._stream.isatty()
        self._shown_s = -float("inf")
        self._open = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()

    def show(self, text: str) -> None:
        """Show a state; states that change faster than they can be read are skipped.

        Parameters
        ----------
        text
            One line, without its end.
        """
        now_s = self._clock()
        if self._quiet or now_s - self._shown_s < (0.1 if self._over else 1.0):
            return
        self._shown_s = now_s
        if self._over:
            self._stream.write(f"\r\x1b[K{text}")
            self._stream.flush()
            self._open = True
        else:
            _write(self._stream, text)

    def end(self) -> None:
        """Keep the last state; further output starts on a new line."""
        if self._open:
            _write(self._stream, "")
        self._open = False


class Progress(Generic[Item]):
    """A progress bar on a terminal, occasional lines in a log file.

    Use it in one of two ways::

        for frame in args.progress(frames, "reading"): ...

        with args.progress(300, "driving") as bar:
            bar.advance(text="contact")

    Parameters
    ----------
    work
        What to iterate over, or the number of steps (0 when unknown). The length of an iterable is that of
        ``len`` or ``frame_count``.
    description
        What is being done, one or two words.
    quiet, stream, clock
        As of :class:`LiveLine`.
    """

    def __init__(
        self,
        work: Iterable[Item] | int,
        description: str,
        *,
        quiet: bool = False,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._items: Iterable[Item] = () if isinstance(work, int) else work
        self.total: int = (
            work
            if isinstance(work, int)
            else len(work)
            if isinstance(work, Sized)
            else getattr(work, "frame_count", None) or 0
        )
        self.done = 0
        self._description = description
        self._quiet = quiet
        self._stream = stream if stream is not None else sys.stderr
        self._clock = clock
        self._bar: Any = None
        self._task: Any = None
        self._text = ""
        self._started_s = self._printed_s = clock()
        self._printed_done = 0

    def __iter__(self) -> Iterator[Item]:
        with self:
            for item in self._items:
                yield item
                self.advance()

    def __enter__(self) -> Self:
        self._started_s = self._printed_s = self._clock()
        if not self._quiet and self._stream.isatty():
            self._open_bar()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
        elif not self._quiet and kind is None and self.done > self._printed_done:
            self._print_line()

    def advance(self, steps: int = 1, text: str = "") -> None:
        """Count ``steps`` more as done; ``text`` is shown after the numbers.

        Parameters
        ----------
        steps
            How many more.
        text
            Shown after the numbers.
        """
        self.done += steps
        self._text = text
        if self._quiet:
            return
        if self._bar is not None:
            self._bar.update(self._task, advance=steps, note=text)
            return
        waited_s = self._clock() - self._printed_s
        fraction = (self.done - self._printed_done) / self.total if self.total else 0.0
        if waited_s >= PLAIN_SECONDS or (waited_s >= 1.0 and fraction >= PLAIN_SHARE):
            self._print_line()

    def _print_line(self) -> None:
        elapsed_s = self._clock() - self._started_s
        line = f"{self._description}: {self.done}"
        if self.total:
            line += f"/{self.total} ({100 * self.done / self.total:.0f} %)"
        line += f", {elapsed_s:.0f} s"
        if 0 < self.done < self.total:
            line += f", about {elapsed_s * (self.total - self.done) / self.done:.0f} s left"
        _write(self._stream, line + (f", {self._text}" if self._text else ""))
        self._printed_s, self._printed_done = self._clock(), self.done

    def _open_bar(self) -> None:
        from rich.console import Console as RichConsole
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as RichProgress

        self._bar = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            console=RichConsole(file=self._stream),
        )
        self._task = self._bar.add_task(self._description, total=self.total or None, note="")
        self._bar.start()
