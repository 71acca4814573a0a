"""Maps: the rules of map_server written out, real maps, and hostile files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from visuohaptic.core import InputError
from visuohaptic.io.maps import OccupancyMap


def write(folder: Path, pixels: np.ndarray, name: str = "m.png", **fields: object) -> Path:
    assert cv2.imwrite(str(folder / name), pixels)
    values = {"image": name, "resolution": 0.05, "origin": [0, 0, 0], "negate": 0}
    values |= {"occupied_thresh": 0.65, "free_thresh": 0.196} | fields
    (folder / "m.yaml").write_text("".join(f"{key}: {value}\n" for key, value in values.items()))
    return folder / "m.yaml"


LEVELS = np.array([[0, 89, 90, 204, 205, 206, 254, 255]], np.uint8)


def test_trinary_by_hand(tmp_path: Path) -> None:
    # occupancy = 1 - level / 255: 0.651 at 89, 0.647 at 90; 0.1961 at 205, 0.192 at 206
    grid = OccupancyMap.load(write(tmp_path, LEVELS))
    assert grid.cells.tolist() == [[100, 100, -1, -1, -1, 0, 0, 0]]
    negated = OccupancyMap.load(write(tmp_path, 255 - LEVELS, negate=1))
    assert negated.cells.tolist() == grid.cells.tolist()


def test_scale_and_raw_by_hand(tmp_path: Path) -> None:
    scale = OccupancyMap.load(write(tmp_path, LEVELS, mode="scale")).cells[0]
    part = (1 - 204 / 255 - 0.196) / (0.65 - 0.196)
    assert scale[3] == round(100 * part), "Nav2; ROS 1 spread the values from 1 to 99"
    assert (scale[0], scale[7]) == (100, 0)
    raw = OccupancyMap.load(write(tmp_path, np.array([[0, 1, 50, 100, 101, 255]], np.uint8), mode="raw"))
    assert raw.cells.tolist() == [[0, 1, 50, 100, -1, -1]]


def test_colour_alpha_and_16_bit(tmp_path: Path) -> None:
    colour = np.zeros((1, 3, 3), np.uint8)
    colour[0, 1] = 255
    colour[0, 2] = [0, 255, 255]  # a mean of 170: occupancy 0.33
    assert OccupancyMap.load(write(tmp_path, colour)).cells.tolist() == [[100, 0, -1]]
    alpha = np.dstack([np.zeros((1, 2, 3), np.uint8), np.array([[255, 0]], np.uint8)])
    assert OccupancyMap.load(write(tmp_path, alpha)).cells.tolist() == [[100, -1]]
    deep = np.array([[0, 52_600, 65_535]], np.uint16)
    assert OccupancyMap.load(write(tmp_path, deep)).cells.tolist() == [[100, -1, 0]]


@pytest.mark.parametrize("header", [b"P2\n# a comment\n3 2 # size\n1000\n", b"P2 3 2 1000 "])
def test_text_pgm(tmp_path: Path, header: bytes) -> None:
    (tmp_path / "m.pgm").write_bytes(header + b"0 1000 790\n1000 0 # last row\n0\n")
    grid = OccupancyMap.from_image(tmp_path / "m.pgm", 0.1)
    assert grid.cells.tolist() == [[0, 100, 100], [100, 0, -1]], "the last row of the picture is row 0"


def test_binary_pgm_of_two_bytes(tmp_path: Path) -> None:
    pixels = np.array([0, 4095, 3000], ">u2")
    (tmp_path / "m.pgm").write_bytes(b"P5\n#c\n3 1\n4095\n" + pixels.tobytes())
    assert OccupancyMap.from_image(tmp_path / "m.pgm", 0.1).cells.tolist() == [[100, 0, -1]]


def test_cells_and_world_with_a_turned_origin() -> None:
    grid = OccupancyMap(np.zeros((30, 40), np.int8), 0.1, (2.0, -1.0, 3.14))
    cells = np.stack(np.meshgrid(np.arange(30), np.arange(40), indexing="ij"), axis=-1)
    points = grid.world_from_cell(cells)
    np.testing.assert_array_equal(grid.cell_from_world(points), cells)
    # By hand: the centre of cell (0, 0) turned by 3.14 rad about the origin.
    c, s = np.cos(3.14), np.sin(3.14)
    np.testing.assert_allclose(points[0, 0], [2 + 0.05 * c - 0.05 * s, -1 + 0.05 * s + 0.05 * c])
    rng = np.random.default_rng(0)
    anywhere = points.reshape(-1, 2) + 0.049 * (rng.uniform(-1, 1, (1200, 2)) @ np.array([[c, s], [-s, c]]))
    np.testing.assert_array_equal(grid.cell_from_world(anywhere), cells.reshape(-1, 2))


def test_outside_is_unknown() -> None:
    grid = OccupancyMap(np.full((3, 4), 100, np.int8), 0.5)
    points = np.array([[0.1, 0.1], [1.9, 1.4], [2.1, 0.1], [-0.1, 0.1], [np.nan, 0], [1e300, 0]])
    assert grid.value_at(points).tolist() == [100, 100, -1, -1, -1, -1]
    assert grid.size_m == pytest.approx((2.0, 1.5))


@pytest.mark.parametrize("values", [[-1, 0, 100], [-1, 0, 1, 37, 99, 100]])
def test_saved_maps_come_back(tmp_path: Path, values: list[int]) -> None:
    cells = np.random.default_rng(2).choice(values, (17, 23)).astype(np.int8)
    grid = OccupancyMap(cells, 0.025, (1.5, -2.25, 0.3))
    grid.save(tmp_path / "map.yaml")
    back = OccupancyMap.load(tmp_path / "map.yaml")
    np.testing.assert_array_equal(back.cells, cells)
    assert (back.resolution_m, back.origin) == (grid.resolution_m, grid.origin)
    # An independent reader of the picture: the first row of the file is the top of the map.
    picture = cv2.imread(str(tmp_path / "map.pgm"), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (17, 23)
    if len(values) == 3:
        np.testing.assert_array_equal(picture[::-1] == 0, cells == 100)


def test_the_image_stays_inside_the_folder(tmp_path: Path) -> None:
    inner = tmp_path / "maps"
    inner.mkdir()
    cv2.imwrite(str(tmp_path / "secret.png"), LEVELS)
    path = write(inner, LEVELS, image="../secret.png")
    with pytest.raises(InputError, match="expected a file inside the folder of the map"):
        OccupancyMap.load(path)
    (inner / "link.png").symlink_to(tmp_path / "secret.png")
    write(inner, LEVELS, image="link.png")
    with pytest.raises(InputError, match="inside the folder"):
        OccupancyMap.load(path)
    write(inner, LEVELS, image=tmp_path / "secret.png")
    with pytest.raises(InputError, match="which does not exist"):
        OccupancyMap.load(path)
    write(inner, LEVELS, image="/elsewhere/m.png")
    assert OccupancyMap.load(path).shape == (1, 8), (
        "of an absolute path the name is looked for beside the map"
    )


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"origin": "[0, .nan, 0]"}, "origin"),
        ({"origin": "[0, 0]"}, "origin"),
        ({"resolution": 0}, "resolution"),
        ({"resolution": ".inf"}, "resolution"),
        ({"mode": "fancy"}, "mode"),
        ({"free_thresh": 0.7}, "expected less than occupied_thresh"),
        ({"image": "none.png"}, "which does not exist"),
    ],
)
def test_bad_yaml(tmp_path: Path, fields: dict[str, object], problem: str) -> None:
    path = write(tmp_path, LEVELS, **fields)
    if fields.get("image"):
        (tmp_path / "m.png").unlink()
    with pytest.raises(InputError, match=problem) as caught:
        OccupancyMap.load(path)
    assert "m.yaml" in str(caught.value)


def test_a_transparent_entry_of_a_palette_is_refused(tmp_path: Path) -> None:
    """Its pixels are unknown, and decoders show the colour below."""
    indexed = Image.fromarray(np.array([[0, 1, 2]], np.uint8), "P")
    indexed.putpalette([0, 0, 0, 255, 255, 255, 255, 255, 255])
    indexed.save(tmp_path / "m.png")
    assert OccupancyMap.from_image(tmp_path / "m.png", 0.05).cells.tolist() == [[100, 0, 0]]
    indexed.save(tmp_path / "m.png", transparency=2)
    with pytest.raises(InputError, match="transparent colour without an alpha channel; save it as RGBA"):
        OccupancyMap.from_image(tmp_path / "m.png", 0.05)


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"P5\n100000 100000\n255\n1234", "100000 x 100000"),
        (b"P5\n10 10\n255\n1234", "has 4 bytes of pixels, expected 100"),
        (b"P5\n2 2\n70000\n1234", "maxval: found 70000"),
        (b"P2\n2 2\n255\n1 2 3 x", "not a number"),
        (b"P2\n2 2\n255\n1 2 3 256", "maxval is 255"),
        (b"P5\n-2 2\n255\n1234", "expected a positive size"),
        (b"P5\n2", "header"),
        (b"P2\n2 2\n255\n1 2 3 4 5", "has more than 4 pixels, the size in its header"),
        (b"P2\n2 2\n255\n1 2 3 # 4", "has 3 pixels, expected 4"),
        (b"P2\n2 2\n255\n1 2 3 -4", "has pixels from -4 to 3"),
        (b"P2\n2 2\n255\n1 2", "has 4 bytes of pixels, expected at least 7"),
        (b"P5\n2 2\n255x1234", "after the PGM header, expected a space"),
        (b"P5\n2 2\n# no more", "expected a number in the PGM header"),
        (b"GIF89a", "expected a PNG"),
        (b"", "expected a PNG"),
    ],
)
def test_bad_pictures(tmp_path: Path, data: bytes, problem: str) -> None:
    (tmp_path / "m.pgm").write_bytes(data)
    with pytest.raises(InputError, match=problem):
        OccupancyMap.from_image(tmp_path / "m.pgm", 0.05)


def test_bad_arrays() -> None:
    for cells in (np.zeros((0, 3), np.int8), np.full((2, 2), 101), np.zeros((2, 2)), np.zeros(4, np.int8)):
        with pytest.raises(InputError):
            OccupancyMap(cells, 0.05)
    with pytest.raises(InputError, match="resolution_m"):
        OccupancyMap(np.zeros((2, 2), np.int8), float("nan"))


@pytest.mark.data
def test_all_real_maps(data: Path) -> None:
    folder = data / "navigation" / "dev" / "maps"
    read = 0
    for path in sorted(folder.glob("*/*.yaml")):
        if "resolution" not in path.read_text():
            with pytest.raises(InputError):
                OccupancyMap.load(path)
            continue
        grid = OccupancyMap.load(path)
        assert grid.free.sum() > 500, path
        assert grid.occupied.sum() > 50, path
        read += 1
    assert read >= 14
    for path in sorted([*folder.glob("*/*.pgm"), *folder.glob("*/*.png")]):
        grid = OccupancyMap.from_image(path, 0.05)
        # The whole picture against OpenCV's reading of it.
        grey = cv2.imread(str(path), cv2.IMREAD_COLOR).mean(axis=2)[::-1]
        np.testing.assert_array_equal(grid.occupied, 1 - grey / 255 > 0.65)


def test_from_arrays() -> None:
    np.testing.assert_array_equal(OccupancyMap(np.array([[True, False]]), 0.05).cells, [[100, 0]])
    probability = np.array([[0.0, 0.196, 0.5, 0.65, 1.0, np.nan]])
    assert OccupancyMap.from_probability(probability, 0.05).cells.tolist() == [[0, -1, -1, -1, 100, -1]]
    with pytest.raises(InputError, match=r"of 0\.\.1 or NaN"):
        OccupancyMap.from_probability(np.array([[1.5]]), 0.05)


def test_a_cut_picture_is_refused_wherever_it_is_cut(tmp_path: Path) -> None:
    # OpenCV fills what is missing of a PNG or JPEG with grey: that would be a map nobody made.
    pixels = np.random.default_rng(0).integers(0, 255, (20, 30), np.uint8)
    for suffix in (".png", ".bmp", ".jpg"):
        whole = bytes(cv2.imencode(suffix, pixels)[1].tobytes())
        (tmp_path / f"m{suffix}").write_bytes(whole)
        assert OccupancyMap.from_image(tmp_path / f"m{suffix}", 0.05).shape == (20, 30)
        for keep in range(0, len(whole) - 1, 7):
            (tmp_path / f"m{suffix}").write_bytes(whole[:keep])
            with pytest.raises(InputError):
                OccupancyMap.from_image(tmp_path / f"m{suffix}", 0.05)


@pytest.mark.parametrize(
    "field", ["image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"]
)
def test_as_in_map_server_only_the_mode_may_be_left_out(tmp_path: Path, field: str) -> None:
    path = write(tmp_path, LEVELS)
    OccupancyMap.load(path)
    lines = [line for line in path.read_text().splitlines() if not line.startswith(field)]
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=f"{field}: is missing"):
        OccupancyMap.load(path)


def test_colour_netpbm(tmp_path: Path) -> None:
    (tmp_path / "m.ppm").write_bytes(b"P6\n3 1\n255\n" + bytes([0, 0, 0, 255, 255, 255, 255, 255, 0]))
    assert OccupancyMap.from_image(tmp_path / "m.ppm", 0.05).cells.tolist() == [[100, 0, -1]]


@pytest.mark.data
def test_the_stata_map_is_turned_by_its_origin(data: Path) -> None:
    folder = data / "navigation" / "dev" / "maps" / "mit_stata"
    grid = OccupancyMap.load(folder / "stata_basement.yaml")
    assert grid.origin == pytest.approx((25.9, 48.5, 3.14))
    # The far corner lies almost opposite: by hand, origin - size, and 1.6 mrad of rest of the half turn.
    far = grid.world_from_cell(np.array(grid.shape) - 1)
    width, height = grid.size_m
    turn = np.array([[np.cos(3.14), -np.sin(3.14)], [np.sin(3.14), np.cos(3.14)]])
    np.testing.assert_allclose(far, [25.9, 48.5] + turn @ (np.array([width, height]) - 0.5 * 0.0504))
    assert far[0] < -61
    assert far[1] < -16.8


@pytest.mark.parametrize(
    "data",
    [
        b"P4\n# a bitmap has no maxval\n10 2\n\x80\x40\xff\x80",
        b"P1\n10 2\n1000000001\n1 1 1 1 1 1 1 1 1 0 # the last\n",
    ],
)
def test_bitmaps_are_black_where_occupied(tmp_path, data):
    (tmp_path / "m.pbm").write_bytes(data)
    (tmp_path / "m.yaml").write_text(
        "{image: m.pbm, resolution: 0.1, origin: [0, 0, 0], negate: 0, occupied_thresh: 0.65, free_thresh: 0.196}"
    )
    top, bottom = [100] + 8 * [0] + [100], 9 * [100] + [0]
    expected = [bottom, top]
    np.testing.assert_array_equal(OccupancyMap.load(tmp_path / "m.yaml").cells, expected)


@pytest.mark.parametrize("data", [b"P4\n10 2\n\x80\x40\xff", b"P1\n4 1\n0 1 2 0", b"P1\n4 1\n010"])
def test_a_damaged_bitmap_is_refused(tmp_path, data):
    (tmp_path / "m.pbm").write_bytes(data)
    (tmp_path / "m.yaml").write_text(
        "{image: m.pbm, resolution: 0.1, origin: [0, 0, 0], negate: 0, occupied_thresh: 0.65, free_thresh: 0.196}"
    )
    with pytest.raises(InputError, match="pixels, expected"):
        OccupancyMap.load(tmp_path / "m.yaml")
