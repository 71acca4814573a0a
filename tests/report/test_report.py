"""The page is one file that loads nothing, and shows exactly its input."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from visuohaptic.core import InputError
from visuohaptic.report import Report


class Page(HTMLParser):
    """Collects addresses, ids, and whether every element is closed."""

    VOID = frozenset({"meta", "img", "br", "hr"})

    def __init__(self):
        super().__init__()
        self.addresses, self.ids, self.open, self.text = [], [], [], []

    def handle_starttag(self, tag, attrs):
        if tag not in self.VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href"):
                self.addresses.append(value)
            if name == "id":
                self.ids.append(value)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def parsed(report: Report) -> Page:
    page = Page()
    page.feed(report.html())
    assert page.open == []
    return page


def drawing() -> Figure:
    figure = Figure()
    figure.subplots().plot([0, 1], [0, 1], label="force")
    return figure


def test_nothing_is_loaded_from_outside():
    report = Report("Touch").section("One").figure(drawing(), "a").section("Two").figure(drawing(), "b")
    report.image(np.zeros((4, 6, 3), np.uint8), "frame").table([{"a": 1}])
    page = parsed(report)
    assert page.addresses
    assert all(
        address.startswith(("#", "data:image/png;base64,", "data:image/webp;base64,"))
        for address in page.addresses
    )
    assert not re.search(r"url\((?!#)", report.html())
    assert "<script" not in report.html()


def test_ids_are_unique_and_every_inner_link_has_its_target():
    page = parsed(Report("Touch").section("Same").figure(drawing()).section("Same").figure(drawing()))
    assert len(page.ids) == len(set(page.ids))
    assert {address[1:] for address in page.addresses if address.startswith("#")} <= set(page.ids)


def test_texts_are_escaped():
    nasty = "<script>alert('x')</script> & \"quoted\""
    report = Report(nasty, about=nasty).section(nasty).text(nasty).code(nasty)
    report.table([{nasty: nasty}], nasty).image(np.zeros((2, 2), np.uint8), nasty)
    page = parsed(report)
    assert "script" not in page.open
    assert "<script" not in report.html()
    assert "".join(page.text).count(nasty) == 11
    # Page title, headline, about, menu, section, text, code, three in the table, one below the picture.


def test_a_picture_survives_bit_for_bit():
    picture = np.random.default_rng(0).integers(0, 255, (20, 30, 3), dtype=np.uint8)
    page = Report("t").image(picture).html()
    data = re.search(r"base64,([A-Za-z0-9+/=]+)", page)
    assert data
    found = cv2.imdecode(np.frombuffer(base64.b64decode(data[1]), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(found, picture)


def test_a_picture_of_the_wrong_kind_is_refused():
    with pytest.raises(InputError, match=r"Report: image: found float64 of shape \(2, 2\), expected 8-bit"):
        Report("t").image(np.zeros((2, 2)))


def test_tables_keep_not_observed_apart_from_zero():
    html = Report("t").table([{"force [N]": 0.0, "fixed": True}, {"force [N]": None, "fixed": False}]).html()
    assert '<td class="number">0</td>' in html
    assert "not observed" in html
    assert "<td>yes</td>" in html
    assert "<td>no</td>" in html


def test_the_same_report_is_the_same_file(tmp_path):
    first = Report("t").figure(drawing()).write(tmp_path / "a.html").read_bytes()
    assert Report("t").figure(drawing()).write(tmp_path / "b.html").read_bytes() == first
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.html", "b.html"]


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match="its folder does not exist"):
        Report("t").write(tmp_path / "no" / "a.html")


@pytest.mark.parametrize(("shape", "kind"), [((20, 20_000), "png"), ((600, 500), "webp"), ((20, 30), "png")])
def test_large_images_are_webp_unless_they_are_too_long_for_it(shape, kind):
    image = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    (address,) = parsed(Report("strip").image(image)).addresses
    head, data = address.split(",")
    assert head == f"data:image/{kind};base64"
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown.shape == shape


@pytest.mark.parametrize("colours", [2, 5])
def test_an_image_of_no_colours_is_refused(colours):
    with pytest.raises(InputError, match=rf"Report: image: found uint8 of shape \(9, 9, {colours}\)"):
        Report("a").image(np.zeros((9, 9, colours), np.uint8))
