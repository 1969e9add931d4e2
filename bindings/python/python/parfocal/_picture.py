"""Draws fields as PNG pictures for notebooks, with NumPy alone."""

from __future__ import annotations

import base64
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Nine colours of Matplotlib's colormap viridis (CC0), far to near.
_COLOURS = np.array(
    [
        (68, 1, 84),
        (71, 44, 122),
        (59, 81, 139),
        (44, 113, 142),
        (33, 144, 141),
        (39, 173, 129),
        (92, 200, 99),
        (170, 220, 50),
        (253, 231, 37),
    ],
    float,
)
# Width of a picture, px: two fit side by side in a notebook.
_MAX_WIDTH = 480


def colormapped(field: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Maps the 1st to 99th percentile to purple to yellow; NaN becomes white."""
    valid = np.isfinite(field)
    if not valid.any():
        return np.full((*field.shape, 3), 255, np.uint8)
    low, high = np.percentile(field[valid], [1, 99])
    position = np.clip((np.where(valid, field, low) - low) / max(high - low, 1e-12), 0, 1) * (len(_COLOURS) - 1)
    channels = [np.interp(position, np.arange(len(_COLOURS)), _COLOURS[:, c]) for c in range(3)]
    return np.where(valid[..., None], np.stack(channels, -1).round(), 255).astype(np.uint8)


def encoded(image: NDArray[np.float32], dtype: np.dtype[Any], *, srgb: bool) -> NDArray[Any]:
    """Converts intensities to samples of a type, with the sRGB curve or without.

    Integers are limited to black and white.
    """
    if srgb:
        over = np.maximum(image, 0.0031308)
        image = np.where(image <= 0.0031308, 12.92 * image, 1.055 * over ** (1 / 2.4) - 0.055)
    if dtype.kind == "f":
        return image.astype(dtype)
    white = np.iinfo(dtype).max
    return (white * np.clip(np.nan_to_num(image), 0, 1).astype(float)).round().astype(dtype)


def for_display(image: NDArray[np.float32], *, linear: bool) -> NDArray[np.uint8]:
    """Converts intensities to 8 bits; linear ones get the sRGB curve."""
    return encoded(image, np.dtype(np.uint8), srgb=linear)


def png(picture: NDArray[np.uint8]) -> bytes:
    """Encodes an 8-bit PNG with one or three channels."""
    height, width = picture.shape[:2]
    rows = np.concatenate([np.zeros((height, 1), np.uint8), picture.reshape(height, -1)], axis=1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2 if picture.ndim == 3 else 0, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def tag(picture: NDArray[np.uint8], caption: str) -> str:
    """Returns an HTML image, subsampled to the displayed width."""
    stride = -(-picture.shape[1] // _MAX_WIDTH)
    data = base64.b64encode(png(picture[::stride, ::stride])).decode()
    return f'<img alt="{caption}" title="{caption}" src="data:image/png;base64,{data}">'
