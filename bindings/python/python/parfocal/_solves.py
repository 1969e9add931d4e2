"""Solves: arrays to what is found."""

from __future__ import annotations

import difflib
import threading
from collections.abc import Callable, Iterable, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._results import Brightness, Level, Registration, Result, Sweep

if TYPE_CHECKING:
    from typing_extensions import Unpack


class Settings(TypedDict, total=False):
    """What a solve can be told; docs/method.md, section 8, says what each does and what it may be."""

    method: str  # "unified", "aligned" or "appearance"
    levels: int | str | None
    outer_iterations: int
    relaxation_sweeps: int
    over_relaxation: float
    regularization: float | str | None
    continuation: float
    data_eta: float
    smoothness_eta: float
    heaviside_epsilon: float
    max_relative_blur: float
    largest_step: float
    kernel: str | ArrayLike  # "auto", "gaussian", "pillbox", "half-gaussian", or its values on a grid
    motion: str  # "translation", "similarity", "affine" or "homography"
    registration_step: str  # "gauss-newton" or "gradient-descent"
    photometric: bool
    fused: bool  # whether the fused image of a pair is made
    decode: str  # "auto": uint8 is taken for sRGB, all else for linear; "none"; "srgb"
    black_level: float | None
    white_level: float | None
    start: ArrayLike  # 3x3
    start_photometric: tuple[float, float]  # gain, offset


_NAMES = frozenset(_native.setting_names())
_default: _native.Engine | None = None
_opening = threading.Lock()


def _engine(given: _native.Engine | None) -> _native.Engine:
    """The engine that is given, or the one that all calls without one share."""
    global _default
    if given is not None:
        return given
    with _opening:
        if _default is None:
            _default = _native.Engine()
        return _default


def _run(given: _native.Engine | None, call: str, *arguments: Any) -> dict[str, Any]:
    global _default
    engine = _engine(given)
    try:
        found: dict[str, Any] = getattr(engine, call)(*arguments)
        return found
    except _native.DeviceError:
        # After a timeout or a lost device an engine is done for: the next call opens another.
        with _opening:
            if _default is engine:
                _default = None
        raise


def check_settings(settings: Settings) -> None:
    """Raises as `solve` where there is no setting of a name."""
    _named(settings)


def _named(settings: Settings) -> dict[str, Any]:
    named: dict[str, Any] = dict(settings)
    for name in named.keys() - _NAMES:
        near = difflib.get_close_matches(name, _NAMES, 1)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(sorted(_NAMES))}"
        raise TypeError(f"there is no setting {name!r}; {hint}")
    if "start" in named:
        named["start"] = np.asarray(named["start"], float)
    if not isinstance(named.get("kernel", ""), str):
        named["kernel"] = np.asarray(named["kernel"], float)
    return named


def _image(of: ArrayLike) -> NDArray[Any]:
    array = np.asarray(of)
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def _mask(of: ArrayLike | None) -> NDArray[np.uint8] | None:
    return None if of is None else np.where(np.asarray(of), 255, 0).astype(np.uint8)


def _found(found: dict[str, Any]) -> dict[str, Any]:
    found["levels"] = [Level(*level) for level in found["levels"]]
    found["brightness"] = _brightness(found)
    return _tuples(found)


def _brightness(found: dict[str, Any]) -> Brightness:
    gain, offset, shading, region = (found.pop(name) for name in ("gain", "offset", "shading", "shading_region"))
    return Brightness(gain, offset, shading, tuple(region))


def _tuples(found: dict[str, Any]) -> dict[str, Any]:
    return found | {name: tuple(found[name]) for name in ("region", "photograph")}


def read(path: str | PathLike[str]) -> NDArray[Any]:
    """A photograph in a file, as the program reads it: PNG, JPEG, TIFF, PNM, PFM, EXR, BMP, WebP, in their own depth, (height, width) or
    (height, width, 3); page N of a TIFF as "FILE#N", what has no header as "FILE#Mono12p:2448x2048".

    Raises ValueError, with the file and what to do, for what cannot be read.
    """
    return _native.read(path)


def unpack(data: bytes | bytearray | memoryview, format: str, size: tuple[int, int]) -> NDArray[Any]:
    """A frame as cameras hand it over, rows without gaps, by GenICam's name of its format, and its width and height.

    Grey, (height, width): Mono8, Mono10, Mono12, Mono14, Mono16, Mono10p, Mono12p, Mono10Packed, Mono12Packed, Mono32f. Red, green and blue,
    (height, width, 3): RGB8, BGR8, RGBa8, BGRa8, RGB16, RGB32f; and of Bayer patterns BayerRG8, likewise GR, GB, BG, and 10, 12, 16, 10p, 12p,
    10Packed, 12Packed. More than 8 bits become uint16, their greatest 65535; floats stay float32.

    Raises ValueError for another format, or bytes that are not as many as they should be.
    """
    return _native.unpack(bytes(data), f"{format}:{size[0]}x{size[1]}")


def solve(
    i1: ArrayLike,
    i2: ArrayLike,
    *,
    engine: _native.Engine | None = None,
    region: Sequence[int] | None = None,
    mask: ArrayLike | None = None,
    crop_valid: bool = False,
    progress: Callable[[float], object] | None = None,
    cancel: _native.CancellationToken | None = None,
    **settings: Unpack[Settings],
) -> Result:
    """Relative blur and registration of two photographs of one size; results are on the pixels of the first.

    region: x, y, width, height of the part of I1 that results are wanted of. mask: of I1's size, not 0 where a pixel counts.
    crop_valid: crops results to the largest rectangle in which V is valid everywhere. engine: without it, all calls share one,
    on the most capable device. progress: is called after each level with the share that is done, 0 to 1; what it raises ends the solve. cancel:
    calls it off from another thread, and the solve raises Cancelled; Ctrl-C does from the keyboard. Both of these, and what progress raises, leave `cancel` cancelled.

    The interpreter goes on in other threads meanwhile. A pair that can be read but not solved is no exception: see `converged` and
    `warnings`. Raises TypeError or ValueError for what is no photograph, no setting or out of range, DeviceError for the rest.
    """
    images, named = (_image(i1), _image(i2)), _named(settings)
    return Result(**_found(_run(engine, "solve", *images, named, region, _mask(mask), crop_valid, progress, cancel)))


def register(
    i1: ArrayLike,
    i2: ArrayLike,
    *,
    engine: _native.Engine | None = None,
    progress: Callable[[float], object] | None = None,
    cancel: _native.CancellationToken | None = None,
    **settings: Unpack[Settings],
) -> Registration:
    """How the second photograph lies on the first, and how they differ in brightness. progress, cancel, and what is raised: as `solve`."""
    return Registration(**_found(_run(engine, "register", _image(i1), _image(i2), _named(settings), progress, cancel)))


def stack(
    frames: Iterable[ArrayLike],
    *,
    engine: _native.Engine | None = None,
    positions: Sequence[float] | None = None,
    unit: str = "settings",
    reference: int | None = None,
    region: Sequence[int] | None = None,
    mask: ArrayLike | None = None,
    progress: Callable[[float], object] | None = None,
    cancel: _native.CancellationToken | None = None,
    **settings: Unpack[Settings],
) -> Sweep:
    """Where each pixel of a focus sweep is in focus: three or more frames of one size and kind, in the order of their focus.

    positions: what each frame is focused at, ascending or descending; counted from 0 without. unit: what these are: "settings"
    even in 1/distance, "distances" from the lens in mm, or "stage", where the plane in focus lies, mm. reference: the frame
    on whose pixels results are, from 0; the middle one without. progress, cancel, and what is raised: as `solve`.
    """
    images, named = [_image(frame) for frame in frames], _named(settings)
    stated = None if positions is None else [float(position) for position in positions]
    found = _run(engine, "stack", images, named, stated, unit, reference, region, _mask(mask), progress, cancel)
    found["brightness"] = [_brightness(one) for one in found["brightness"]]
    return Sweep(**_tuples(found))


def apply(
    image: ArrayLike, found: Result | Registration | Sweep, *, frame: int | None = None, exposure: bool = False
) -> NDArray[Any]:
    """Another photograph of I2's camera, or of a frame of a sweep, on the pixels of the results, in its own kind of samples.

    Black where it does not reach. exposure: also as bright as I1.
    """
    array = _image(image)
    if (array.shape[1::-1] if array.ndim > 1 else ()) != found.photograph:
        width, height = found.photograph
        raise ValueError(f"the image's shape is {array.shape}, and photographs of ({height}, {width}) were registered")
    if isinstance(found, Sweep):
        if frame is None:
            raise TypeError("say of which frame of the sweep, frame=N, counted from 0")
        transform, brightness = found.transforms[frame], found.brightness[frame]
    else:
        transform, brightness = found.transform, found.brightness
    bright = (brightness.gain, brightness.offset, brightness.shading.tolist(), brightness.region)
    return _native.apply(array, transform, bright if exposure else None, found.decode, found.region)
