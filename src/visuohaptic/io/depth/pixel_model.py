"""A user's own network as a further source of evidence: one score for every pixel of a view.

Any function of a view that returns a score for every pixel is a pixel model, larger where it indicates glass or smaller: how a
score relates to glass is learned from the sequence (:mod:`visuohaptic.reconstruction.transparency.ray_evidence`). :class:`OnnxModel` runs a network of segmentation, of depth or of
disparity; :class:`MaskFolder` reads what a network has written. No network is part of the library, and none is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float32

from ...core import InputError, check_choice
from ...core.files import MAX_FILE_BYTES, read_bytes, read_image
from ..image_folder import natural
from .depth_sequence import DepthFrame

#: Score of every pixel of a view (rows, columns); NaN: none.
PixelModel = Callable[[DepthFrame], Float32[np.ndarray, "rows columns"]]
#: Output of a network: scores (one channel, or the last of several), depth in any unit, or disparity up to scale and offset.
NetworkOutput = Literal["mask", "depth", "disparity"]

#: Mean and standard deviation of red, green and blue with which networks are trained (ImageNet).
_MEAN, _SIGMA = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
#: Number of pixels from which scale and offset of a disparity are estimated: all their pairs are compared, and the
#: slope is known to 1.25 / sqrt(500) of the scatter.
_FITTED = 500


@dataclass(slots=True)
class OnnxModel:
    """A network in ONNX format on the color images, run by OpenCV on the processor.

    Its input is one image (1, 3, rows, columns), red, green, blue, normalised; its output one image per channel. A mask is the
    score itself. A depth or disparity is compared with the measured depth: the camera reads the background through glass, beyond
    the surface that the network sees, so that the score is the logarithm of their ratio, up to the scale of the view.

    Parameters
    ----------
    path
        ONNX file.
    output
        Meaning of the output.
    size
        Width and height of the input [px]; those of the view by default.
    mean, sigma
        Mean and standard deviation of red, green, blue in the range 0 to 1 with which the network was trained.

    Raises
    ------
    InputError
        The file is missing, or OpenCV cannot read the network.
    """

    path: Path | str
    output: NetworkOutput = "mask"
    size: tuple[int, int] | None = None
    mean: tuple[float, float, float] = _MEAN
    sigma: tuple[float, float, float] = _SIGMA
    _net: Any = field(init=False)

    def __post_init__(self) -> None:
        import cv2

        check_choice("OnnxModel", ("mask", "depth", "disparity"), self.output, field="output")
        data = np.frombuffer(read_bytes(Path(self.path), MAX_FILE_BYTES), np.uint8)
        try:
            self._net = cv2.dnn.readNetFromONNX(data)
        except cv2.error as error:
            raise InputError(self.path, "expected a network in ONNX format that OpenCV can read") from error

    def __call__(self, frame: DepthFrame) -> Float32[np.ndarray, "rows columns"]:
        """Score of every pixel of a view.

        Parameters
        ----------
        frame
            View with a color image.

        Raises
        ------
        InputError
            The view has no color image, or the network does not accept it or returns no image.
        """
        import cv2

        if frame.color is None:
            raise InputError(
                self.path, f"found no color image of view {frame.index}, expected one for the network"
            )
        height, width = frame.color.shape[:2]
        rgb = (
            cv2.resize(frame.color, self.size or (width, height), interpolation=cv2.INTER_AREA)[:, :, ::-1]
            / 255.0
        )
        blob = ((rgb - self.mean) / self.sigma).astype(np.float32).transpose(2, 0, 1)[None]
        try:
            self._net.setInput(np.ascontiguousarray(blob))
            found = np.asarray(self._net.forward(), np.float32)
        except cv2.error as error:
            remedy = "give the width and height that the network expects (size, --network-size)"
            said = f"the network does not accept an image of {rgb.shape[1]} x {rgb.shape[0]} pixels"
            raise InputError(self.path, said, remedy=remedy) from error
        if found.ndim < 2 or found.size < 4:
            raise InputError(self.path, f"found an output of shape {found.shape}, expected an image")
        image = found.reshape(-1, *found.shape[-2:])[-1]
        scores = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
        return scores if self.output == "mask" else self._nearer(scores, frame.depth_m)

    def _nearer(
        self, seen: Float32[np.ndarray, "h w"], depth_m: Float32[np.ndarray, "h w"]
    ) -> Float32[np.ndarray, "h w"]:
        """Logarithm of the ratio of measured and seen depth; NaN where either is unknown."""
        from scipy.stats import siegelslopes

        known = np.isfinite(depth_m) & np.isfinite(seen) & ((seen > 0) | (self.output == "disparity"))
        scores = np.full(depth_m.shape, np.nan, np.float32)
        if np.count_nonzero(known) < 2:
            return scores
        if self.output == "disparity":
            some = np.flatnonzero(known)[:: max(1, np.count_nonzero(known) // _FITTED)]
            slope, offset = siegelslopes(1 / depth_m.ravel()[some], seen.ravel()[some])
            inverse = slope * seen + offset
            known &= inverse > 0
            scores[known] = np.log(depth_m[known] * inverse[known])
        else:
            ratio = np.log(depth_m[known] / seen[known])
            scores[known] = ratio - np.median(ratio)
        return scores


@dataclass(slots=True)
class MaskFolder:
    """Images that a network has written for the views of a sequence, in natural order of their names, one for each depth image.

    Parameters
    ----------
    folder
        Folder of grey images of any size (PNG, JPEG, TIFF).
    views
        Number of depth images of the sequence, which has to be that of the masks; not checked by default.

    Raises
    ------
    InputError
        The folder is missing, has no images, or another number of them.
    """

    folder: Path | str
    views: int | None = None
    _paths: list[Path] = field(init=False)

    def __post_init__(self) -> None:
        suffixes = {".png", ".jpg", ".jpeg", ".tif", ".tiff"}
        within = Path(self.folder).iterdir() if Path(self.folder).is_dir() else ()
        paths = [path for path in within if path.suffix.lower() in suffixes and not path.name.startswith(".")]
        self._paths = sorted(paths, key=lambda path: natural(path.name))
        if not self._paths:
            raise InputError(
                self.folder, "found no images, expected a folder with one mask for each depth image"
            )
        if self.views not in (None, len(self._paths)):
            # Masks are matched by their order: with others between them, each would be that of another view.
            said = f"found {len(self._paths)} masks, expected {self.views}, one for each depth image"
            raise InputError(self.folder, said)

    def __call__(self, frame: DepthFrame) -> Float32[np.ndarray, "rows columns"]:
        """Values of the mask of a view, by its index in the sequence.

        Parameters
        ----------
        frame
            View of the sequence.

        Raises
        ------
        InputError
            There is no mask with this index, or it cannot be read.
        """
        import cv2

        if frame.index >= len(self._paths):
            said = f"found {len(self._paths)} masks, expected one for each depth image; view {frame.index} has none"
            raise InputError(self.folder, said)
        mask = read_image(self._paths[frame.index], "grey").astype(np.float32)
        return np.asarray(
            cv2.resize(mask, (frame.camera.width, frame.camera.height), interpolation=cv2.INTER_AREA)
        )


def load_pixel_model(
    path: Path | str,
    output: NetworkOutput = "mask",
    size: tuple[int, int] | None = None,
    views: int | None = None,
) -> PixelModel:
    """A network, or a folder of its masks.

    Parameters
    ----------
    path
        ONNX file, or folder of masks.
    output, size
        See :class:`OnnxModel`; not used for masks.
    views
        See :class:`MaskFolder`; not used for networks.

    Raises
    ------
    InputError
        See :class:`OnnxModel` and :class:`MaskFolder`.
    """
    return MaskFolder(path, views) if Path(path).is_dir() else OnnxModel(path, output, size)


def scores_of(model: PixelModel, frame: DepthFrame) -> Float32[np.ndarray, "rows columns"]:
    """Scores of a view, checked.

    Parameters
    ----------
    model
        Pixel model.
    frame
        View.

    Raises
    ------
    InputError
        The model does not return one number for each pixel of the view.
    """
    scores, expected = np.asarray(model(frame)), frame.depth_m.shape
    if scores.shape != expected or scores.dtype.kind not in "buif":
        said = f"found {scores.dtype} of shape {scores.shape} for view {frame.index}, expected numbers {expected}"
        raise InputError("model", said)
    return scores.astype(np.float32)
