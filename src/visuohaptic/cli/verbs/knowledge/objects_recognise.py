"""``visuohaptic objects recognise``: rank what a seen object may be.

reads   a database of objects (their meshes, images of faces and last positions), or a prior that was saved
        from one; an image, or the points of one object seen from one side (.npy, or .ply in metres)
writes  the candidates to stdout; with --save the prior as .npz, which loads faster than the database

example: visuohaptic objects recognise --cloud seen.ply --context kitchen
"""

from __future__ import annotations

from typing import Any

from .... import recognition
from ....core import files
from ....core.errors import InputError
from ....core.files.plain_json import picked
from ....io import meshes
from ._objects import add_database, opened


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--image", str, "image of the object and its surroundings", metavar="FILE")
    add("--cloud", str, "points of the segmented object: .npy (n, 3) or .ply, in m", metavar="FILE")
    add("--context", "", "words that describe the place, such as kitchen,sink", metavar="WORDS")
    add("--prior", str, "prior that --save has written; the database is not read", metavar="FILE")
    add("--save", str, "NPZ file for the prior of the database", metavar="FILE")
    add("--min-probability", 0.01, "minimum probability of a listed object (0.01)")
    add_database(add)


def needs(args: Any) -> set[str]:
    """Optional modules: those of the database, unless ``--prior`` replaces it, and of point clouds.

    Parameters
    ----------
    args
        As parsed.
    """
    return ({"small_gicp"} if args.cloud else set()) | (set() if args.prior else {"pyarrow", "sqlalchemy"})


def run(args: Any) -> dict[str, Any]:
    """Recognise; returns the mapping that ``--json`` prints."""
    if not (args.image or args.cloud or args.save):
        raise InputError("objects recognise", "found no input", remedy="give --image or --cloud")
    if args.prior:
        prior = recognition.load_prior(args.prior)
    else:
        with opened(args) as database:
            prior = recognition.VisualPrior.of_objects(database.get(one.id) for one in database.summaries())
    if args.save:
        recognition.save_prior(args.save, prior)
        args.report(f"wrote the prior of {len(prior)} objects to {args.save}")
    if not (args.image or args.cloud):
        return {"objects": len(prior), "candidates": []}
    found = prior.candidates(
        None if args.image is None else files.read_image(args.image, "grey", upright=True),
        None if args.cloud is None else _cloud(args.cloud),
        [word for word in args.context.split(",") if word],
        min_probability=args.min_probability,
    )
    for one in found:
        args.report(f"{one.probability:8.3f}  {one.object_id}")
    return {
        "objects": len(prior),
        "candidates": [
            {"id": one.object_id, **picked(one, "probability models matches residual_m")} for one in found
        ],
        "models": recognition.model_probabilities(found),
    }


def _cloud(path: str) -> Any:
    if path.endswith(".ply"):
        return meshes.read_ply(path).vertices_m
    return files.read_npy(path, "a .npy file of points")
