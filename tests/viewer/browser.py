"""A headless Chromium controlled by its debugging protocol, which records its requests."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-port=0",
    "--window-size=1500,1000",
)


def find_chromium() -> str | None:
    """The browser's program, if this machine has one."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((found for name in names if (found := shutil.which(name))), None)


class Browser:
    """One page in a fresh profile."""

    def __init__(self, program: str, profile: Path) -> None:
        from websockets.sync.client import connect

        command = [program, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.requests: list[str] = []
        self._number = 0
        try:
            port = self._port(profile / "DevToolsActivePort")
            self._socket = connect(self._page_address(port), max_size=None)
        except BaseException:
            self._process.kill()
            raise
        for domain in ("Network", "Page", "Runtime"):
            self.call(f"{domain}.enable")

    @staticmethod
    def _port(file: Path) -> int:
        deadline_s = time.monotonic() + 90
        while time.monotonic() < deadline_s:
            if file.is_file() and len(lines := file.read_text().splitlines()) >= 2:
                return int(lines[0])
            time.sleep(0.1)
        raise TimeoutError("Chromium did not open its debugging port within 30 s")

    @staticmethod
    def _page_address(port: int) -> str:
        from urllib.request import urlopen

        with urlopen(f"http://127.0.0.1:{port}/json") as answer:
            pages = json.load(answer)
        return next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send one command and return its result."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=90))
            self._note(message)
            if message.get("id") == self._number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]

    def _note(self, message: dict[str, Any]) -> None:
        if message.get("method") == "Network.requestWillBeSent":
            self.requests.append(message["params"]["request"]["url"])
        elif message.get("method") == "Network.webSocketCreated":
            self.requests.append(message["params"]["url"])

    def open(self, address: str) -> None:
        """Go to a page."""
        self.call("Page.navigate", url=address)

    def text(self) -> str:
        """All text that the page shows."""
        found = self.call("Runtime.evaluate", expression="document.body ? document.body.innerText : ''")
        return found["result"].get("value", "")

    def wait_for(self, text: str, patience_s: float = 30.0) -> str:
        """Wait until the page shows a text; returns all of its text."""
        deadline_s = time.monotonic() + patience_s
        while text not in (found := self.text()):
            assert time.monotonic() < deadline_s, f"the page does not show {text!r} but {found!r}"
            time.sleep(0.2)
        return found

    def screenshot(self, path: Path) -> None:
        """Write what the page looks like as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def close(self) -> None:
        """End the browser."""
        self._socket.close()
        self._process.terminate()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
