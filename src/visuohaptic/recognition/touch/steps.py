"""Text log of an exploration while it runs, for a page, a log or a file; and the assumption that its readings contradict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from jaxtyping import Float

from ..data import Touch, TouchReading
from ..trees.tree_nodes import ClassificationTree, feature_name, scaled_features, scaling_touches
from .belief import evidence, update_belief
from .haptic_model import HapticModel
from .nuisances import NUISANCES

#: Standard deviations from which a nuisance is reported as contradicted: for each nuisance, one exploration in 20 by chance.
_CONTRADICTION_SIGMAS = 2.0
#: Question and answer; a pending question has an empty answer.
Step = tuple[str, str]


class Listener(Protocol):
    """Observer of an exploration; :class:`visuohaptic.viewer.StepsView` is one."""

    def ask(self, question: str) -> None:
        """Show a new pending question.

        Parameters
        ----------
        question
            Text of the question.
        """

    def answer(self, answer: str) -> None:
        """Show the answer to the pending question.

        Parameters
        ----------
        answer
            Text of the answer.
        """

    def finish(self, result: str) -> None:
        """Show the result.

        Parameters
        ----------
        result
            Text of the result.
        """


def tree_steps(tree: ClassificationTree, measured: Float[np.ndarray, "16 4"]) -> tuple[tuple[Step, ...], str]:
    """Questions and answers of a tree up to the first missing measurement, and its answer if a leaf is reached.

    Parameters
    ----------
    tree
        Exploration plan.
    measured
        Stiffness [N/m], NaN where not touched.
    """
    steps: list[Step] = []
    for height, axis in scaling_touches(tree.scheme):
        column = 0 if axis == "x" else 2
        both = measured[height - 1, column : column + 2]
        known = bool(np.isfinite(both).all())
        steps.append((f"touch {axis}{height} for the scale", _newtons(both) if known else ""))
        if not known:
            return tuple(steps), ""
    values = scaled_features(measured, tree.scheme)
    node = 0
    while tree.feature[node] >= 0:
        feature, threshold = int(tree.feature[node]), float(tree.threshold[node])
        value, question = float(values[feature]), f"{feature_name(feature)} above {threshold:.3g}?"
        if not np.isfinite(value):
            return (*steps, (question, "")), ""
        above = value > threshold
        steps.append((question, f"{'yes' if above else 'no'}, {value:.3g}"))
        node = int((tree.right if above else tree.left)[node])
    return tuple(steps), tree.classes[int(tree.answer[node])]


def planner_steps(
    model: HapticModel, readings: Sequence[TouchReading], wanted: Touch | None
) -> tuple[tuple[Step, ...], str]:
    """Touches with the posterior after each; and the answer, if no further touch is planned.

    Parameters
    ----------
    model, readings
        As of :func:`.touch_gains`.
    wanted
        Planned touch, or None at the end.
    """
    steps: list[Step] = []
    for count, reading in enumerate(readings, start=1):
        said = update_belief(model, readings[:count]).as_mapping()
        best = sorted(said, key=lambda name: -said[name])[:2]
        felt = _newtons([np.nan if side is None else side.i_N_per_m for side in reading.sides])
        wide = f", {1e3 * reading.width_m:.1f} mm" if np.isfinite(reading.width_m) else ""
        fractions = ", ".join(f"{name} {100 * said[name]:.0f} %" for name in best)
        steps.append((f"touch {reading.axis}{reading.height}", f"{felt}{wide}: {fractions}"))
    if wanted is not None:
        return (*steps, (f"touch {wanted[1]}{wanted[0]}", "")), ""
    belief = update_belief(model, readings)
    return tuple(steps), f"{belief.answer}, {100 * belief.confidence:.0f} %"


def tree_follower(
    tree: ClassificationTree, listener: Listener
) -> Callable[[Float[np.ndarray, "16 4"]], None]:
    """A callback for ``walk(..., follow=)`` that reports each question of the tree and its answer.

    Parameters
    ----------
    tree
        Exploration plan.
    listener
        Observer of the exploration.
    """
    tell = _teller(listener)
    return lambda measured: tell(*tree_steps(tree, measured))


def planner_follower(
    model: HapticModel, listener: Listener
) -> Callable[[Sequence[TouchReading], Touch | None], None]:
    """A callback for ``explore(..., follow=)`` that reports each touch and the posterior after it.

    Parameters
    ----------
    model
        Of the candidates.
    listener
        Observer of the exploration.
    """
    tell = _teller(listener)
    return lambda readings, wanted: tell(*planner_steps(model, readings, wanted))


def _teller(listener: Listener) -> Callable[[Sequence[Step], str], None]:
    """Callback that reports the steps that are new since its last call."""
    asked = answered = 0

    def tell(steps: Sequence[Step], result: str) -> None:
        nonlocal asked, answered
        for number, (question, answer) in enumerate(steps):
            if number >= asked:
                listener.ask(question)
                asked += 1
            if answer and number >= answered:
                listener.answer(answer)
                answered += 1
        if result:
            listener.finish(result)

    return tell


def _newtons(values: Sequence[float] | Float[np.ndarray, "2"]) -> str:
    return " and ".join(f"{value / 1e3:.3g}" for value in values if np.isfinite(value)) + " N/mm"


def contradicted_assumption(model: HapticModel, readings: Sequence[TouchReading]) -> str:
    """Deviation of the exploration or the object with which the readings fit the most probable class; "" for none.

    Parameters
    ----------
    model, readings
        As of :func:`update_belief`, of one object.
    """
    place, value, noise = evidence(model, readings)
    if not len(place):
        return ""
    belief = update_belief(model, readings)
    best = int(np.argmax(np.where(model.answer_of < len(model.answers) - 1, belief.weight, -1.0)))
    seen = model.covariance[best][np.ix_(place, place)] + np.diag(noise)
    effect = model.nuisance[best][:, place]
    # Posterior means of nuisances with a standard normal prior; that of the height in units of an accurate pose.
    sigmas = effect @ np.linalg.solve(seen, value - model.mean[best, place])
    sigmas *= np.where(np.array(NUISANCES) == "height", model.pose[best], 1.0)
    worst = int(np.argmax(np.abs(sigmas)))
    settings, much = model.settings, float(sigmas[worst])
    name = model.answers[model.answer_of[best]]
    if abs(much) >= _CONTRADICTION_SIGMAS:
        height = 1e3 * settings.pose_m * much
        said = (
            f"that is {100 * np.expm1(settings.gain * much):+.0f} % stiffer, or read so",
            f"pressed {abs(height):.1f} mm {'higher' if height > 0 else 'lower'}",
            f"with a zero of the force that is {settings.zero_N * much:+.2f} N wrong",
            f"with a contact that is {1e3 * settings.zero_m * much:+.2f} mm wrong",
            f"with a stiffness of {np.exp(settings.mouth * much):.2f} times that of the training objects at the mouth",
            f"{'flattened less' if much > 0 else 'flattened more'} easily, as {'with' if much > 0 else 'without'} a lid",
        )[worst]
        return f"the readings fit {name} {said}"
    if model.spread[best] > 1:
        return f"the readings fit {name} outside the range of the training objects"
    return ""
