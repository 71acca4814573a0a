"""Addresses of databases: folders with any name, and passwords that are not repeated in messages."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("sqlalchemy")
pytest.importorskip("pyarrow")

from visuohaptic.cli.main import main
from visuohaptic.core import InputError, VisuohapticError, VisuoHapticObject, decode
from visuohaptic.database import connect_server, open_database, shown_url

NAMES = ("run?1", "run?2", "per%20cent", "two words", "K\u00fcche \u6771", "a#b", "file:x", "q?mode=memory")


def test_folders_with_any_name_do_not_mix(tmp_path: Path) -> None:
    for name in NAMES:
        with open_database(tmp_path / name) as database:
            database.add(VisuoHapticObject("a", name=name))
    assert sorted(one.name for one in tmp_path.iterdir()) == sorted(NAMES)
    for name in NAMES:
        assert (tmp_path / name / "objects.sqlite").is_file()
        with open_database(tmp_path / name, create=False) as database:
            assert database.get("a").name == name


@pytest.mark.parametrize(
    "address",
    [
        "mysql://bob:s3cret@host/db",
        "postgresql+pg8000://bob:s3cret@host/db",
        "postgres+x://bob:s3cret@host/db",
        "postgresql://bob:s3cret@host:port/db",
        "postgresql://bob:s3/cr@et?s3cret@host:port/db",
        "postgresql://host:99999999999999999999/db?user=bob&password=s3cret",
        "mysql://host/db?user=bob&password=s3cret",
        "mysql://host/db?p%61ssword=s3cret",
    ],
)
def test_no_message_has_the_password(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], address: str
) -> None:
    for words in (
        ["objects", "list", "--db", address],
        ["objects", "sync", address, "--db", str(tmp_path / "db")],
    ):
        assert main(words) == 2
        said = capsys.readouterr()
        assert said.err.count("\n") == 1
        assert "s3" not in said.err + said.out
        assert "host" in said.err, "which address?"


def test_what_an_address_shows() -> None:
    assert shown_url("some/folder?password=x") == "some/folder?password=x"
    assert shown_url("postgresql://bob@host/db") == "postgresql://bob@host/db"
    assert shown_url("postgresql://bob:pw@host:5/db?sslmode=require&password=x") == (
        "postgresql://bob:***@host:5/db?sslmode=require&password=***"
    )


def test_a_port_that_is_none_is_one_line() -> None:
    with pytest.raises(InputError, match=r"h:abc/db: is not the address of a database, expected"):
        connect_server("postgresql://h:abc/db")


@pytest.mark.parametrize(
    ("card", "said"),
    [
        ({"seen": {"position_m": [0, 0, 0], "sigma_m": 0.1, "t_s": float("nan")}}, "seen.t_s"),
        ({"seen": {"position_m": [0, 0, 0], "sigma_m": 0.1, "t_s": "nan"}}, "seen"),
        ({"seen": {"position_m": [0, "inf", 0], "sigma_m": 0.1, "t_s": 1.0}}, "seen"),
        ({"seen": {"position_m": [0, 0, 0], "sigma_m": -0.1, "t_s": 1.0}}, "seen"),
        ({"provenance": {"name": {"t_s": float("nan")}}}, "provenance.name.t_s"),
        ({"provenance": {"name": {"t_s": "inf"}}}, "provenance.name.t_s"),
        ({"tag": {"deformability": {"value": -1e30, "sigma": 0.1}}}, "tag.deformability"),
        ({"tag": {"static_friction_N": {"value": -1.0, "sigma": 0.1}}}, "tag.static_friction_N"),
    ],
)
def test_cards_with_impossible_numbers_are_refused(card: dict, said: str) -> None:
    with pytest.raises(VisuohapticError, match=f"^card.yaml: {said}"):
        decode({"id": "a", **card}, {}, "card.yaml")


def test_cards_with_noise_and_unknown_times_are_read() -> None:
    card = {
        "id": "a",
        "tag": {"deformability": {"value": -0.01, "sigma": 0.02}},
        "provenance": {"name": {"t_s": "nan"}},
    }
    assert decode(card, {}, "card.yaml").id == "a"


def test_a_refused_import_leaves_no_database(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        (tmp_path / "cards" / name).mkdir(parents=True)
    head = "format: visuohaptic object\nversion: 1\nlicence: CC0-1.0\nobject: "
    (tmp_path / "cards" / "a" / "card.yaml").write_text(head + "{id: a}\n")
    (tmp_path / "cards" / "b" / "card.yaml").write_text(head + "{id: 1}\n")
    assert main(["objects", "import", str(tmp_path / "cards"), "--db", str(tmp_path / "db")]) == 2
    assert "card.yaml: id" in capsys.readouterr().err
    assert not (tmp_path / "db").exists()
