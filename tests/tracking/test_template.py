"""Templates from files and tags, their quality, their detection, and sheets of them."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.core.files.image_dpi import pixels_per_metre
from visuohaptic.tracking.points import apply_homography
from visuohaptic.tracking.templates import (
    SheetItem,
    Template,
    align,
    detect_templates,
    lay_out,
    load_templates,
    save_sheet,
    tag_item,
    template_quality,
)


@pytest.fixture(scope="module")
def photo(views) -> np.ndarray:
    return views.PlaneView.named("astronaut", 240).template


def write_png(path: Path, image: np.ndarray, dpi: float) -> None:
    """A PNG with a dpi value, by an independent writer."""
    from PIL import Image

    Image.fromarray(image).save(path, dpi=(dpi, dpi))


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_size_comes_from_the_dpi_of_the_file(tmp_path: Path, photo: np.ndarray, suffix: str) -> None:
    path = tmp_path / f"face.{suffix}"
    write_png(path, photo, 150)
    found = pixels_per_metre(path.read_bytes())
    assert found == pytest.approx((150 / 0.0254, 150 / 0.0254), rel=1e-4)
    template = Template.from_file(path)
    assert template.name == "face"
    assert template.size_m == pytest.approx((240 / 150 * 0.0254,) * 2, rel=1e-4)
    corners = template.points_m(np.array([[-0.5, -0.5], [239.5, 239.5]]))
    np.testing.assert_allclose(corners[1] - corners[0], [*template.size_m, 0])


def test_large_images_shrink_and_keep_their_size(photo: np.ndarray) -> None:
    large = cv2.resize(photo, (1200, 900))
    template = Template.from_image("large", large, width_m=0.12)
    assert template.image.shape == (300, 400)
    assert template.size_m == pytest.approx((0.12, 0.09))


def test_unusable_files_are_refused_in_one_line(tmp_path: Path, photo: np.ndarray) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(cv2.imencode(".png", photo)[1].tobytes())
    with pytest.raises(InputError, match=r"a\.png: states no resolution.*give its width"):
        Template.from_file(path)
    path.write_bytes(b"nonsense")
    with pytest.raises(InputError, match="is not an image"):
        Template.from_file(path)
    path.write_bytes(cv2.imencode(".png", np.full((60, 60), 9, np.uint8))[1].tobytes())
    with pytest.raises(InputError, match="no contrast"):
        Template.from_file(path, width_m=0.1)
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="has no template"):
        load_templates(empty)
    with pytest.raises(InputError, match=r"id: found 600, expected 0\.\.586"):
        Template.from_tag(600, size_m=0.1)
    for damage in (b"\x89PNG\r\n\x1a\n\0\0", b"\xff\xd8\xff\xe0\0\x10JFIF\0", b""):
        assert pixels_per_metre(damage) is None


def test_a_folder_of_templates(tmp_path: Path, photo: np.ndarray) -> None:
    write_png(tmp_path / "b.png", photo, 100)
    (tmp_path / "c.png").write_bytes(cv2.imencode(".png", photo)[1].tobytes())
    (tmp_path / "tags.yaml").write_text("tags: {base: {id: 7, size_m: 0.04}}\nwidths_m: {c.png: 0.05}\n")
    templates = load_templates(tmp_path)
    assert [template.name for template in templates] == ["b", "c", "base"]
    assert templates[2].tag_id == 7
    (tmp_path / "tags.yaml").write_text("tags: {b: {id: 7, size_m: -1}}\n")
    with pytest.raises(InputError, match=r"tags\.b\.size_m"):
        load_templates(tmp_path)
    (tmp_path / "tags.yaml").write_text("tags: {b: {id: 7, size_m: 0.1}}\nwidths_m: {c.png: 0.05}\n")
    with pytest.raises(InputError, match="'b' twice"):
        load_templates(tmp_path)
    # Hidden files are not templates; a width for a file that does not exist is a mistake.
    (tmp_path / "._b.png").write_bytes(b"not an image")
    (tmp_path / "tags.yaml").write_text("widths_m: {c.png: 0.05}\n")
    assert [template.name for template in load_templates(tmp_path)] == ["b", "c"]
    (tmp_path / "tags.yaml").write_text("widths_m: {c.png: 0.05, B.png: 0.05}\n")
    with pytest.raises(InputError, match=r"widths_m: names 'B\.png'"):
        load_templates(tmp_path)


def test_quality_ranks_as_the_tracker_does(photo: np.ndarray, views) -> None:
    """A photo, a faint one, stripes, a chessboard: the score falls where tracking does."""
    y, x = np.mgrid[:200, :200]
    faint = (120 + cv2.resize(photo, (200, 200)) * 0.02).astype(np.uint8)
    stripes = (127 + 100 * np.sin(x / 6)).astype(np.uint8)
    chess = np.where((x // 25 + y // 25) % 2, 200, 50).astype(np.uint8)
    score = {
        name: template_quality(Template.from_image(name, image, width_m=0.1))
        for name, image in {"photo": photo, "faint": faint, "stripes": stripes, "chess": chess}.items()
    }
    assert score["photo"].score > 0.8
    assert not score["photo"].problems
    assert score["faint"].score < 0.5
    assert score["stripes"].score < 0.3
    assert score["chess"].score < 0.3
    assert any("repeats" in problem for problem in score["chess"].problems)
    assert template_quality(Template.from_tag(5, size_m=0.04)).score > 0.8
    # The predicted noise is that of the exact bound at scale 1.
    view = views.PlaneView.named("astronaut", 200)
    bound = np.sqrt(np.trace(view.bound(np.eye(3), 5.0)) / 4)
    found = template_quality(Template.from_image("x", view.template, width_m=0.1)).corner_sigma_px
    assert found == pytest.approx(bound, rel=0.15)  # its gradients are central differences


def test_detection_of_a_turned_photo_and_none_where_there_is_none(photo: np.ndarray, views) -> None:
    view = views.PlaneView.named("astronaut", 240)
    template = Template.from_image("face", photo, width_m=0.05)
    rng = np.random.default_rng(0)
    corners = np.array([[330, 80], [420, 250], [230, 330], [160, 130.0]])
    true = views.corner_homography(view.corners, corners)
    frame = view.frame(true, (480, 640), 3.0, rng)
    found = detect_templates((template,), frame)["face"]
    error = apply_homography(found.homography, view.corners) - corners
    assert np.linalg.norm(error, axis=1).max() < 4
    refined = align(template.esm, frame, found.homography)
    error = apply_homography(refined.homography, view.corners) - corners
    assert refined.valid
    assert np.linalg.norm(error, axis=1).max() < 0.1
    again = detect_templates((template,), frame, region=(100, 40, 500, 400))["face"]
    assert np.linalg.norm(apply_homography(again.homography, view.corners) - corners, axis=1).max() < 4
    gravel = views.PlaneView.named("gravel", 200).frame(np.eye(3), (480, 640), 3.0, rng)
    assert detect_templates((template,), gravel) == {}
    assert detect_templates((template,), frame, region=(5000, 0, 6000, 10)) == {}


def test_sheet_has_exact_sizes_and_its_tags_can_be_read(tmp_path: Path, photo: np.ndarray) -> None:
    items = [tag_item(3, 0.03), tag_item(11, 0.04), SheetItem("a (photo)", photo, 0.05)]
    path = tmp_path / "sheet.png"
    widths = save_sheet(path, items, dpi=300)
    assert pixels_per_metre(path.read_bytes()) == pytest.approx((300 / 0.0254,) * 2, rel=1e-4)
    page = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert page.shape == (3508, 2480)  # A4 at 300 dpi
    tags = (Template.from_tag(3, size_m=0.03), Template.from_tag(11, size_m=0.04))
    found = detect_templates(tags, page)
    assert set(found) == {"tag_3", "tag_11"}
    for tag, item in zip(tags, items, strict=False):
        refined = align(tag.esm, page, found[tag.name].homography)
        corners = apply_homography(refined.homography, tag.tag_corners)
        # A PNG rounds cells to whole pixels; what is black there is the truth for the tracker.
        column, row = np.round(corners[0]).astype(int)
        black = np.flatnonzero(page[row + 8, column - 30 : column + 600] < 128)
        side = black[-1] - black[0] + 1
        assert side * 0.0254 / 300 == pytest.approx(widths[item.label] * 0.8, abs=1.5 * 0.0254 / 300)
        assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(side, rel=2e-3)
    pdf = tmp_path / "sheet.pdf"
    assert save_sheet(pdf, items)["a (photo)"] == pytest.approx(0.05)
    data = pdf.read_bytes()
    assert data.startswith(b"%PDF-1.4")
    placed = re.findall(rb"q ([\d.]+) 0 0 ([\d.]+) [\d.]+ [\d.]+ cm /I\d Do Q", data)
    np.testing.assert_allclose(
        [float(w) * 0.0254 / 72 for w, _ in placed], [item.width_m for item in items], atol=1e-7
    )
    # Every offset of the table points to its object, and the pictures unpack.
    start = int(re.search(rb"startxref\n(\d+)", data)[1])
    offsets = [int(entry) for entry in re.findall(rb"(\d{10}) 00000 n", data[start:])]
    for number, offset in enumerate(offsets, start=1):
        assert data[offset:].startswith(f"{number} 0 obj".encode())
    stream = re.search(rb"/Width 240 .*?/Length (\d+) >>\nstream\n", data)
    raw = zlib.decompress(data[stream.end() : stream.end() + int(stream[1])])
    np.testing.assert_array_equal(np.frombuffer(raw, np.uint8).reshape(240, 240), photo)


def test_sheet_refuses_what_does_not_fit(tmp_path: Path, photo: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"does not fit on A4.*larger paper"):
        lay_out([SheetItem("big", photo, 0.25)])
    with pytest.raises(InputError, match="does not fit"):
        lay_out([SheetItem(str(k), photo, 0.08) for k in range(9)])
    with pytest.raises(InputError, match="expected one of A4, A3, letter"):
        lay_out([], "A7")
    with pytest.raises(InputError, match=r"'\.txt', expected \.pdf or \.png"):
        save_sheet(tmp_path / "a.txt", [])
    # Eight cells of one dot of 1/2400 inch are 85 um; a PDF would name a width of 0.
    assert tag_item(1, 86e-6).width_m == pytest.approx(1.25 * 86e-6)
    with pytest.raises(InputError, match=r"found 8\.4e-05, expected .*8\.46667e-05"):
        tag_item(1, 84e-6)


@pytest.mark.parametrize("shape", [(420, 640), (333, 1000), (1001, 777)])
def test_a_large_image_keeps_its_proportions(shape: tuple[int, int]) -> None:
    """640 x 420 became 400 x 262, whose pixels were taken as square: 0.13 px at the lower border, 40 times sigma."""
    width_m, period_m = 0.1, 0.1 / 400 * 16 * max(shape) / shape[1]
    y = (np.arange(shape[0]) - 0.5 * (shape[0] - 1)) * width_m / shape[1]
    x = (np.arange(shape[1]) - 0.5 * (shape[1] - 1)) * width_m / shape[1]

    def printed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 127 + 60 * np.sin(2 * np.pi * x / period_m) + 60 * np.cos(2 * np.pi * y / period_m)

    image = np.rint(printed(x[None, :], y[:, None])).astype(np.uint8)
    template = Template.from_image("waves", image, width_m=width_m)
    rows, columns = template.image.shape
    assert max(rows, columns) == 400
    v, u = np.mgrid[:rows, :columns]
    point = template.points_m(np.stack([u, v], axis=-1).astype(float))
    off = template.image - printed(point[..., 0], point[..., 1])
    # Means over a sixteenth of the period lose 0.64 % of 120. Pixels of the image are up to 1 / 1.6 of one here: a slope of
    # 24 a pixel is cut into steps of 15, of which a cell may begin and end with half a one, twice. 0.13 px would be 3.1
    # in each direction, at all places along the border.
    border = np.abs(np.concatenate([off[:8], off[-8:]])).mean()
    assert border < 0.009 * 120
