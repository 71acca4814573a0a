"""The table of the robustness tests of this library and their results.

    python -m benchmarks.reliability                            a slice of every row, in minutes
    python -m benchmarks.reliability --items 1 5 --scale 10 --report rows.jsonl    ten times as many cases of two rows
    python -m benchmarks.reliability --report rows.jsonl --also fuzz.jsonl bare.jsonl --page docs/reliability.md

Campaigns with their own report (:data:`TAKEN`, ``mutants``, ``branch_coverage``) are included by ``--also``.

Each case is saved in the report as it is completed, and an interrupted run is continued. A row that was not run is marked.
"""

from __future__ import annotations

import argparse
import http.client
import json
import re
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from . import (
    determinism,
    foam_faults,
    golden,
    hostile_arrays,
    hostile_files,
    kill_faults,
    mission_faults,
    mutants,
    soak,
)
from ._journal import Journal

Rng = np.random.Generator
ROOT = Path(__file__).resolve().parents[1]
#: Files that caused faults; they are moved to ``tests/corpus`` when the fault is fixed.
KEPT = ROOT / "results" / "hostile"
#: Figures of a case; a case of a row has those that apply.
FIGURES = ("tried", "crashed", "hung", "wrong", "lost")
Case = tuple[str, Callable[[], dict[str, int]]]


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the table."""

    number: int
    title: str
    target: str  #: how many are owed, and what may come of them
    cases: Callable[[int], Iterator[Case]] | None = None  #: by scale; None: run elsewhere
    elsewhere: str = ""  #: the command, or why it is not run


def _files(scale: int) -> Iterator[Case]:
    # The first case is a slice of seconds; the others keep one process busy for many files.
    for number in range(scale):
        per_case = (20 if number else 4) * len(hostile_files.READERS)

        def run(number: int = number, per_case: int = per_case) -> dict[str, int]:
            journal = Journal(None, {})
            hostile_files.campaign(per_case, 2 * number, journal, KEPT, batch=per_case)
            found = hostile_files.summary(journal)
            wrong = found.get("unclear", 0)
            return {
                "tried": found["tried"],
                "crashed": found.get("crashed", 0),
                "hung": found.get("hung", 0),
            } | {"wrong": wrong}

        yield f"mutations, seed {2 * number}", run


def _arrays(scale: int) -> Iterator[Case]:
    names = list(hostile_arrays.public_functions())
    for start in range(0, min(len(names), 40 * scale), 20):

        def run(part: list[str] = names[start : start + 20]) -> dict[str, int]:
            journal = Journal(None, {})
            hostile_arrays.campaign(part, 0, journal)
            found = hostile_arrays.summary(journal)
            return {name: found[name] for name in ("tried", "crashed", "wrong")}

        yield f"functions from {names[start]}", run


def _kills(scale: int) -> Iterator[Case]:
    for number in range(4 * scale):
        for row in (kill_faults.killed_row, kill_faults.full_disk_row):

            def run(number: int = number, row: Any = row) -> dict[str, int]:
                with tempfile.TemporaryDirectory() as root:
                    found = row(number, Path(root))
                return {"tried": 1, "wrong": found.get("wrong", 0), "lost": found["lost"]}

            yield f"{row.__name__} {number}", run


def _cuts(scale: int) -> Iterator[Case]:
    def run() -> dict[str, int]:
        rows = kill_faults.cut_rows(30 * scale)
        return {"tried": len(rows), "lost": sum(row["lost"] for row in rows)}

    yield f"cut at {30 * scale} places", run


def _tested(*files: str) -> subprocess.CompletedProcess[str]:
    """Results of test files, run in a separate process."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)


def _golden(_scale: int) -> Iterator[Case]:
    def run() -> dict[str, int]:
        done = _tested("tests/test_golden.py")
        versions = len(list((ROOT / "tests/golden").iterdir()))
        return {"tried": versions * (len(golden.NAMES) + 4), "wrong": int(done.returncode != 0)}

    yield "files of every format", run


def _passing(*files: str) -> Callable[[int], Iterator[Case]]:
    """Cases of files of tests: each one that passes was tried."""

    def run() -> dict[str, int]:
        done = _tested(*files)
        passed = re.search(r"(\d+) passed", done.stdout)
        return {"tried": int(passed[1]) if passed else 0, "wrong": int(done.returncode != 0)}

    return lambda _scale: iter([(" ".join(files), run)])


def _server(scale: int) -> Iterator[Case]:
    for number in range(scale):

        def run(number: int = number) -> dict[str, int]:
            return serve_and_attack(1000, np.random.default_rng([16, 2 * number]))

        yield f"requests, seed {2 * number}", run


def serve_and_attack(count: int, rng: Rng) -> dict[str, int]:
    """Malformed and foreign requests to a live page: which were answered, and whether it still serves afterwards."""
    from visuohaptic.viewer import LivePage

    answered = 0
    with LivePage(port=0) as page:
        address = urlsplit(page.url)
        for number in range(count):
            host = f"127.0.0.1:{address.port}"
            with socket.create_connection(("127.0.0.1", address.port or 0), timeout=20) as client:
                client.sendall(_request(number, host, address.path.strip("/"), rng))
                if number % 4 == 3:  # noise: more may be awaited
                    client.shutdown(socket.SHUT_WR)
                try:
                    status = client.recv(1000)[:20]
                except ConnectionResetError:
                    status = b""
            answered += b" 200 OK" in status or b" 101 " in status
        connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=20)
        connection.request("GET", f"{address.path}", headers={"Host": host})
        served = connection.getresponse().status == 200
    return {"tried": count, "crashed": int(not served), "wrong": answered}


def _request(number: int, host: str, secret: str, rng: Rng) -> bytes:
    """A request that must not be answered: without the secret, for or from a foreign place, malformed, or noise."""
    names = [
        f"evil.example:{host[10:]}",
        "10.0.0.1",
        f"{host}.evil.example",
        f"x@{host}",
        "",
        f"{host}/",
        "[::1",
    ]
    names += [f"{host}, evil.example", "0", "127.1", "2130706433", "0x7f.1", f"{host}\r\nHost: evil.example"]
    origins = ["http://evil.example", "null", f"https://{host}", f"http://{host}.evil.example", "file://", ""]
    if number % 4 == 3:
        return rng.bytes(int(rng.integers(1, 3000)))
    path, upgrade = f"/{secret}/", ["Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13"]
    key = ["Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="]
    lines = [f"Host: {host}", *(upgrade + key if rng.random() < 0.5 else [])]
    if number % 4 == 0:
        place = int(rng.integers(len(secret)))
        wrong = secret[:place] + chr(ord("a") + (ord(secret[place]) + 1) % 26) + secret[place + 1 :]
        path = (
            f"/{rng.choice([wrong, secret[:place], secret.swapcase(), '', '//' + secret, '%2f' + secret])}/"
        )
    elif number % 4 == 1:
        lines[0] = f"Host: {rng.choice(names)}"
    else:
        lines.append(f"Origin: {rng.choice(origins)}")
    return "\r\n".join([f"GET {path} HTTP/1.1", *lines, "", ""]).encode()


def _messages(scale: int) -> Iterator[Case]:
    """Addresses with a password in every place that a driver reads it from: none comes back."""
    from visuohaptic.core import VisuohapticError
    from visuohaptic.database import ObjectDatabase

    def run() -> dict[str, int]:
        shown = 0
        schemes = ("postgresql", "postgres", "mysql", "postgresql+pg8000", "postgres+x", "http")
        texts = (
            "://bob:{}@h/n",
            "://h/n?user=bob&password={}",
            "://bob:{}@h:port/n",
            "://b:{}@[::1/n",
            "://:{}@/",
        )
        words = [f"s3cr3t{n}{end}" for n in range(scale) for end in ("", "@x", "/y", "?z", ":q")]
        cases = [scheme + text.format(word) for scheme in schemes for text in texts for word in words]
        for address in cases:
            try:
                ObjectDatabase(address)
            except VisuohapticError as error:
                shown += "s3cr3t" in str(error)
        return {"tried": len(cases), "wrong": shown}

    yield "passwords in addresses", run


ROWS = (
    Row(1, "damaged and hostile files, all readers, 2 GB and 20 s each", "10,100: 0 / 0 / 0", _files),
    Row(
        2,
        "coverage-guided fuzzing of own parsers (inputs of 12 s for each)",
        "1 h each: 0",
        elsewhere="`python -m benchmarks.parser_fuzz` (needs atheris)",
    ),
    Row(
        3,
        "stream faults, 20 kinds, two renderers",
        "6,000: 0 wrong",
        elsewhere="`python -m benchmarks.foam_faults 6000 70000 --report foam.jsonl`",
    ),
    Row(
        4,
        "stale and frozen sources, clocks that stop or jump",
        "500: stop in 200 ms",
        elsewhere="`python -m benchmarks.mission_faults`",
    ),
    Row(5, "public functions, hostile arrays", "2,000: 0 foreign exceptions", _arrays),
    Row(6, "kill -9 and full disk, recordings and databases", "500: 0 lost, 0 half-written", _kills),
    Row(
        7,
        "builds and cluster workers killed",
        "50: same hash",
        elsewhere="`python -m benchmarks.build_faults --report builds.jsonl`",
    ),
    Row(8, "cut recordings", "300: all whole messages", _cuts),
    Row(9, "laws (property tests)", "10^4 examples each", elsewhere="`python -m benchmarks.laws`"),
    Row(10, "golden files of every format", "all read", _golden),
    Row(11, "determinism of 11 verbs: hash seeds, threads, cores", "50: same bytes", determinism.cases),
    Row(
        12,
        "soak: the sensing chain (tried: frames)",
        "4 h: flat",
        elsewhere="`python -m benchmarks.soak --hours 4 --report soak.jsonl`",
    ),
    Row(
        13,
        "bare installations, `demo --quick`: read-only, no home, C locale",
        "12: both commands of the README",
        elsewhere="`python -m benchmarks.bare`",
    ),
    Row(14, "docs, examples, help", "all run", _passing("tests/docs", "tests/cli/test_help_examples.py")),
    # Archives that unpack to more than they should, links and names that lead out of their folder, devices.
    Row(15, "archives, links, traversal, devices", "100: refused", _passing("tests/test_security.py")),
    Row(16, "servers: hosts, origins, malformed requests", "10,000: 0", _server),
    Row(17, "messages without secrets", "all", _messages),
)


def _read_other(path: Path) -> tuple[str, dict[str, Any]]:
    """Campaign and rows of another report."""
    about, *lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return about["campaign"], {line["key"]: line["row"] for line in lines}


def _of_foam(row: dict[str, Any]) -> dict[str, int]:
    frames = zip(row["valid"], row["error_N"], row["sigma_N"], strict=True)
    wrong = sum(valid and abs(error) > 5.0 * sigma + foam_faults.ALLOWED_N for valid, error, sigma in frames)
    return {"tried": 1, "wrong": wrong}


def _of_mission(row: dict[str, Any]) -> dict[str, int]:
    late = (row.get("motion_s") or 0.0) > mission_faults.STOPPED_S + 1e-9
    return {"tried": 1, "crashed": int("crash" in row), "wrong": int(late)}


#: Rows of the table that have a campaign and a report of their own, and what a case of it is in the table.
TAKEN: dict[str, tuple[int, Callable[[dict[str, Any]], dict[str, int]]]] = {
    "parser fuzz": (2, lambda row: {"tried": row["tried"], "crashed": int(bool(row["trouble"])), "wrong": 0}),
    "foam_faults": (3, _of_foam),
    "mission_faults": (4, _of_mission),
    "objects faults": (
        6,
        lambda row: {
            "tried": row["tried"], "wrong": row["problems"] + row.get("half-written", 0), "lost": row["lost"],
        },
    ),
    "build_faults": (7, lambda row: {"tried": row.get("kills", 0), "lost": row.get("lost", 0)}),
    "laws": (9, lambda row: {"tried": row["tried"], "wrong": row["wrong"]}),
    "soak": (
        12,
        lambda row: {
            "tried": row["frames"],
            "wrong": int(row["growth_MB"] > soak.FLAT_MB) + int(row["handles"] > 0),
        },
    ),
    "bare": (13, lambda row: {name: row.get(name, 0) for name in ("tried", "hung", "wrong")}),
}  # fmt: skip


def take_in(paths: list[Path], journal: Journal) -> dict[str, dict[str, Any]]:
    """Add the cases of other reports to their rows; returns those that have their own table."""
    apart: dict[str, dict[str, Any]] = {}
    for path in paths:
        campaign, rows = _read_other(path)
        if campaign not in TAKEN:
            apart.setdefault(campaign, {}).update(rows)
            continue
        number, case = TAKEN[campaign]
        journal.rows |= {f"{number}: {key}": case(row) for key, row in rows.items() if row is not None}
    return apart


def _of_tests(apart: dict[str, dict[str, Any]]) -> list[str]:
    """Tables about the tests: mutants that they kill, and branches that they cover."""
    lines = []
    if mistakes := apart.get("mutants"):
        lines += [
            "",
            "## Whether the tests notice mistakes",
            "",
            "Small mistakes drawn at random and put into the code one at a time (`python -m benchmarks.mutants`); the score",
            "is killed of all, by the tests of the package alone, so a lower bound. Owed: 0.75.",
            "",
            "| package | mistakes | killed | survived | not executed | score |",
            "|---|---|---|---|---|---|",
        ]
        for package, count in mutants.counts(mistakes).items():
            cells = [count[name] for name in ("killed", "survived", "uncovered")]
            lines.append(
                f"| {package} | {sum(cells)} | {' | '.join(map(str, cells))} | {cells[0] / max(sum(cells), 1):.2f} |"
            )
    if covered := apart.get("coverage"):
        lines += [
            "",
            "Branches that the tests of a package take (`python -m benchmarks.branch_coverage`), kernels left out. Owed: 90 %.",
            "",
            "| package | branches | taken | lines | executed |",
            "|---|---|---|---|---|",
        ]
        lines += [
            f"| {package} | {row['branches']:,} | {row['taken'] / row['branches']:.1%} | {row['lines']:,} "
            f"| {row['executed'] / row['lines']:.1%} |"
            for package, row in covered.items()
        ]
    return lines


def table(journal: Journal) -> list[dict[str, Any]]:
    """Figures of all rows from the cases in a journal."""
    found = []
    for row in ROWS:
        cases = [case for key, case in journal.rows.items() if key.startswith(f"{row.number}: ")]
        figures = (
            {name: sum(case[name] for case in cases if name in case) for name in FIGURES} if cases else {}
        )
        given = {name for case in cases for name in case}
        found.append(
            {"row": row, **{name: figures[name] if name in given else None for name in FIGURES}}
            if cases
            else {"row": row}
        )
    return found


def markdown(journal: Journal, apart: dict[str, dict[str, Any]] | None = None, before: str = "") -> str:
    """The page of the table; rows and tables that are not in the reports stay as they are in the page ``before``."""
    kept = {found[1]: line for line in before.splitlines() if (found := re.match(r"\| (\d+) ", line))}
    tests = before.partition("\n## ")[2]
    lines = [
        "# Reliability",
        "",
        "What was tried against the library from outside, and what came of it. Made by",
        "`python -m benchmarks.reliability --report rows.jsonl --also OTHER.jsonl ... --page docs/reliability.md`, with the",
        "reports of the commands in the last column; a dash stands for a figure that a row does not have. *Wrong* are wrong",
        "results, refusals that are not one clear line, and attacks that were not refused. Rows without figures were not run",
        "for this page; the last column says how, or why not.",
        "",
        "| item | owed | tried | crashed | hung | wrong | lost | not run here |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for figures in table(journal):
        row = figures["row"]
        if "tried" not in figures and str(row.number) in kept:
            lines.append(kept[str(row.number)])
            continue
        if "tried" in figures:
            cells = ["-" if figures[name] is None else f"{figures[name]:,}" for name in FIGURES]
            note = ""
        else:
            cells, note = [""] * len(FIGURES), row.elsewhere or "not run"
        lines.append(f"| {row.number} {row.title} | {row.target} | {' | '.join(cells)} | {note} |")
    if not apart and tests:
        return "\n".join(lines) + f"\n\n## {tests}"
    return "\n".join([*lines, *_of_tests(apart or {})]) + "\n"


def main() -> None:
    """Run, or continue, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--items", type=int, nargs="*", default=[row.number for row in ROWS])
    parser.add_argument("--scale", type=int, default=1, help="how many times the slice")
    parser.add_argument("--report", type=Path)
    parser.add_argument("--page", type=Path, help="update the table in a page")
    parser.add_argument("--also", type=Path, nargs="*", default=[], help="reports of other campaigns")
    args = parser.parse_args()
    journal = Journal(args.report, {"campaign": "reliability"})
    for row in ROWS:
        if row.number not in args.items or row.cases is None:
            continue
        for name, run in row.cases(args.scale):
            if (key := f"{row.number}: {name}") not in journal:
                journal.put(key, run())
                print(key, journal.rows[key], flush=True)
    before = args.page.read_text(encoding="utf-8") if args.page is not None and args.page.exists() else ""
    text = markdown(journal, take_in(args.also, journal), before)
    if args.page is not None:
        args.page.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
