"""The plots show the given numbers."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest

from visuohaptic import report as experiments
from visuohaptic.core import (
    Contact,
    ErrorBudget,
    Estimate,
    Event,
    EventKind,
    ForceProfile,
    HapticTag,
    InputError,
    Reason,
)


def texts(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def labels(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


@pytest.fixture
def profile():
    s_m = np.linspace(-0.1, 0.1, 41)
    delta_m = 5e-3 * np.exp(-((s_m / 0.02) ** 2))
    valid = np.ones(41, bool)
    valid[3] = False
    budget = ErrorBudget(0.003, 0.02, 0.03, 0.004)
    contact = Contact(-0.04, 0.04, 2.5, budget, True, Reason.OK, np.zeros((3, 2)), np.zeros(3), np.ones(3))
    ones = np.ones(41)
    return ForceProfile(
        1.5,
        True,
        Reason.OK,
        2.5,
        budget,
        s_m,
        delta_m,
        1e-5 * ones,
        4e5 * delta_m,
        50 * ones,
        valid,
        (contact,),
    )


def test_force_against_truth_tells_the_error_of_each_run():
    truth_N = np.linspace(0, 10, 50)
    run = experiments.ForceRun("plate", truth_N, truth_N + 0.2)
    upper, lower = experiments.force_against_truth([run]).axes
    assert labels(upper) == ["plate, rms error 0.200 N", "ideal"]
    np.testing.assert_allclose(lower.lines[0].get_ydata(), 0.2)


def test_samples_that_are_not_valid_do_not_count():
    truth_N, valid = np.linspace(0, 10, 50), np.ones(50, bool)
    measured_N = truth_N.copy()
    measured_N[20], valid[20] = 99.0, False
    figure = experiments.force_against_truth([experiments.ForceRun("plate", truth_N, measured_N, valid)])
    assert labels(figure.axes[0])[0] == "plate, rms error 0.000 N"


def test_force_over_time_marks_events_and_reasons():
    t_s = np.arange(0, 3, 0.1)
    valid = np.ones(30, bool)
    valid[10:12] = False
    reasons = [Reason.OK if good else Reason.OCCLUDED for good in valid]
    figure = experiments.force_over_time(
        t_s,
        t_s,
        0.1 + 0 * t_s,
        truth_N=t_s,
        valid=valid,
        reasons=reasons,
        events=[Event(EventKind.CONTACT, 1.0)],
    )
    assert "invalid: occluded" in labels(figure.axes[0])
    assert texts(figure) == ["contact"]
    measured = next(line for line in figure.axes[0].lines if line.get_label() == "measured")
    np.testing.assert_array_equal(np.isnan(measured.get_ydata()), ~valid)


def test_traces_have_a_panel_for_each_unit_and_crosses_where_a_sample_is_not_valid():
    t_s, reasons = np.arange(0, 3, 0.1), ["ok"] * 30
    reasons[10:12] = ["lost", "lost"]
    known = np.where(np.array(reasons) == "ok", 40 - t_s, np.nan)
    ramp = experiments.TimeSeries("x", 2 * t_s, 0.1 + 0 * t_s)
    band = experiments.TimeSeries("z", known, 0.5 + 0 * t_s)
    figure = experiments.traces_over_time(
        t_s, {"force [N]": [ramp], "moment [mNm]": [ramp, band]}, reasons=reasons,
        events=[Event(EventKind.SLIP, 1.0)],
    )  # fmt: skip
    upper, lower = figure.axes
    assert (upper.get_ylabel(), lower.get_ylabel()) == ("force [N]", "moment [mNm]")
    assert labels(upper) == ["x", "± 2 sigma, declared", "invalid: lost"]
    assert labels(lower) == ["x", "z"]
    assert texts(figure) == ["slip"]
    np.testing.assert_array_equal(lower.lines[1].get_ydata(), known)
    heights = lower.collections[1].get_paths()[0].get_extents()
    assert heights.y1 == pytest.approx(41.0)  # two sigma above the first sample
    short = experiments.TimeSeries("x", t_s[:-1], t_s[:-1])
    with pytest.raises(InputError, match="expected one length for all"):
        experiments.traces_over_time(t_s, {"force [N]": [short]}, reasons=reasons)


def test_arrays_that_do_not_belong_together_are_refused():
    with pytest.raises(InputError, match="ForceRun: found arrays of shapes"):
        experiments.force_against_truth(
            [experiments.ForceRun("box", np.zeros(3), np.zeros(3), np.ones(2, bool))]
        )
    with pytest.raises(InputError, match=r"found shape \(4,\) with n = 3"):
        experiments.force_over_time(np.arange(3.0), np.arange(4.0), np.arange(3.0))


def test_the_profile_is_in_millimetres_and_kilopascals(profile):
    upper, lower = experiments.pressure_profile(profile).axes
    assert np.nanmax(upper.lines[0].get_ydata()) == pytest.approx(5.0)
    assert np.nanmax(lower.lines[0].get_ydata()) == pytest.approx(2.0)
    assert texts(upper.figure) == [f"2.50 ± {profile.contacts[0].force_sigma_N:.2f} N"]


def test_the_budget_ends_with_its_total():
    budget = ErrorBudget(0.003, 0.02, 0.03, 0.004)
    assert texts(experiments.error_budget({"box": budget})) == [f"{1e3 * budget.total_N:.3g}"]


def test_the_map_names_every_object():
    tag = HapticTag(dynamic_friction_N=Estimate(3.2, 0.04, spread=0.6), fixed=False)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    figure = experiments.floor_map(
        np.zeros((40, 60), np.int8),
        0.05,
        (-1.0, 0.0),
        path_world_m=np.array([[0, 0], [1, 1.0]]),
        objects=[experiments.MapObject("box", square, tag), experiments.MapObject("unknown", square)],
    )
    assert texts(figure) == ["box\nfriction 3.20 ± 0.04 N", "unknown"]
    assert figure.axes[0].get_xlim() == (-1.0, 2.0)


def test_the_style_of_others_is_left_alone(profile):
    before = dict(mpl.rcParams)
    experiments.pressure_profile(profile)
    assert dict(mpl.rcParams) == before


def test_labels_of_a_map_cover_neither_each_other_nor_what_stands_there():
    """Three objects side by side in a door, as in the demo: their names stand apart, the objects stay to be seen."""
    tag = HapticTag(dynamic_friction_N=Estimate(3.2, 0.04), fixed=False)
    square = 0.1 * np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    objects = [
        experiments.MapObject(name, square + np.array([4.0, 2.0 + 0.25 * k]), tag)
        for k, name in enumerate(["light bin", "fixed leg", "heavy box"])
    ]
    figure = experiments.floor_map(np.zeros((120, 160), np.int8), 0.05, (0.0, 0.0), objects=objects)
    figure.draw_without_rendering()
    axes = figure.axes[0]
    boxes = [mpl.text.Text.get_window_extent(text) for text in axes.texts]
    boxes += [
        axes.transData.transform_bbox(mpl.transforms.Bbox([o.outline_world_m[0], o.outline_world_m[2]]))
        for o in objects
    ]
    assert not any(first.overlaps(second) for k, first in enumerate(boxes) for second in boxes[k + 1 :])
