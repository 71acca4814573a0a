"""A PostgreSQL server for the tests, on a private socket, if the Debian packages are installed."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ports import free_port


def certificate(path: Path, key: Path) -> bool:
    """A certificate of localhost, signed by itself; false without ``openssl``."""
    tool = shutil.which("openssl")
    if tool is None:
        return False
    subprocess.run(
        [tool, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
         "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost",
         "-out", str(path), "-keyout", str(key)],
        check=True, capture_output=True,
    )  # fmt: skip
    key.chmod(0o600)
    return True


def postgres_url(factory: pytest.TempPathFactory) -> Iterator[str]:
    """Start it, yield its address, stop it; the test is skipped where there is none."""
    pytest.importorskip("psycopg")
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    if not found:
        pytest.skip("PostgreSQL is not installed: apt-get install postgresql-15")
    tools = found[-1].parent
    # The path of a socket is limited to 107 characters: not below pytest's folder.
    folder = Path(tempfile.mkdtemp(prefix="vhpg"))
    user, port = None, 0
    if os.geteuid() == 0:  # the server refuses to run as root
        user = "nobody"
        entry = pwd.getpwnam(user)
        os.chown(folder, entry.pw_uid, entry.pw_gid)

    def run(*words: str) -> None:
        subprocess.run(
            words, check=True, user=user, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    try:
        run(str(tools / "initdb"), "-D", str(folder / "data"), "-U", "robot", "-A", "trust", "-E", "UTF8")
        options = f"-k {folder} -c listen_addresses=''"
        if certificate(folder / "server.pem", folder / "server.key"):
            if user is not None:
                os.chown(folder / "server.key", entry.pw_uid, entry.pw_gid)
            port = free_port()
            files = f"-c ssl_cert_file={folder}/server.pem -c ssl_key_file={folder}/server.key"
            options = f"-k {folder} -p {port} -c listen_addresses=localhost -c ssl=on {files}"
        control = (str(tools / "pg_ctl"), "-D", str(folder / "data"), "-w")
        run(*control, "-l", str(folder / "log"), "-o", options, "start")
        try:
            yield f"postgresql://robot@/postgres?{f'port={port}&' if port else ''}host={folder}"
        finally:
            run(*control, "-m", "immediate", "stop")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
