"""Hostile input in a process of its own: 2 GB of memory, 20 s of CPU time, and only a one-line InputError is accepted."""

from __future__ import annotations

import atexit
import json
import selectors
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

from tests.patience import PATIENCE_S

#: Forks a process for each call that it reads, and writes its status and what it printed. Libraries are imported once.
_SERVER = """
import importlib, json, os, resource, sys, tempfile, traceback
from pathlib import Path
from visuohaptic.core.errors import InputError

def call(module, expression, path):
    resource.setrlimit(resource.RLIMIT_AS, (2 << 30,) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (20,) * 2)  # that of a busy machine is the same
    try:
        eval(expression, {**vars(module), "path": Path(path)})
    except InputError as error:
        print(error)
    else:
        raise SystemExit("accepted")

for line in sys.stdin:
    name, expression, path = json.loads(line)
    module = importlib.import_module(name)
    getattr(module, expression.partition("(")[0].partition(".")[0])  # a name that is imported when it is used
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        child = os.fork()
        if not child:
            code = 1
            try:
                sys.stdout, sys.stderr = out, err
                os.dup2(out.fileno(), 1)
                os.dup2(err.fileno(), 2)
                call(module, expression, path)
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                out.flush()
                err.flush()
                os._exit(code)
        _, status = os.waitpid(child, 0)
        answer = [status]
        for stream in (out, err):
            stream.seek(0)
            answer.append(stream.read())
    print(json.dumps(answer), flush=True)
"""


@lru_cache(maxsize=1)
def _server() -> subprocess.Popen[str]:
    command = ["env", "OPENBLAS_NUM_THREADS=1", sys.executable, "-c", _SERVER]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    atexit.register(process.wait)
    atexit.register(process.kill)  # what is registered last is called first
    return process


def refusal(call: str, path: Path) -> str:
    """What ``call`` says when it refuses; fails when it accepts, crashes, or takes its time.

    ``call`` is "module:expression", where ``path`` stands for the file.
    """
    server = _server()
    assert server.stdin is not None
    assert server.stdout is not None
    module, _, expression = call.partition(":")
    print(json.dumps([module, expression, str(path)]), file=server.stdin, flush=True)
    with selectors.DefaultSelector() as waiting:
        waiting.register(server.stdout, selectors.EVENT_READ)
        if not waiting.select(PATIENCE_S):
            server.kill()
            _server.cache_clear()
            raise AssertionError(f"{call} hangs")
    status, said, errors = json.loads(server.stdout.readline())
    assert status == 0, errors[-2000:]
    assert said.count("\n") == 1, said[:2000]
    assert len(said) < 1000, "a message, not a dump"
    assert path.name in said, "which file?"
    return said
