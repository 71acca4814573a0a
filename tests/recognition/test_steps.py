from __future__ import annotations

import numpy as np

from visuohaptic.recognition.touch import (
    explore,
    fit_model,
    planner_follower,
    planner_steps,
    tree_follower,
    tree_steps,
)
from visuohaptic.recognition.trees import next_touch, train_tree, walk

from .worlds import synthetic, touch_of


class Heard:
    """Keeps what it is told, as a page would show it."""

    def __init__(self) -> None:
        self.steps: list[tuple[str, str]] = []
        self.result = ""

    def ask(self, question: str) -> None:
        assert all(answer for _, answer in self.steps), "one question at a time"
        self.steps.append((question, ""))

    def answer(self, answer: str) -> None:
        self.steps[-1] = (self.steps[-1][0], answer)

    def finish(self, result: str) -> None:
        self.result = result


def test_a_walk_is_heard_step_by_step_and_ends_where_the_tree_ends() -> None:
    data = synthetic()
    tree, heard = train_tree(data), Heard()
    touch = touch_of(data, 40)
    follow, open_questions = tree_follower(tree, heard), []

    def both(height: int, axis: str) -> tuple[float, float]:
        open_questions.append(heard.steps[-1])
        first, second = touch(height, axis).sides
        return first.i_N_per_m, second.i_N_per_m

    answer, touched = walk(tree, both, follow=follow)
    assert heard.result == answer
    assert [answer for _, answer in open_questions] == [""] * len(touched)
    assert heard.steps[0][0] == "touch x8 for the scale"
    assert all(answer for _, answer in heard.steps)
    # The same, asked at once.
    leaf = next_touch(tree, data.features[40, ..., 0])[1]
    assert tree_steps(tree, data.features[40, ..., 0])[1] == tree.classes[int(tree.answer[leaf])]


def test_an_exploration_is_heard_with_what_is_believed() -> None:
    data = synthetic()
    model, heard = fit_model(data), Heard()
    rng = np.random.default_rng(0)
    found = explore(model, touch_of(data, 40), rng=rng, follow=planner_follower(model, heard))
    assert [question for question, _ in heard.steps] == [
        f"touch {reading.axis}{reading.height}" for reading in found.readings
    ]
    assert heard.result.startswith(found.answer)
    assert "N/mm, " in heard.steps[0][1]
    steps, result = planner_steps(model, found.readings[:1], (3, "x"))
    assert steps[-1] == ("touch x3", "")
    assert result == ""
