"""Malformed and foreign requests to a page that is served, which must not be answered."""

from __future__ import annotations

import http.client
import socket
from urllib.parse import urlsplit

import numpy as np

__all__ = ["attack", "serve_and_attack"]

Rng = np.random.Generator


def serve_and_attack(count: int, rng: Rng) -> dict[str, int]:
    """Requests to a live page: which were answered, and whether it still serves afterwards."""
    from visuohaptic.viewer import LivePage

    with LivePage(port=0) as page:
        answered = attack(page.url, count, rng)
        address = urlsplit(page.url)
        connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=20)
        connection.request("GET", f"{address.path}", headers={"Host": f"127.0.0.1:{address.port}"})
        served = connection.getresponse().status == 200
    return {"tried": count, "crashed": int(not served), "wrong": answered}


def attack(url: str, count: int, rng: Rng) -> int:
    """How many of some requests to a page are answered."""
    address, answered = urlsplit(url), 0
    host = f"127.0.0.1:{address.port}"
    for number in range(count):
        with socket.create_connection(("127.0.0.1", address.port or 0), timeout=20) as client:
            client.sendall(_request(number, host, address.path.strip("/"), rng))
            if number % 4 == 3:  # noise: more may be awaited
                client.shutdown(socket.SHUT_WR)
            try:
                status = client.recv(1000)[:20]
            except ConnectionResetError:
                status = b""
        answered += b" 200 OK" in status or b" 101 " in status
    return answered


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
