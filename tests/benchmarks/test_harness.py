"""The harness evaluates, tabulates and saves; a failing benchmark does not stop the others."""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
import types

import pytest

from benchmarks import harness


@pytest.fixture
def report(monkeypatch):
    """Rows of two made-up benchmarks, one of which fails."""
    good = types.ModuleType("benchmarks.made_up")
    good.run = lambda: [
        {
            "name": "speed",
            "ours": 1500.0,
            "peer": 16.0,
            "peer_name": "snake",
            "unit": "1/s",
            "floor": 650,
            "aim": 2000,
        },
        {"name": "noise", "ours": 1.02, "unit": "x bound", "floor": 1.15, "aim": 1.05},
        {"name": "delay", "ours": 12.0, "peer": 6.0, "unit": "ms", "floor": 10, "aim": 6},
        {"name": "plain", "ours": 3.0, "unit": "ms"},
        {"name": "range", "ours": 0.85, "unit": "ratio", "floor": "0.8-1.25", "aim": (0.9, 1.1)},
    ]
    bad = types.ModuleType("benchmarks.broken")
    bad.run = lambda: 1 / 0
    monkeypatch.setitem(sys.modules, "benchmarks.made_up", good)
    monkeypatch.setitem(sys.modules, "benchmarks.broken", bad)
    return harness.run(["made_up", "broken"], "benchmarks")


def test_verdicts_follow_the_direction_of_floor_and_aim(report):
    assert [row.verdict for row in report.rows] == ["floor", "aim", "missed", "", "floor", "failed"]


def test_the_ratio_is_above_one_when_we_are_better(report):
    assert report.rows[0].ratio == pytest.approx(1500 / 16)
    assert report.rows[2].ratio == pytest.approx(0.5)


def test_the_table_names_machine_versions_commit_and_command(report):
    text = harness.table(report)
    for part in (
        "machine ",
        "versions ",
        "commit ",
        "command ",
        "numpy ",
        "made_up: speed",
        "ZeroDivisionError",
    ):
        assert part in text


def test_the_file_holds_the_same_rows(report, tmp_path):
    harness.save(tmp_path / "bench.json", report)
    saved = json.loads((tmp_path / "bench.json").read_text())
    assert [row["name"] for row in saved["rows"]] == ["speed", "noise", "delay", "plain", "range", "broken"]
    assert saved["rows"][5]["ours"] is None
    assert [path.name for path in tmp_path.iterdir()] == ["bench.json"]


def test_cpu_seconds_is_the_cpu_time_of_one_undisturbed_call(monkeypatch):
    """A clock of CPU time that only our calls move: 3 ms each, and 1 s more when something disturbs."""
    spent_s, calls = 0.0, 0

    def work() -> None:
        nonlocal spent_s, calls
        calls += 1
        spent_s += 1.003 if calls == 12 else 0.003

    monkeypatch.setattr(harness.time, "process_time", lambda: spent_s)
    # A batch of 20 ms takes 8 calls of 3 ms (7 would do, batches double); the disturbed batch is not the best.
    assert harness.cpu_seconds(work, repeats=5) == pytest.approx(0.003, rel=1e-9)
    assert calls == 1 + (1 + 2 + 4 + 8) + 4 * 8


def test_the_cold_start_is_among_the_benchmarks():
    assert "cold_start" in harness.benchmark_names()
    assert "harness" not in harness.benchmark_names()
    assert set(harness.CAMPAIGNS) <= set(harness.benchmark_names())


def test_reports_of_two_commits_are_compared_pair_by_pair(tmp_path, report):
    rows = []
    for number, (commit, factor) in enumerate([("a", 1.0), ("b", 0.5), ("a", 2.0), ("b", 1.8)]):
        changed = [harness.replace(row, ours=factor * row.ours) for row in report.rows]
        path = tmp_path / f"{number}.json"
        harness.save(path, harness.replace(report, commit=commit, rows=changed))
        rows.append(harness.read_rows(path))
    lines = harness.comparison(rows).splitlines()
    assert lines[0] == "before a, after b, 2 pairs"
    assert len(lines) == 6  # the one that failed has no figure
    assert " ".join(lines[4].split()) == "0.700 (0.500 - 0.900) 4.5 -> 3.45 ms made_up: plain"
    with pytest.raises(SystemExit, match="expected a and b"):
        harness.comparison([rows[0], rows[1], rows[3], rows[2]])


def test_one_thread_holds_for_numba_that_was_imported_before():
    # Numba looks at its variable when it compiles next, and refuses once its threads run: a kernel from the cache, then one
    # that is not in it.
    code = (
        "import numba, sys; from benchmarks.harness import use_one_thread; use_one_thread(); "
        "numba.set_num_threads(1); f = numba.njit(lambda x: x + 1); sys.exit(f(1) - 2)"
    )
    environment = {**os.environ, "NUMBA_NUM_THREADS": "2", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["completion", "shell_evidence", "templates_evidence", "transparency"])
def test_campaigns_that_share_arguments_with_verbs_say_their_help(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module(f"benchmarks.{name}", run_name="__main__", alter_sys=False)
    assert ended.value.code == 0
    assert "--workers" in capsys.readouterr().out
