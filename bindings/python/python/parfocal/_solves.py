"""The functions that solve, register and read photographs."""

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
    """The settings of a solve. docs/method.md, section 8, describes each with its range."""

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
    kernel: str | ArrayLike  # "auto", "gaussian", "pillbox", "half-gaussian", or the kernel's samples
    motion: str  # "translation", "similarity", "affine" or "homography"
    registration_step: str  # "gauss-newton" or "gradient-descent"
    photometric: bool
    edges: bool  # depth edges of a pair as sharp as the scene's
    fused: bool  # also compute the fused image of a pair
    keep_frames: bool  # keep the frames of a sweep that do not show the scene of the others
    decode: str  # "auto": uint8 is read as sRGB, other types as linear; "none"; "srgb"
    black_level: float | None
    white_level: float | None
    start: ArrayLike  # 3x3
    start_photometric: tuple[float, float]  # gain, offset


_NAMES = frozenset(_native.setting_names())
_default: _native.Engine | None = None
_default_lock = threading.Lock()


def _engine_or_default(given: _native.Engine | None) -> _native.Engine:
    """Returns the given engine, or the one that all calls without an engine share."""
    global _default
    if given is not None:
        return given
    with _default_lock:
        if _default is None:
            _default = _native.Engine()
        return _default


def _run(given: _native.Engine | None, call: str, *arguments: Any) -> dict[str, Any]:
    global _default
    engine = _engine_or_default(given)
    try:
        result: dict[str, Any] = getattr(engine, call)(*arguments)
        return result
    except _native.DeviceError:
        # An engine is unusable after a timeout or a lost device: the next call opens another.
        with _default_lock:
            if _default is engine:
                _default = None
        raise


def check_settings(settings: Settings) -> None:
    """Raises TypeError for an unknown setting."""
    _checked(settings)


def _checked(settings: Settings) -> dict[str, Any]:
    checked: dict[str, Any] = dict(settings)
    for name in checked.keys() - _NAMES:
        near = difflib.get_close_matches(name, _NAMES, 1)
        hint = f"did you mean {near[0]}?" if near else f"the settings are {', '.join(sorted(_NAMES))}"
        raise TypeError(f"there is no setting {name!r}; {hint}")
    if "start" in checked:
        checked["start"] = np.asarray(checked["start"], float)
    if not isinstance(checked.get("kernel", ""), str):
        checked["kernel"] = np.asarray(checked["kernel"], float)
    return checked


def _image(values: ArrayLike) -> NDArray[Any]:
    array = np.asarray(values)
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def _mask(values: ArrayLike | None) -> NDArray[np.uint8] | None:
    return None if values is None else np.where(np.asarray(values), 255, 0).astype(np.uint8)


def _result_fields(result: dict[str, Any]) -> dict[str, Any]:
    result["levels"] = [Level(*level) for level in result["levels"]]
    result["brightness"] = _brightness(result)
    return _with_tuples(result)


def _brightness(result: dict[str, Any]) -> Brightness:
    gain, offset, shading, region = (result.pop(name) for name in ("gain", "offset", "shading", "shading_region"))
    return Brightness(gain, offset, shading, tuple(region))


def _with_tuples(result: dict[str, Any]) -> dict[str, Any]:
    return result | {name: tuple(result[name]) for name in ("region", "photograph")}


def read(path: str | PathLike[str]) -> NDArray[Any]:
    """Reads a photograph as the program does, with its own bit depth, as (height, width) or (height, width, 3).

    Formats: PNG, JPEG, TIFF, PNM, PFM, EXR, BMP, WebP. "FILE#N" is page N of a TIFF. "FILE#Mono12p:2448x2048" is a frame
    without a header.

    Raises ValueError, with the file and what to do, if the file cannot be read.
    """
    return _native.read(path)


def unpack(data: bytes | bytearray | memoryview, format: str, size: tuple[int, int]) -> NDArray[Any]:
    """Unpacks a camera frame whose rows have no gaps. `format` is the GenICam name of its pixel format, `size` (width, height).

    Grey formats give (height, width): Mono8, Mono10, Mono12, Mono14, Mono16, Mono10p, Mono12p, Mono10Packed, Mono12Packed,
    Mono32f. Colour formats give (height, width, 3): RGB8, BGR8, RGBa8, BGRa8, RGB16, RGB32f, and the Bayer patterns RG, GR,
    GB and BG, as in BayerRG8, with 8, 10, 12, 16, 10p, 12p, 10Packed or 12Packed. More than 8 bits become uint16 with white
    at 65535; floats stay float32.

    Raises ValueError for an unknown format or a wrong number of bytes.
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
    """Computes relative blur and registration of two photographs of the same size. Results have the pixels of `i1`.

    engine: the device; by default all calls share one engine on the most capable device.
    region: (x, y, width, height), the part of I1 to solve.
    mask: array of I1's size; a pixel counts where it is not 0.
    crop_valid: crops the results to the largest rectangle in which V is valid everywhere.
    progress: called after every few iterations with the share done, 0 to 1. An exception that it raises ends the solve.
    cancel: a token that cancels the solve from another thread; the solve then raises Cancelled.

    Ctrl-C also ends the solve. Ctrl-C and an exception from `progress` leave `cancel` cancelled. Other Python threads run
    during the solve.

    A pair that does not converge raises nothing: check `converged` and `warnings`. Raises TypeError or ValueError for
    arrays that are no photographs, and for unknown settings or values out of range; DeviceError if the device fails.
    """
    images, checked = (_image(i1), _image(i2)), _checked(settings)
    return Result(**_result_fields(_run(engine, "solve", *images, checked, region, _mask(mask), crop_valid, progress, cancel)))


def register(
    i1: ArrayLike,
    i2: ArrayLike,
    *,
    engine: _native.Engine | None = None,
    progress: Callable[[float], object] | None = None,
    cancel: _native.CancellationToken | None = None,
    **settings: Unpack[Settings],
) -> Registration:
    """Registers the second photograph on the first, and matches its brightness. `progress`, `cancel` and errors are as in `solve`."""
    return Registration(**_result_fields(_run(engine, "register", _image(i1), _image(i2), _checked(settings), progress, cancel)))


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
    """Computes where each pixel of a focus sweep is in focus.

    frames: three or more arrays of the same shape and type, in the order of their focus.
    positions: the focus position of each frame, ascending or descending; by default 0, 1, 2, ...
    unit: the unit of `positions`: "settings", evenly spaced in 1/distance; "distances" from the lens, mm; or "stage", the
    place of the plane in focus along the axis, mm.
    reference: index of the frame whose pixels the results have, from 0; by default the middle frame.
    `region`, `mask`, `progress`, `cancel` and errors are as in `solve`.
    """
    images, checked = [_image(frame) for frame in frames], _checked(settings)
    stated = None if positions is None else [float(position) for position in positions]
    result = _run(engine, "stack", images, checked, stated, unit, reference, region, _mask(mask), progress, cancel)
    result["brightness"] = [_brightness(frame) for frame in result["brightness"]]
    return Sweep(**_with_tuples(result))


def apply(
    image: ArrayLike, result: Result | Registration | Sweep, *, frame: int | None = None, exposure: bool = False
) -> NDArray[Any]:
    """Resamples another photograph, taken like I2 or like one frame of a sweep, onto the pixels of the results.

    The type of the samples stays. Pixels that the photograph does not cover are black.
    frame: index of the frame of a sweep, from 0. exposure: also match the brightness of I1.
    """
    array = _image(image)
    if (array.shape[1::-1] if array.ndim > 1 else ()) != result.photograph:
        width, height = result.photograph
        raise ValueError(f"the image has the shape {array.shape}; the registered photographs have ({height}, {width})")
    if isinstance(result, Sweep):
        if frame is None:
            raise TypeError("state the frame of the sweep: frame=N, counted from 0")
        transform, brightness = result.transforms[frame], result.brightness[frame]
    else:
        transform, brightness = result.transform, result.brightness
    matching = (brightness.gain, brightness.offset, brightness.shading.tolist(), brightness.region)
    return _native.apply(array, transform, matching if exposure else None, result.decode, result.region)
