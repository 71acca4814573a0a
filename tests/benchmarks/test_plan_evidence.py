"""A slice of the planner's campaigns: a call that hangs is killed, the others continue, and rows become a table."""

import math

import pytest
from benchmarks._plan_campaigns import CAMPAIGNS
from benchmarks._plan_child import Planner, described
from benchmarks._plan_judge import FAULT_M, bounds_row, faults_row
from benchmarks._seeds import seeds_of
from benchmarks.doors_evidence import table
from tests.worlds.floor_scenes import doors_in_series


def test_even_seeds_are_open_and_odd_ones_closed():
    assert seeds_of("open", 3) == [0, 2, 4]
    assert seeds_of("closed", 3) == [1, 3, 5]
    assert seeds_of("closed", 2, first=3) == [7, 9]


def test_a_call_over_its_time_is_ended_and_the_next_one_answered():
    planner = Planner(budget_s=60.0)
    try:
        request = {"do": "plan", "problem": described(doors_in_series(0, 2), 0.05)}
        assert planner.ask(request, budget_s=1e-3)["status"] == "time"
        rows = {key: CAMPAIGNS["oracle"].play(planner, key) for key in ("2", "20")}
        for row in rows.values():
            assert row["finished"]
            if row["oracle_s"]:
                assert row["answer"] == "plan"
                assert row["fault_m"] <= FAULT_M
                # The optimum's own grid is 2.7 % too long at most; a tenth is what a plan may cost more at worst.
                assert 0.97 < row["true_cost_s"] / row["oracle_s"] < 1.1
        table = CAMPAIGNS["oracle"].table(rows)
        assert all(line["ours"] is None or math.isfinite(line["ours"]) for line in table)
        row = CAMPAIGNS["no_plan"].play(planner, "6")
        assert row["truth"] is True
        assert row["answer"] in {"proved", "not proved"}
        row = CAMPAIGNS["push_ends"].play(planner, "2")
        assert row["off_m"] < 0.1
        row = CAMPAIGNS["drives"].play(planner, "0")
        # Blocks of half a radius are as clear as their clearest cell: along walls a drive seems faster than it is.
        assert all(0.95 < cost / best < 1.02 for cost, best in zip(row["lattice"], row["exact"], strict=True))
    finally:
        planner.close()


def test_a_bound_is_refuted_by_a_cheaper_plan_and_none_is_no_zero():
    """Plans of 10.5 s: within 5 %, an optimum of 10 s is possible; an optimal one is refuted by it."""
    plans = [({"gap": gap, "true_cost_s": 10.5}, 10.0) for gap in (0.05, 0.0, None)]
    assert [bounds_row("x", plans[:count])["ours"] for count in (0, 1, 2, 3)] == [None, 0, 1, 1]
    assert bounds_row("x", plans[2:])["ours"] is None


def test_a_table_without_cases_is_not_a_pass():
    assert [faults_row("x", rows)["ours"] for rows in ([], [{}], [{"fault_m": 2e-3, "fault": "x"}, {}])] == [
        None,
        None,
        2.0,
    ]
    for name in ("push_ends", "route_edges", "no_plan"):
        lowest = [row for row in CAMPAIGNS[name].table({}) if row.get("floor") == 0]
        assert lowest
        assert all(row["ours"] is None for row in lowest)


def test_the_table_of_doors_counts_what_was_found_and_how_sure_it_was():
    rows = [
        {"confidence": [0.95, 0.95, 0.6, 0.6], "true": [True, True, True, False], "drawn": 4, "cpu_s": 1.0,
         "curve": [[0.5, 3, 4], [0.7, 2, 2], [0.9, 2, 2]]},
        {"confidence": [], "true": [], "drawn": 0, "cpu_s": 3.0, "curve": [[0.5, 0, 0], [0.7, 0, 0], [0.9, 0, 0]]},
    ]  # fmt: skip
    found = {line["name"]: line["ours"] for line in table("x", rows)}
    assert found["x: recall"] == pytest.approx(0.75)
    assert found["x: precision"] == pytest.approx(0.75)
    assert found["x: precision from confidence 0.7"] == 1.0
    assert found["x: true of those told 0.5 to 0.7"] == pytest.approx(0.5)
    # Half of the doors are told 0.95 and true, half 0.6 and true by half: (0.05 + 0.1) / 2.
    assert math.isclose(found["x: calibration error"], 0.075)
    assert found["x: CPU time of a floor, median"] == 2.0
