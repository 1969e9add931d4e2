"""Depth from defocus on the GPU.

`solve` takes two photographs of a scene, focused at two distances, as NumPy arrays. It returns the relative blur at each
pixel and the registration of the two. With a lens, relative blur becomes depth:

    result = parfocal.solve(near, far, max_relative_blur=36)
    result.relative_blur, result.transform, result.warnings

Arrays have the shape (height, width) or (height, width, 3) and the type uint8, uint16 or floats. White is 255,
65535 or 1. Paths of photographs are accepted as well. `help(parfocal.Settings)` lists the settings with their defaults and ranges.
"""

from __future__ import annotations

from ._native import CancellationToken, Cancelled, DeviceError, Engine, __version__, devices
from ._results import Brightness, Depth, Lens, Level, Registration, Result, Sweep
from ._solves import Settings, apply, read, register, solve, stack, unpack
from ._stream import Stream
from . import inspection, measure

__all__ = [
    "Brightness",
    "CancellationToken",
    "Cancelled",
    "Depth",
    "DeviceError",
    "Engine",
    "Lens",
    "Level",
    "Registration",
    "Result",
    "Settings",
    "Stream",
    "Sweep",
    "__version__",
    "apply",
    "devices",
    "inspection",
    "measure",
    "read",
    "register",
    "solve",
    "stack",
    "unpack",
]
