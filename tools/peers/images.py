"""Reads, displaces and compares images and fields of V."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import OpenEXR
from scipy import ndimage

from similarity import Similarity

BORDER_PX = 16
"""Border excluded from every rms of V, as in `tools/evaluate`."""


def read_grey(path: Path) -> np.ndarray:
    """Reads the luminance (Rec. 601) in 0 to 1. Values are not linearized, and the orientation tag is ignored."""
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imread(str(path), flags)
    if image is None:
        raise SystemExit(f"{path}: cannot be read as an image; check the path")
    return image.astype(np.float32) / np.iinfo(image.dtype).max


def write_grey(path: Path, image: np.ndarray) -> None:
    """Writes a 16-bit PNG."""
    if not cv2.imwrite(str(path), np.rint(np.clip(image, 0, 1) * 65535).astype(np.uint16)):
        raise SystemExit(f"{path}: cannot be written; check the folder")


def read_field(path: Path) -> np.ndarray:
    """Reads the channel Y of an OpenEXR file."""
    with OpenEXR.File(str(path)) as file:
        return file.channels()["Y"].pixels


def displaced(image: np.ndarray, by: Similarity) -> np.ndarray:
    """Resamples an image to J with J(T x) = image(x), by splines of order 5."""
    size = (image.shape[1], image.shape[0])
    (a, b, tx), (c, d, ty) = np.linalg.inv(np.vstack([by.affine(size), [0, 0, 1]]))[:2]
    rows_first = np.array([[d, c], [b, a]])
    return ndimage.affine_transform(image, rows_first, [ty, tx], order=5, mode="mirror")


def blur_rms(found: np.ndarray, truth: np.ndarray) -> float | None:
    """Returns the rms error of V, px², over the pixels inside the border that are valid in both, else None."""
    inside = np.s_[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
    error = found[inside].astype(float) - truth[inside]
    error = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(error**2))) if error.size else None
