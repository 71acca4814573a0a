"""A headless Chromium controlled by its debugging protocol, which records its requests."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

from tests.patience import PATIENCE_S

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
    # Pixels are drawn in software: the time of a frame grows with the area of the window.
    "--window-size=900,600",
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
        self._loaded = False
        try:
            port = self._port(profile / "DevToolsActivePort")
            self._socket = connect(self._page_address(port), max_size=None)
        except BaseException:
            self._process.kill()
            raise
        for domain in ("Network", "Page", "Runtime"):
            self.call(f"{domain}.enable")

    def _port(self, file: Path) -> int:
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s and self._process.poll() is None:
            if file.is_file() and len(lines := file.read_text().splitlines()) >= 2:
                return int(lines[0])
            time.sleep(0.1)
        raise TimeoutError(f"Chromium opened no debugging port (exit status {self._process.poll()})")

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
            message = self._receive()
            if message.get("id") == self._number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]

    def _receive(self) -> dict[str, Any]:
        message = json.loads(self._socket.recv(timeout=PATIENCE_S))
        if message.get("method") == "Page.loadEventFired":
            self._loaded = True
        elif message.get("method") == "Network.requestWillBeSent":
            self.requests.append(message["params"]["request"]["url"])
        elif message.get("method") == "Network.webSocketCreated":
            self.requests.append(message["params"]["url"])
        return message

    def open(self, address: str) -> None:
        """Go to a page and wait until it is loaded."""
        self.call_and_load("Page.navigate", url=address)

    def call_and_load(self, method: str, **parameters: Any) -> None:
        """Send one command and wait until the page that it loads is there."""
        self._loaded = False
        self.call(method, **parameters)
        while not self._loaded:
            self._receive()

    def evaluate(self, expression: str) -> Any:
        """Value of a JavaScript expression, or of the promise that it is."""
        found = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait_for(self, text: str) -> str:
        """Wait until the page shows a text; returns all of its text."""
        found = self.evaluate(
            f"""new Promise(done => {{
                const check = late => {{
                    const shown = document.body.innerText;
                    if (!late && !shown.includes({json.dumps(text)})) return;
                    observer.disconnect();
                    done(shown);
                }};
                const observer = new MutationObserver(() => check(false));
                observer.observe(document, {{subtree: true, childList: true, characterData: true, attributes: true}});
                setTimeout(() => check(true), {900 * PATIENCE_S});
                check(false);
            }})"""
        )
        assert text in found, f"the page does not show {text!r} but {found!r}"
        return found

    def canvas_centre(self) -> tuple[float, float]:
        """Position of the middle of the scene in the window [px]."""
        x, y, tag = self.evaluate(
            """(() => {
                const box = document.querySelector("canvas").getBoundingClientRect();
                const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
                return [x, y, document.elementFromPoint(x, y).tagName];
            })()"""
        )
        assert tag == "CANVAS", f"the middle of the scene is covered by {tag}"
        return x, y

    def click(self, x: float, y: float) -> None:
        """Press and release the left button once at a position in the window [px]."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

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
