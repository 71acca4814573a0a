"""Lid and fill level from curves of large deformation (Alt 2016, Secs. 6.3.2, 6.4.2).

Enclosed gas hardly changes the stiffness at small deformation, but makes the curve bend upwards;
a lid constrains the shape of the mouth. Features of one side are ``(log i, log I, II / II_0)`` with II_0 the
quadratic coefficient that would double I at the nominal deformation: the first two scale with
the object, the last is dimensionless. Each state is a Gaussian at each place; the covariance is common
to the states (linear discriminant), so few variants are enough. Symbols: l places, s states.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import InputError, VisuohapticError, from_dict, to_dict
from ...core.files import load_json, write_text
from ...core.map_tasks import map_tasks
from ...core.objects import NOMINAL_N, NOMINAL_m
from ...deformation import ContainerDescription, Contents, PinchPlane, mesh_container, side_vertex
from ..data import HEIGHTS, SIDES, TouchProtocol
from ..data.readings import TouchNoise, TouchReading, fit_curve
from .haptic_model import UNKNOWN
from .unknown_class import posterior_with_unknown

_FORMAT = 1
#: Number of noisy readings of each curve that a model is fitted to.
COPIES = 20
#: Deformations of the simulated curves, mean of both tips [m].
DEFORMATION_m = (0.001, 0.002, 0.003, 0.0045, 0.006, 0.008)


@dataclass(frozen=True, slots=True, eq=False)
class StateCurve:
    """One simulated curve."""

    state: str
    variant: int
    place: str  #: side and height, as y+8
    deformation_m: Float[np.ndarray, "k"]
    force_N: Float[np.ndarray, "k"]


@dataclass(frozen=True, slots=True, eq=False)
class HapticStateModel:
    """Distribution of the features of each state at each place of one object."""

    states: tuple[str, ...]
    places: tuple[str, ...]  #: most accurate first
    mean: Float[np.ndarray, "l s 3"]
    covariance: Float[np.ndarray, "l 3 3"]
    accuracy: Float[np.ndarray, "l"]  #: fraction correct from this place alone, leave-one-variant-out


def simulate_state_curves(
    container: ContainerDescription,
    states: Mapping[str, Contents | None],
    places: Sequence[str],
    *,
    variants: int = 8,
    seed: int = 0,
    spread: float = 0.1,
    around: int = 32,
    workers: int | str = 1,
) -> list[StateCurve]:
    """Curves of one object whose wall thickness and Young's modulus are not known exactly.

    Parameters
    ----------
    container
        Description without ranges.
    states
        Name -> contents; None: open, without its cap.
    places
        As ``y+8``: side and height 1 .. 16.
    variants
        Number of samples of wall and modulus.
    seed
        Of the samples.
    spread
        Relative half-width of the uniform distributions of wall and modulus; 0: nominal values.
    around
        Number of vertices around the wall, a multiple of 4.
    workers
        See :func:`.map_tasks`; each variant is a task.
    """
    rng = np.random.default_rng(seed)
    for place in places:
        _place(place)  # validate before minutes of simulation
    factors = [tuple(1 + rng.uniform(-spread, spread, 2)) for _ in range(variants)]
    simulate = partial(_simulate_variant, container, dict(states), tuple(places), around)
    curves = map_tasks(simulate, list(enumerate(factors)), name="classify train", workers=workers)
    return [curve for _, found in sorted(curves) for curve in found]


def _simulate_variant(
    container: ContainerDescription,
    states: Mapping[str, Contents | None],
    places: Sequence[str],
    around: int,
    task: tuple[int, tuple[float, float]],
) -> list[StateCurve]:
    variant, (thicker, stiffer) = task
    out = []
    for name, contents in states.items():
        changes: dict[str, Any] = {"wall": tuple(value * thicker for value in container.wall)}
        if contents is None:
            changes["top"] = container.top.model_copy(update={"kind": "open", "wall": None})
        shell = mesh_container(container.model_copy(update=changes), around=around)
        planes: dict[str, PinchPlane] = {}
        for place in places:
            side, height = _place(place)
            angle = {"x+": 0.0, "x-": np.pi, "y+": np.pi / 2, "y-": -np.pi / 2}[side]
            plane = planes.setdefault(side, PinchPlane(shell, angle))
            vertex = side_vertex(shell, side, (height - 0.5) / HEIGHTS * shell.height_m)
            try:
                curve = plane.curve(vertex, deformation_m=DEFORMATION_m, contents=contents)
            except VisuohapticError as error:
                raise InputError(f"container {container.name}", str(error), field=place) from error
            # The modulus scales the force of the wall; scaling that of enclosed gas with it is an approximation.
            out.append(StateCurve(name, variant, place, curve.first_m, stiffer * curve.force_N))
    return out


def state_features(i_N_per_m: float, I_N_per_m: float, II: float) -> Float[np.ndarray, "3"]:
    """``(log i, log I, II / II_0)`` of one side.

    Parameters
    ----------
    i_N_per_m, I_N_per_m
        Linear coefficients [N/m], above 0.
    II
        Quadratic coefficient, times (1 cm)^2 / 50 N.
    """
    return np.array([np.log(i_N_per_m), np.log(I_N_per_m), II * (NOMINAL_N / NOMINAL_m) / I_N_per_m])


def fit_state_model(
    curves: Sequence[StateCurve],
    rng: np.random.Generator,
) -> HapticStateModel:
    """Learn Gaussians of each state from curves with added noise, and rank the places.

    The accuracy of a place is measured on variants that were not used in the fit.

    Parameters
    ----------
    curves
        Of all states and places, see :func:`simulate_state_curves`.
    rng
        Source of the noise.

    Raises
    ------
    InputError
        Fewer than two states, or no place with curves of all states.
    """
    states = tuple(dict.fromkeys(curve.state for curve in curves))
    places = tuple(dict.fromkeys(curve.place for curve in curves))
    if len(states) < 2:
        raise InputError("fit_state_model", f"found {len(states)} states, expected at least 2")
    found = []
    for place in places:
        rows, label, group = [], [], []
        for curve in (one for one in curves if one.place == place):
            for _ in range(COPIES):
                features = _read(curve, TouchNoise(), rng)
                if features is not None:
                    rows.append(features)
                    label.append(states.index(curve.state))
                    group.append(curve.variant)
        x, y, g = np.array(rows).reshape(-1, 3), np.array(label), np.array(group)
        if any(np.count_nonzero(y == k) < 4 for k in range(len(states))):
            continue
        hits = []
        for one in np.unique(g):
            held = g == one
            if any(not ((y == k) & ~held).any() for k in range(len(states))):
                continue
            mean, covariance = _gaussians(x[~held], y[~held], len(states))
            hits += (np.argmax(_scores(x[held], mean, covariance), axis=1) == y[held]).tolist()
        mean, covariance = _gaussians(x, y, len(states))
        found.append((float(np.mean(hits)) if hits else float("nan"), place, mean, covariance))
    if not found:
        raise InputError("fit_state_model", "no place has curves of all states")
    found.sort(key=lambda one: -one[0])
    return HapticStateModel(
        states,
        tuple(one[1] for one in found),
        np.stack([one[2] for one in found]),
        np.stack([one[3] for one in found]),
        np.array([one[0] for one in found]),
    )


def state_probability(model: HapticStateModel, readings: Sequence[TouchReading]) -> dict[str, Any]:
    """Probabilities of the states and of ``UNKNOWN`` from the touches, and the most informative place.

    Readings at several places of the same wall are not independent: only the most accurate place that was
    touched is used.

    Parameters
    ----------
    model
        Of this object.
    readings
        Touches of it.
    """
    seen = {}
    for reading in readings:
        for sign, side in zip("+-", reading.sides, strict=True):
            if side is not None and np.isfinite([side.i_N_per_m, side.I_N_per_m, side.II]).all():
                seen[f"{reading.axis}{sign}{reading.height}"] = side
    for k, place in enumerate(model.places):
        # A pinch loads both sides equally.
        side = seen.get(place, seen.get(place.replace("+", "-")))
        if side is None or not (side.i_N_per_m > 0 and side.I_N_per_m > 0):
            continue
        x = state_features(side.i_N_per_m, side.I_N_per_m, side.II)
        score = _scores(x[None], model.mean[k], model.covariance[k])[0]
        known, unknown = posterior_with_unknown(score, -2.0 * score[:, None], np.array([x.size]))
        fraction = {**dict(zip(model.states, known.tolist(), strict=True)), UNKNOWN: unknown}
        return {
            "state": max(fraction, key=lambda name: fraction[name]),
            "probabilities": fraction,
            "place": place,
            "accuracy": float(model.accuracy[k]),
            "best_place": model.places[0],
        }
    return {
        "state": None, "probabilities": None, "place": None, "accuracy": None, "best_place": model.places[0]
    }  # fmt: skip


def save_state_model(path: Path | str, model: HapticStateModel) -> None:
    """Write JSON atomically.

    Parameters
    ----------
    path
        File to write.
    model
        State model.
    """
    content = {"format": _FORMAT, **to_dict(model)}
    write_text(path, json.dumps(content, indent=1) + "\n")


def load_state_model(path: Path | str) -> HapticStateModel:
    """Read and validate a state model written by :func:`save_state_model`.

    Parameters
    ----------
    path
        State model (JSON).

    Raises
    ------
    InputError
        The file does not exist, or is not a state model.
    """

    def parsed(found: Any) -> HapticStateModel:
        return from_dict(HapticStateModel, {k: v for k, v in found.items() if k != "format"}, where=path)

    model = load_json(path, "a state model", parsed, version=_FORMAT)
    count, mean, covariance = len(model.places), model.mean, model.covariance
    good = count > 0 and len(model.states) > 1 and mean.shape[:2] == (count, len(model.states))
    good = good and len(covariance) == count == len(model.accuracy)
    if not (good and np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise InputError(path, "is not a state model: the shapes of its arrays are inconsistent")
    if not (np.linalg.eigvalsh(covariance) > 0).all():
        raise InputError(path, "is not a state model: a covariance is not positive", field="covariance")
    for place in model.places:
        _place(place)
    return model


def _read(curve: StateCurve, noise: TouchNoise, rng: np.random.Generator) -> np.ndarray | None:
    """Features of a closing movement with noise, sampled at the rate of the gripper."""
    if len(curve.deformation_m) < 3:
        return None
    protocol = TouchProtocol()
    step = protocol.close_m_per_s / protocol.rate_Hz
    d = np.arange(1, int(curve.deformation_m[-1] / step) + 1) * step
    f = np.interp(d, np.r_[0.0, curve.deformation_m], np.r_[0.0, curve.force_N])
    try:
        fit = fit_curve(
            d + rng.normal(0, noise.deformation_m, len(d)),
            f + rng.normal(0, noise.force_N, len(d)),
            noise,
            from_contact=True,
        )
    except InputError:
        return None
    if not (fit.I_N_per_m > 0 and np.isfinite(fit.II)):
        return None
    return state_features(fit.i_N_per_m, fit.I_N_per_m, fit.II)


def _gaussians(x: np.ndarray, y: np.ndarray, states: int) -> tuple[np.ndarray, np.ndarray]:
    mean = np.stack([x[y == k].mean(axis=0) for k in range(states)])
    away = x - mean[y]
    # A lower bound for features without noise.
    return mean, away.T @ away / max(len(x) - states, 1) + 1e-6 * np.eye(3)


def _scores(x: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    away = x[:, None, :] - mean
    out: np.ndarray = -0.5 * np.einsum("nsi,ij,nsj->ns", away, np.linalg.inv(covariance), away)
    return out


def _place(text: str) -> tuple[str, int]:
    side, height = text[:2], text[2:]
    if side not in SIDES or not height.isascii() or not height.isdigit() or not 1 <= int(height) <= HEIGHTS:
        raise InputError("place", f"found {text!r}, expected a side and a height 1 to {HEIGHTS}, as y+8")
    return side, int(height)
