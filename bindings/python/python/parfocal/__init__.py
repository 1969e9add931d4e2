"""Depth from defocus on the GPU.

Two photographs of a scene, focused at two distances, as NumPy arrays in; relative blur at every pixel, which a lens makes
depth, and the registration of the two out:

    result = parfocal.solve(near, far, max_relative_blur=36)
    result.relative_blur, result.transform, result.warnings

Arrays are (height, width) or (height, width, 3), of uint8, uint16 or float32, whose white is 255, 65535 or 1. Settings are
those of docs/method.md, section 8, by their names there, with the program's defaults.
"""

from __future__ import annotations

from ._native import CancellationToken, Cancelled, DeviceError, Engine, __version__, devices
from ._results import Brightness, Depth, Lens, Level, Registration, Result, Sweep
from ._solves import apply, read, register, solve, stack, unpack
from ._stream import Stream
from . import measure

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
    "Stream",
    "Sweep",
    "__version__",
    "apply",
    "devices",
    "measure",
    "read",
    "register",
    "solve",
    "stack",
    "unpack",
]
