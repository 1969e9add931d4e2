"""Parfocal in napari: a reader of photographs, and a widget each for pairs and focus sweeps, as a start for a plugin of your own.

napari makes the widgets of the functions' arguments. Nothing of napari is imported: what is computed can be tested without it.
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
    """Photographs as one layer: one, or several of one size and kind as a sweep in the order of their names."""

    def read(path: str | list[str]) -> Layers:
        files = sorted([path] if isinstance(path, str) else path)
        frames = [parfocal.read(file) for file in files]
        if len({(frame.shape, frame.dtype) for frame in frames}) > 1:
            raise ValueError(f"{files[0]} and the others differ in size or kind, and make no sweep: open them one by one")
        colour = frames[0].ndim == 3
        data = frames[0] if len(frames) == 1 else np.stack(frames)
        return [(data, {"name": Path(files[0]).stem, "rgb": colour}, "image")]

    return read


def pair(
    near: "napari.layers.Image", far: "napari.layers.Image", max_relative_blur: float = 144.0
) -> "list[napari.types.LayerDataTuple]":
    """V and the fused image of two layers, on the pixels of the first."""
    found = parfocal.solve(near.data, far.data, max_relative_blur=max_relative_blur)
    fields = {"relative blur, px²": found.relative_blur, "deviation, px²": found.uncertainty}
    return _layers(found, fields)


def sweep(
    frames: "napari.layers.Image", first: float = 0.0, step: float = 1.0, in_mm: bool = False
) -> "list[napari.types.LayerDataTuple]":
    """Focus and the fused image of a layer of three or more frames; `first` and `step` are where they are focused, of a stage where
    they are in mm."""
    positions = first + step * np.arange(len(frames.data))
    found = parfocal.stack(frames.data, positions=positions, unit="stage" if in_mm else "settings")
    return _layers(found, {"depth, mm": found.depth} if in_mm else {"focus": found.focus})


def _layers(found: parfocal.Result | parfocal.Sweep, fields: dict[str, Any]) -> Layers:
    """The fused image below, fields above it; what speaks against them goes with each."""
    place = {"translate": found.region[1::-1], "metadata": {"warnings": found.warnings}}
    # Linear light; screens want sRGB, of which a power of 2.2 is near enough to look at.
    seen = np.clip(found.fused, 0, 1) ** (1 / 2.2 if found.decode == "srgb" else 1)
    layers: Layers = [(seen, {"name": "fused", "rgb": seen.ndim == 3} | place, "image")]
    for name, field in fields.items():
        limits = np.nanpercentile(field, [1, 99]).tolist() if np.isfinite(field).any() else [0, 1]
        shown = {"name": name, "colormap": "viridis", "contrast_limits": limits, "opacity": 0.7}
        layers.append((field, shown | place, "image"))
    return layers
