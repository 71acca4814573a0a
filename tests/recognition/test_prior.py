"""Probabilities of candidates obey Bayes' rule and are calibrated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("small_gicp")
pytest.importorskip("trimesh")

from benchmarks._prior_calibration import Example, calibrate_prior
from benchmarks._prior_world import containers, label, scene_with, seen_cloud

from benchmarks import prior as bench
from visuohaptic.core import Appearance, Geometry, InputError, Sighting, VisuoHapticObject
from visuohaptic.recognition.touch import UNKNOWN
from visuohaptic.recognition.visual import (
    VisualPrior,
    load_prior,
    model_probabilities,
    save_prior,
)


@pytest.fixture(scope="module")
def kitchen() -> VisualPrior:
    """Three shapes and twelve labels."""
    rng = np.random.default_rng(0)
    prior = VisualPrior()
    for name, mesh in containers(1, classes=("bottle", "cup", "palmo")).items():
        kind = name.split("/")[0]
        prior.add(kind, cloud=mesh.sampled(3000, rng)[0], models=(f"{kind}-paper", f"{kind}-china"))
    for number in range(12):
        prior.add(f"label-{number}", images=[label(number)])
    return prior


def _share(prior: VisualPrior, *args: object, **kwargs: object) -> dict[str, float]:
    found = prior.candidates(*args, min_probability=0.0, **kwargs)
    assert sum(one.probability for one in found) == pytest.approx(1.0)
    assert [one.probability for one in found] == sorted((one.probability for one in found), reverse=True)
    return {one.object_id: one.probability for one in found}


def test_nothing_seen_is_the_prior(kitchen: VisualPrior) -> None:
    fraction = _share(kitchen)
    assert fraction.pop(UNKNOWN) == pytest.approx(kitchen.settings.unknown_prior)
    assert np.ptp(list(fraction.values())) < 1e-12
    assert _share(VisualPrior()) == {UNKNOWN: pytest.approx(1.0)}
    assert _share(VisualPrior(), image=label(1), cloud=np.random.default_rng(0).random((50, 3))) == {
        UNKNOWN: pytest.approx(1.0)
    }


def test_pictures_and_clouds(kitchen: VisualPrior) -> None:
    rng = np.random.default_rng(1)
    best = kitchen.candidates(image=scene_with(label(7), rng, hardness=0.5))[0]
    assert best.object_id == "label-7"
    assert best.matches > 10
    assert best.probability > 0.9
    mesh = containers(1, classes=("cup",))["cup/0"]
    best = kitchen.candidates(cloud=seen_cloud(mesh, rng))[0]
    assert best.object_id == "cup"
    assert best.residual_m < 0.002
    assert best.T_cloud_object is not None
    models = model_probabilities([best])
    assert models["cup-paper"] == models["cup-china"] == pytest.approx(best.probability / 2)


def test_something_else_is_unknown(kitchen: VisualPrior) -> None:
    rng = np.random.default_rng(2)
    assert kitchen.candidates(image=scene_with(label(99), rng, hardness=0.3))[0].object_id != "label-7"
    sofa = rng.uniform(-1, 1, (3000, 3)) * [1.0, 0.4, 0.3]
    # Only what has a shape can be refused by a cloud; the labels have none and keep their odds.
    fraction = _share(kitchen, cloud=sofa)
    assert fraction[UNKNOWN] > 50 * max(fraction["cup"], fraction["bottle"], fraction["palmo"])
    blank = _share(kitchen, image=np.full((300, 300), 128, np.uint8))
    assert blank == pytest.approx(_share(kitchen))


def test_context_multiplies_the_odds() -> None:
    prior = VisualPrior()
    for _ in range(8):
        prior.add("cup", context=("kitchen",))
        prior.add("drill", context=("garage",))
    prior.add("new", context=())
    plain = _share(prior)
    assert plain["cup"] == pytest.approx(plain["drill"])
    fraction = _share(prior, context=("kitchen",))
    # By hand: 16 sightings, half of them in the kitchen; two average ones are added to each object's own.
    assert fraction["cup"] / fraction["drill"] == pytest.approx((8 + 1) / (0 + 1))
    assert fraction["new"] / fraction[UNKNOWN] == pytest.approx(plain["new"] / plain[UNKNOWN])
    assert _share(prior, context=("nowhere",)) == pytest.approx(plain)


def test_alike_stay_together(kitchen: VisualPrior) -> None:
    """Paper or china, one shape: sight gives both the same probability, and touch has to decide."""
    rng = np.random.default_rng(3)
    mesh = containers(1, classes=("cup",))["cup/0"]
    prior = VisualPrior()
    cloud = mesh.sampled(3000, rng)[0]
    prior.add("paper cup", cloud=cloud)
    prior.add("china cup", cloud=cloud)
    fraction = _share(prior, cloud=seen_cloud(mesh, rng))
    assert fraction["paper cup"] == pytest.approx(fraction["china cup"])
    assert fraction["paper cup"] > 0.4


def test_file(kitchen: VisualPrior, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    kitchen.add("label-1", context=("shelf", "kitchen"))
    save_prior(tmp_path / "prior.npz", kitchen)
    again = load_prior(tmp_path / "prior.npz")
    scene = scene_with(label(1), rng, hardness=0.5)
    assert _share(again, image=scene, context=("shelf",)) == pytest.approx(
        _share(kitchen, image=scene, context=("shelf",))
    )
    data = (tmp_path / "prior.npz").read_bytes()
    random = np.random.default_rng(5)
    for number in range(60):
        broken = bytearray(data)
        for place in random.integers(0, len(data), 3):
            broken[place] ^= int(random.integers(1, 256))
        (tmp_path / "b.npz").write_bytes(broken[: int(random.integers(len(data)))] if number % 2 else broken)
        try:
            load_prior(tmp_path / "b.npz")  # bytes that no one reads may change
        except InputError as error:
            assert "not a visual prior" in str(error)  # noqa: PT017
    with pytest.raises(InputError, match="No such file"):
        load_prior(tmp_path / "none.npz")
    with pytest.raises(InputError, match=r"expected \.npz"):
        save_prior(tmp_path / "prior.txt", kitchen)


def test_from_a_database_object() -> None:
    import cv2

    mesh = containers(1, classes=("bottle",))["bottle/0"]
    png = cv2.imencode(".png", label(5))[1].tobytes()
    full = VisuoHapticObject(
        "bottle",
        geometry=Geometry(mesh.vertices_m, mesh.faces),
        appearance=Appearance(template_png=png),
        seen=Sighting((0.0, 0.0, 0.0), 0.1, 1.0, context=("fridge",)),
    )
    prior = VisualPrior.of_objects([full, VisuoHapticObject("told of")])
    entry = prior.entries["bottle"]
    assert entry.shape is not None
    assert len(entry.images) == 1
    assert entry.context == {"fridge": 1}
    broken = replace(full, appearance=Appearance(template_png=png[:20]))
    with pytest.raises(InputError, match="is a damaged image"):
        VisualPrior.of_objects([broken])
    with pytest.raises(InputError, match="found 'unknown'"):
        prior.add(UNKNOWN)


def test_calibration_lowers_the_loss() -> None:
    rng = np.random.default_rng(6)
    prior = VisualPrior()
    for number in range(12):
        prior.add(str(number), images=[label(number)])

    def look() -> Example:
        number = int(rng.integers(16))
        scene = scene_with(label(number), rng, hardness=1.5)
        return Example(str(number) if number < 12 else UNKNOWN, image=scene)

    def loss(examples: list[Example]) -> float:
        return float(np.mean([-np.log(max(_share(prior, one.image)[one.truth], 1e-9)) for one in examples]))

    seen, new = [look() for _ in range(16)], [look() for _ in range(16)]
    before = loss(seen), loss(new)
    prior.settings = calibrate_prior(prior, seen)
    assert loss(seen) <= before[0] + 1e-3
    # On looks that were not fitted to it must at least not get much worse: 16 looks, losses of about 0.5 each.
    assert loss(new) < before[1] + 0.4
    with pytest.raises(InputError, match="not stored"):
        calibrate_prior(prior, [Example("unknown object", image=label(1))] * 10)
    with pytest.raises(InputError, match="10 or more"):
        calibrate_prior(prior, seen[:5])


@pytest.mark.data
def test_real_photographs(data: Path) -> None:
    """A wall and a shelf among other photographs, recognised from where they were not seen before."""
    import cv2

    graf, shelf = data / "sensing" / "oxford_graf", data / "geometry" / "dev" / "apc_f200_shelf"

    def read(path: Path) -> np.ndarray:
        return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)

    prior = VisualPrior()
    prior.add("wall", images=[read(graf / "img1.png")])
    prior.add("shelf", images=[read(shelf / "frame-000000.color.png")])
    for photo in sorted((data / "sensing" / "apriltag").glob("*.jpg")):
        prior.add(photo.stem, images=[read(photo)])
    for number in range(20):
        prior.add(f"label-{number}", images=[label(number)])
    assert prior.candidates(image=read(graf / "img2.png"))[0].object_id == "wall"
    assert prior.candidates(image=read(graf / "img3.png"))[0].object_id == "wall"
    assert prior.candidates(image=read(shelf / "frame-000001.color.png"))[0].object_id == "shelf"


def test_benchmark_of_pictures_in_small() -> None:
    rows = {row["name"]: row["ours"] for row in bench.pictures(count=12, looks=24)}
    assert rows["picture: top 1"] > 0.75
    assert rows["picture: unknown and called so"] > 0.4


def test_no_match_is_another_thing_than_few() -> None:
    """A look that is too blurred for any match is judged by its own weight, not by the curve of the counts."""
    from visuohaptic.recognition.visual import PriorSettings, VisualEvidence, posterior

    def unknown(matches: list[float], settings: PriorSettings) -> float:
        nothing = np.full(len(matches), np.nan)
        look = VisualEvidence(np.log(np.full(len(matches), 0.1)), np.log1p(matches), 1.0, nothing, {})
        return float(posterior(look, settings)[-1])

    settings = PriorSettings(no_match_penalty=1.0)
    none, few, many = (unknown([best] + [0.0] * 9, settings) for best in (0.0, 6.0, 40.0))
    # 0.9 known by e^-1 against 0.1.
    assert none == pytest.approx(0.1 / (0.1 + 0.9 * np.exp(-1)))
    assert many < 1e-3 < few < none
