"""Fields as pictures, for notebooks: PNG of NumPy alone."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

# Nine colours of the map viridis of Matplotlib (CC0), from the farthest to the nearest.
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
# As much as a notebook shows side by side, px.
_WIDEST = 480


def coloured(field: NDArray[np.float32]) -> NDArray[np.uint8]:
    """High values yellow, low ones purple, from the 1st to the 99th percentile; white where there is none."""
    valid = np.isfinite(field)
    if not valid.any():
        return np.full((*field.shape, 3), 255, np.uint8)
    low, high = np.percentile(field[valid], [1, 99])
    place = np.clip((np.where(valid, field, low) - low) / max(high - low, 1e-12), 0, 1) * (len(_COLOURS) - 1)
    channels = [np.interp(place, np.arange(len(_COLOURS)), _COLOURS[:, c]) for c in range(3)]
    return np.where(valid[..., None], np.stack(channels, -1).round(), 255).astype(np.uint8)


def shown(image: NDArray[np.float32], *, linear: bool) -> NDArray[np.uint8]:
    """Intensities as a screen takes them."""
    image = np.clip(np.nan_to_num(image), 0, 1)
    if linear:
        image = np.where(image <= 0.0031308, 12.92 * image, 1.055 * image ** (1 / 2.4) - 0.055)
    return (255 * image).round().astype(np.uint8)


def png(picture: NDArray[np.uint8]) -> bytes:
    """A PNG of 8 bits, grey or of three channels."""
    height, width = picture.shape[:2]
    rows = np.concatenate([np.zeros((height, 1), np.uint8), picture.reshape(height, -1)], axis=1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2 if picture.ndim == 3 else 0, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def tag(picture: NDArray[np.uint8], words: str) -> str:
    """A picture in HTML, thinned out to what is shown."""
    every = -(-picture.shape[1] // _WIDEST)
    data = base64.b64encode(png(picture[::every, ::every])).decode()
    return f'<img alt="{words}" title="{words}" src="data:image/png;base64,{data}">'
