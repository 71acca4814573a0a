"""Classification with a decision tree, one question and answer after the other."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from .server import markdown_text
from .stage import Stage


class StepsView:
    """Questions with their answers as touches are made; the last question may be open.

    The classifier calls :meth:`ask`, :meth:`answer` and :meth:`finish`; a page that shows this
    view is updated. The steps are plain texts, so that trees and other planners look the same.

    Parameters
    ----------
    title
        Headline.
    steps
        Questions with their answers so far.
    result
        Resulting class; empty while undecided.
    """

    def __init__(self, title: str, steps: Sequence[tuple[str, str]] = (), result: str = "") -> None:
        self.title = title
        self._steps = [(str(question), str(answer)) for question, answer in steps]
        self._result = result
        self._stage: Stage | None = None
        self._lock = threading.Lock()

    @property
    def steps(self) -> tuple[tuple[str, str], ...]:
        """Questions and answers; an open question has an empty answer."""
        return tuple(self._steps)

    def ask(self, question: str) -> None:
        """Add the next question, to be answered later.

        Parameters
        ----------
        question
            Text of the question.
        """
        with self._lock:
            self._steps.append((question, ""))
            self._refresh()

    def answer(self, answer: str) -> None:
        """Answer the open question.

        Parameters
        ----------
        answer
            Text of the answer.
        """
        with self._lock:
            if self._steps and not self._steps[-1][1]:
                self._steps[-1] = (self._steps[-1][0], answer)
            self._refresh()

    def finish(self, result: str) -> None:
        """Set the result.

        Parameters
        ----------
        result
            Resulting class.
        """
        with self._lock:
            self._result = result
            self._refresh()

    def draw(self, stage: Stage) -> None:
        """Draw the steps as a growing list.

        Parameters
        ----------
        stage
            Empty stage, which keeps the list.
        """
        self._stage = stage
        stage.keep("steps", stage.gui.add_markdown(self.text(), order=10))

    def text(self) -> str:
        """Markdown: each step is indented one level more, as in the tree."""
        lines = [f"**{markdown_text(self.title)}**", ""]
        for level, (question, answer) in enumerate(self._steps):
            said = f"**{markdown_text(answer)}**" if answer else "*touching ...*"
            lines.append(f"{'  ' * level}- {markdown_text(question)} → {said}")
        if self._result:
            lines.append(f"{'  ' * len(self._steps)}- **It is: {markdown_text(self._result)}**")
        elif not self._steps:
            lines.append("No touch yet.")
        return "\n".join(lines)

    def _refresh(self) -> None:
        if self._stage is not None and (handle := self._stage.get("steps")) is not None:
            handle.content = self.text()
