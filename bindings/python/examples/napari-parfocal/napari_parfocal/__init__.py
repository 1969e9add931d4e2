"""Example of a napari plugin: a reader for photographs, a widget for pairs and a widget for focus sweeps.

napari generates the widgets from the arguments of the functions. The module does not import napari, so tests can run
without it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import parfocal

if TYPE_CHECKING:
    import napari.layers
    import napari.types

Layers = list[tuple[Any, dict[str, Any], str]]


def reader(path: str | list[str]) -> Callable[[Any], Layers]:
    """Returns a function that reads photographs into one layer.

    Several photographs of equal size and type become a sweep, sorted by name.
    """

    def read(path: str | list[str]) -> Layers:
        files = sorted([path] if isinstance(path, str) else path)
        frames = [parfocal.read(file) for file in files]
        if len({(frame.shape, frame.dtype) for frame in frames}) > 1:
            raise ValueError(f"{files[0]} and the others differ in size or type and are not a sweep: open them one by one")
        colour = frames[0].ndim == 3
        data = frames[0] if len(frames) == 1 else np.stack(frames)
        return [(data, {"name": Path(files[0]).stem, "rgb": colour}, "image")]

    return read


def pair(
    near: "napari.layers.Image", far: "napari.layers.Image", max_relative_blur: float = 144.0
) -> "list[napari.types.LayerDataTuple]":
    """Solves two layers. Returns V and the fused image on the pixels of the first layer."""
    found = parfocal.solve(near.data, far.data, max_relative_blur=max_relative_blur)
    fields = {"relative blur, px²": found.relative_blur, "deviation, px²": found.uncertainty}
    return _layers(found, fields)


def sweep(
    frames: "napari.layers.Image", first: float = 0.0, step: float = 1.0, in_mm: bool = False
) -> "list[napari.types.LayerDataTuple]":
    """Solves a layer of three or more frames. Returns the focus and the fused image.

    Frame n is focused at `first + n * step`, which is a stage position if `in_mm` is set.
    """
    positions = first + step * np.arange(len(frames.data))
    found = parfocal.stack(frames.data, positions=positions, unit="stage" if in_mm else "settings")
    return _layers(found, {"depth, mm": found.depth} if in_mm else {"focus": found.focus})


def _layers(found: parfocal.Result | parfocal.Sweep, fields: dict[str, Any]) -> Layers:
    """Returns the layers: the fused image at the bottom, the fields above it. Each has the warnings in its metadata."""
    place = {"translate": found.region[1::-1], "metadata": {"warnings": found.warnings}}
    # The fused image is linear light. An exponent of 1/2.2 approximates sRGB for display.
    seen = np.clip(found.fused, 0, 1) ** (1 / 2.2 if found.decode == "srgb" else 1)
    layers: Layers = [(seen, {"name": "fused", "rgb": seen.ndim == 3} | place, "image")]
    for name, field in fields.items():
        limits = np.nanpercentile(field, [1, 99]).tolist() if np.isfinite(field).any() else [0, 1]
        shown = {"name": name, "colormap": "viridis", "contrast_limits": limits, "opacity": 0.7}
        layers.append((field, shown | place, "image"))
    return layers
