"""The page of reliability: figures of reports, rows that other campaigns wrote, branches by file of tests."""

from __future__ import annotations

import ast
import builtins
from importlib import import_module
from pathlib import Path

import pytest
from benchmarks._journal import Journal
from benchmarks.branch_coverage import measure

ROOT = Path(__file__).resolve().parents[2]


def test_rows_and_packages_without_report_are_marked_as_earlier(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    from benchmarks import reliability

    journal = Journal(None, {})
    journal.rows["8: cut"] = {"tried": 3, "lost": 0}
    assert "## " not in reliability.markdown(journal)  # no campaign of mutants, no table of it
    covered = {"branches": 10, "taken": 9, "lines": 20, "executed": 20, "files": 1, "of files": 2}
    killed = {str(n): {"package": "database", "result": "killed" if n else "survived"} for n in range(4)}
    first = reliability.markdown(journal, {"coverage": {"core": covered}, "mutants": killed})
    assert "| 3 | - | - | - | 0 |" in first
    assert "| core | 10 | 90.0% | 20 | 100.0% | 1 of 2 |" in first
    # Another campaign, later: the page has the rows of both, and the sum of all mistakes.
    other = {str(n): {"package": "grasping", "result": "survived"} for n in range(4)}
    parser = Journal(tmp_path / "parser.jsonl", {"campaign": "parser fuzz"})
    parser.put("ply, slice 0", {"tried": 5, "seconds": 60, "trouble": ""})
    parser.put("ply, slice 1", {"tried": 5, "seconds": 30, "trouble": "MemoryError"})
    later = Journal(None, {})
    apart = reliability.take_in([tmp_path / "parser.jsonl"], later)
    second = reliability.markdown(later, apart | {"mutants": other}, first)
    kept = [line for line in first.splitlines() if line.startswith(("| 8 ", "| core ", "| database "))]
    assert len(kept) == 3
    for line in kept:
        marked = line.replace("|  |", "| (earlier code) |") if line[2] == "8" else line
        for name in ("core", "database"):
            marked = marked.replace(f"| {name} |", f"| {name} (earlier code) |")
        assert marked in second.splitlines()
    third = reliability.markdown(
        later, {"mutants": killed}, second
    )  # marked once; measured again, not any more
    assert [third.count(part) for part in ("code) (earlier", "| database (", "| database |")] == [0, 0, 1]
    journal.rows["8: cut"] = {"tried": 1, "lost": 0}
    assert "commit" not in third
    fourth = reliability.markdown(journal, {}, third, "1a2b3c4")
    assert "for this page. The others were measured up to commit 1a2b3c4.\n" in fourth
    assert "| 1 | - | - | - | 0 | with earlier code 3 tried, 0 failed |" in fourth
    # The largest sample stays told, also when the last one is not larger than that before.
    assert "| 1 | - | - | - | 0 | with earlier code 3 tried, 0 failed |" in reliability.markdown(
        journal, {}, fourth
    )
    assert "| all | 8 | 3 | 5 | 0 | 0.38 |" in second
    assert "| 10 | 1 | - | 0 | - | 1 parsers, 1.5 to 1.5 min each |" in second


def test_a_node_that_grows_or_ends_is_counted() -> None:
    pytest.importorskip("mujoco")
    from benchmarks import reliability

    def minute(process: int, memory_MB: float, alive: bool = True) -> dict[str, object]:
        return {"process": process, "sent": 10, "memory_MB": memory_MB, "handles": 5, "alive": alive}

    flat = [minute(1, one) for one in (100.0, 300.0, 310.0, 320.0)]  # the first two minutes do not count
    rows = [*flat, *(minute(2, one) for one in (1.0, 1.0, 1.0, 30.0)), minute(3, 1.0, alive=False)]
    cases = reliability.TAKEN["ros soak"][1]({str(number): row for number, row in enumerate(rows)})
    assert [(case["tried"], case["crashed"], case["wrong"]) for case in cases.values()] == [
        (40, 0, 0),
        (40, 0, 1),
        (10, 1, 0),
    ]


def test_branches_are_kept_by_file_of_tests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("coverage")
    source, tests = tmp_path / "src/visuohaptic/toy", tmp_path / "tests/toy"
    source.mkdir(parents=True)
    tests.mkdir(parents=True)
    (source.parent / "__init__.py").touch()
    (source / "one.py").write_text("def sign(x):\n    if x > 0:\n        return 1\n    return -1\n")
    for name, value in (("a", 1), ("b", -1)):
        (tests / f"test_{name}.py").write_text(
            f"from visuohaptic.toy.one import sign\n\ndef test_it():\n    assert sign({value}) == {value}\n"
        )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path / 'src'}:{ROOT}")
    slices = [measure("toy", tmp_path / "data", seconds, tmp_path) for seconds in (0.0, 60.0, 60.0)]
    assert [(one["branches"], one["taken"], one["files"]) for one in slices] == [
        (2, 1, 1),
        (2, 2, 2),
        (2, 2, 2),
    ]
    assert slices[-1]["tests"] == "no tests"  # nothing was run again


def test_every_target_of_the_fuzzer_is_a_parser_of_today() -> None:
    from benchmarks import hostile_files, parser_fuzz

    calls = {name: call for name, _, _, call in hostile_files.READERS}
    calls |= {name: call for name, (_, call) in parser_fuzz._bytes_targets().items()}
    for name in parser_fuzz.targets():
        module, _, expression = calls[name].partition(":")
        names = [one for one in ast.walk(ast.parse(expression)) if isinstance(one, ast.Name)]
        known = {*dir(builtins), *dir(import_module(f"visuohaptic.{module}")), "path", "data", "KINDS"}
        known |= {one.id for one in names if isinstance(one.ctx, ast.Store)}
        assert known.issuperset(one.id for one in names), name
