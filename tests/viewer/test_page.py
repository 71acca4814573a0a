"""The live page: only for this machine, with or without a browser, loading nothing from outside."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from tests.patience import PATIENCE_S
from tests.viewer import browser

from visuohaptic.core import ErrorBudget, Estimate, ForceProfile, HapticTag, InputError, Reason
from visuohaptic.core.camera import Pose
from visuohaptic.viewer import LivePage
from visuohaptic.viewer.page import _tag_line

pytest.importorskip("viser", reason="the browser page is an extra")


def profile(force_N: float, *, valid: bool = True, count: int = 21) -> ForceProfile:
    s_m = np.linspace(-0.1, 0.1, count)
    delta_m = 1e-3 * force_N * np.exp(-((s_m / 0.03) ** 2))
    ones = np.ones(count)
    return ForceProfile(
        t_s=force_N,
        valid=valid,
        reason=Reason.OK if valid else Reason.OCCLUDED,
        force_N=force_N,
        budget=ErrorBudget(image_N=0.01),
        s_m=s_m,
        delta_m=delta_m,
        delta_sigma_m=1e-5 * ones,
        pressure_Pa=5e5 * delta_m,
        pressure_sigma_Pa=50 * ones,
        point_valid=np.ones(count, bool),
    )


@pytest.fixture
def page():
    with LivePage(port=0, rate_hz=1e6) as live:
        yield live


def other_address() -> str | None:
    """An address of this machine that is not the loopback."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("10.255.255.255", 1))  # a datagram socket sends nothing when it connects
        except OSError:
            return None
        address = probe.getsockname()[0]
    return None if address.startswith("127.") else address


def test_it_answers_on_the_loopback_and_nowhere_else(page):
    port = urlsplit(page.url).port
    assert page.url.startswith(f"http://127.0.0.1:{port}/")
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S):
        pass
    listening = Path("/proc/net/tcp")
    if listening.is_file():
        local = [
            line.split()[1] for line in listening.read_text().splitlines()[1:] if line.split()[3] == "0A"
        ]
        assert [entry for entry in local if entry.endswith(f":{port:04X}")] == [f"0100007F:{port:04X}"]
    if (address := other_address()) is not None:
        with pytest.raises(OSError):  # noqa: PT011 - refused or unreachable, as the system likes
            socket.create_connection((address, port), timeout=5)


def test_updates_without_a_browser(page):
    page.set_map(np.zeros((40, 60), np.int8), 0.05, (-1.0, -1.0))
    square = np.array([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2]])
    pose = Pose(np.eye(3), np.array([1.0, 0.0, 0.0]))
    for step in range(5):
        page.set_obstacle("box", square, pose)
        assert page.update(
            step / 30,
            frame_bgr=np.zeros((90, 160), np.uint8),
            profile=profile(step, valid=step != 2),
            truth_N=step if step > 2 else None,
            T_world_foam=pose,
        )
    page.set_tags({"box": HapticTag(dynamic_friction_N=Estimate(3.2, 0.1)), "wall": "fixed"})


def test_an_obstacle_has_the_colour_of_what_is_known_of_it(page):
    square, colours = np.array([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2]]), []
    for fixed in (None, False, None, True):
        page.set_obstacle("crate", square, Pose.identity(), fixed=fixed)
        colours.append(tuple(page._obstacles["crate"].color))
    unknown, movable, kept, immovable = colours
    assert kept == movable
    assert len({unknown, movable, immovable}) == 3


def test_a_tag_is_told_in_one_line():
    tag = HapticTag(
        fixed=False, dynamic_friction_N=Estimate(3.2, 0.1), min_static_friction_N=20.0, falls=True
    )
    assert _tag_line(tag) == "movable, friction 3.20 ± 0.10 N, friction more than 20 N, falls"
    assert _tag_line(HapticTag(fixed=True)) == "fixed"
    assert _tag_line(HapticTag()) == "nothing observed"


def test_the_rate_limits_drawing_and_not_the_record(page):
    page._period_s = 3600.0
    assert [page.update(step, profile=profile(step)) for step in range(4)] == [True, False, False, False]
    assert len(page._forces) == 4


def test_a_source_that_starts_again_starts_a_new_curve(page):
    for t_s in (0.0, 1.0, 2.0, 0.5, 0.6):
        page.update(t_s, profile=profile(1.0))
    assert [row[0] for row in page._forces] == pytest.approx([0.5, 0.6])


def test_a_strip_may_change_its_number_of_points(page):
    page.update(0.0, profile=profile(1.0, count=21))
    page.update(0.1, profile=profile(1.0, count=33))


def test_contours_have_to_fit_the_profile(page):
    with pytest.raises(InputError, match="found 4 points, expected 21 as in the profile"):
        page.update(0.0, profile=profile(1.0), contours_foam_m=(np.zeros((4, 2)), np.zeros((4, 2))))


def test_a_port_in_use_is_left_alone(page):
    port = urlsplit(page.url).port
    with LivePage(port=port) as other:
        assert other.url != page.url


def test_sharing_through_the_internet_is_refused(page):
    assert page._server.request_share_url() is None


@pytest.mark.parametrize("port", ["x", "8080", [], -1, 65536, 80.5, None])
def test_a_port_that_cannot_be_one_is_refused(port):
    """Viser's own thread fails on some of them, and the page waited for it forever."""
    with pytest.raises(InputError, match=r"^LivePage: port: found .*expected 0 to 65535"):
        LivePage(port)


@pytest.mark.parametrize("rate_hz", [0, -1, float("nan")])
def test_a_rate_is_positive(rate_hz):
    with pytest.raises(InputError, match="LivePage: rate_hz"):
        LivePage(0, rate_hz=rate_hz)


def test_closing_twice_does_no_harm():
    live = LivePage(port=0)
    live.close()
    live.close()


def test_the_page_follows_the_colours_of_the_browsers_system(page):
    """It contains the script that asks for them, also in an address that asks already."""
    from urllib.request import urlopen

    for query in ("", "?darkMode="):
        with urlopen(f"{page.url}{query}") as answer:
            text = answer.read()
            assert answer.headers["Content-Length"] == str(len(text))
        assert b"prefers-color-scheme" in text[:4000]


@pytest.mark.slow
def test_a_browser_shows_the_page_and_asks_nobody_else(page, tmp_path):
    if (program := browser.find_chromium()) is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    page.set_tags({"a|b": "<script>felt</script>"})
    for step in range(3):
        page.update(
            step,
            frame_bgr=np.full((90, 160), 128, np.uint8),
            profile=profile(1.5),
            truth_N=1.4,
            note="contact",
        )
    chromium = browser.Browser(program, tmp_path / "profile")
    try:
        dark, light = ([{"name": "prefers-color-scheme", "value": scheme}] for scheme in ("dark", "light"))
        theme = "document.documentElement.getAttribute('data-mantine-color-scheme')"
        chromium.call("Emulation.setEmulatedMedia", features=dark)
        chromium.open(page.url)
        chromium.wait_for("felt")
        assert chromium.evaluate(theme) == "dark"
        chromium.call_and_load("Emulation.setEmulatedMedia", features=light)
        text = chromium.wait_for("felt")
        assert chromium.evaluate(theme) == "light"
        chromium.screenshot(tmp_path / "page.png")
    finally:
        chromium.close()
    assert "1.50 ± 0.01 N" in text
    assert "true 1.40 N" in text
    assert "<script>felt</script>" in text
    host = urlsplit(page.url).netloc  # the secret is in the first address alone
    own = ("data:", f"blob:http://{host}/", f"http://{host}/", f"ws://{host}/")
    outside = [address for address in chromium.requests if not address.startswith(own)]
    assert outside == [], json.dumps(outside)
    assert (tmp_path / "page.png").stat().st_size > 10_000
