"""The functions that solve, register and read photographs."""

from __future__ import annotations

import difflib
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar, Union, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._results import Brightness, Level, Registration, Result, Sweep

if TYPE_CHECKING:
    from types import FrameType

    from typing_extensions import Unpack


_TABLE = {name: row for name, *row in _native.setting_table()}

# The values of settings that are no numbers.
_VALUES = {
    "method": '"unified", "aligned", "appearance"',
    "kernel": '"auto", "gaussian", "pillbox", "half-gaussian", or an array of samples',
    "motion": '"translation", "similarity", "affine", "homography"',
    "parallax": '"auto", "on", "off"',
    "registration_step": '"gauss-newton", "gradient-descent"',
    "decode": '"auto" (uint8 as sRGB, other types as linear), "none", "srgb"',
    "start": "a 3x3 array",
    "start_photometric": "gain, offset",
}


def _described(name: str) -> str:
    default, limits, description = _TABLE[name]
    words = " ".join(description.split())
    shown = {"true": "True", "false": "False"}.get(default, default)
    values = f"Values: {_VALUES[name]}. " if name in _VALUES else f"Range: {limits}. " if limits else ""
    return f"    {name}: {words} {values}Default: {shown}."


class Settings(TypedDict, total=False):
    method: str
    levels: int | str | None
    outer_iterations: int
    relaxation_sweeps: int
    over_relaxation: float
    regularization: float | str | None
    continuation: float
    data_eta: float
    smoothness_eta: float
    max_relative_blur: float | str | None
    largest_step: float
    kernel: str | ArrayLike
    motion: str
    registration_step: str
    photometric: bool
    parallax: str
    edges: bool
    fused: bool
    keep_frames: bool
    decode: str
    black_level: float | None
    white_level: float | None
    start: ArrayLike
    start_photometric: tuple[float, float]


_NAMES = frozenset(_TABLE)
_SETTINGS = "\n".join(_described(name) for name in Settings.__annotations__)
Settings.__doc__ = f"""The settings of a solve, as keyword arguments.

{_SETTINGS}

    None stands for "auto". docs/method.md, section 8, says more.
    """

# A photograph: an array, or the path of a file that `read` reads.
Photograph = Union[ArrayLike, str, "PathLike[str]"]

_Function = TypeVar("_Function", bound=Callable[..., Any])


def _with_settings(function: _Function) -> _Function:
    """Adds the settings to the documentation of a function."""
    if function.__doc__:
        function.__doc__ += f"\n    Settings:\n\n{_SETTINGS}\n"
    return function


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


def _image(name: str, values: Photograph) -> NDArray[Any]:
    """Reads a file, or checks an array, and converts it to a type of the engine. A masked array loses its mask."""
    if isinstance(values, (str, PathLike)):
        return _native.read(values)
    array = np.asarray(np.ma.getdata(values))
    if any(stride == 0 and length > 1 for stride, length in zip(array.strides, array.shape)):
        # A small array may stand for more pixels than memory has.
        raise ValueError(f"{name} repeats its pixels (a broadcast view): give a copy of it, if that is meant")
    if array.dtype.kind == "f":
        hidden = np.ma.getmaskarray(values) if np.ma.is_masked(values) else None
        _warn_of_range(name, array if hidden is None else array[~hidden])
        if hidden is not None:
            # What is masked is often not a number, which the engine refuses.
            array = np.where(hidden & ~np.isfinite(array), 0, array)
        return np.ascontiguousarray(array, np.float32)
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def _warn_of_range(name: str, array: NDArray[Any]) -> None:
    # The engine refuses an array without pixels, and one with a value that is not a number.
    if not array.size or np.isnan(low := float(array.min())):
        return
    high = float(array.max())
    if low < 0 or high > 1:
        warnings.warn(
            f"{name} has values from {low:.4g} to {high:.4g}, and floats have white at 1: divide by your white level if it is another",
            stacklevel=_depth_of_package(),
        )


def _depth_of_package() -> int:
    """Returns the `stacklevel` of the first caller outside this package, seen from the caller of `warnings.warn`."""
    depth, frame = 0, cast("FrameType | None", sys._getframe(1))
    while frame is not None and frame.f_globals.get("__package__") == __package__:
        depth, frame = depth + 1, frame.f_back
    return depth + 1


def _images(**photographs: Photograph) -> list[NDArray[Any]]:
    """Returns the arrays of photographs where no mask is used."""
    for name, values in photographs.items():
        if np.ma.is_masked(values):
            raise ValueError(f"{name} is masked, which only i1 of solve may be: fill it, or state the mask with mask=")
    return [_image(name, values) for name, values in photographs.items()]


def _mask(values: ArrayLike | None, photograph: Photograph | None = None) -> NDArray[np.uint8] | None:
    """Returns 255 where a pixel counts: where `values` are not 0, and `photograph` is not masked."""
    counts = None if values is None else np.asarray(np.ma.filled(np.ma.asanyarray(values), 0)).astype(bool)
    if np.ma.is_masked(photograph):
        hidden = np.ma.getmaskarray(photograph)
        shown = ~(hidden.any(-1) if hidden.ndim == 3 else hidden)
        if counts is not None and counts.shape != shown.shape:
            raise ValueError(f"mask has the shape {counts.shape}, and i1 {shown.shape}")
        counts = shown if counts is None else counts & shown
    return None if counts is None else np.where(counts, 255, 0).astype(np.uint8)


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

    Raises FileNotFoundError if there is no such file, and ValueError, with what to do, if it cannot be read.
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


@_with_settings
def solve(
    i1: Photograph,
    i2: Photograph,
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

    i1, i2: arrays of shape (height, width) or (height, width, 3), of uint8, uint16 or floats with white at 255, 65535 or
    1; or the paths of files, as of `read`. float64 is computed as float32. Where `i1` is a masked array, masked pixels do
    not count.
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
    checked, counts = _checked(settings), _mask(mask, i1)
    images = [_image("i1", i1), *_images(i2=i2)]
    found = _run(engine, "solve", *images, checked, region, counts, crop_valid, progress, cancel)
    return Result(**_result_fields(found), dtype=images[0].dtype)


@_with_settings
def register(
    i1: Photograph,
    i2: Photograph,
    *,
    engine: _native.Engine | None = None,
    progress: Callable[[float], object] | None = None,
    cancel: _native.CancellationToken | None = None,
    **settings: Unpack[Settings],
) -> Registration:
    """Registers the second photograph on the first, and matches its brightness. `progress`, `cancel` and errors are as in `solve`."""
    found = _run(engine, "register", *_images(i1=i1, i2=i2), _checked(settings), progress, cancel)
    return Registration(**_result_fields(found))


@_with_settings
def stack(
    frames: Iterable[Photograph],
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

    frames: three or more arrays, or paths, of the same shape and type, in the order of their focus.
    positions: the focus position of each frame, ascending or descending; by default 0, 1, 2, ...
    unit: the unit of `positions`: "settings", evenly spaced in 1/distance; "distances" from the lens, mm; or "stage", the
    place of the plane in focus along the axis, mm.
    reference: index of the frame whose pixels the results have, from 0; by default the middle frame.
    `region`, `mask`, `progress`, `cancel` and errors are as in `solve`.
    """
    if isinstance(frames, (str, PathLike)):
        raise TypeError(f"frames is one path, {frames!r}: give a list, such as sorted(glob.glob('sweep/*.png'))")
    images = _images(**{f"frames[{n}]": frame for n, frame in enumerate(frames)})
    checked = _checked(settings)
    stated = None if positions is None else [float(position) for position in positions]
    result = _run(engine, "stack", images, checked, stated, unit, reference, region, _mask(mask), progress, cancel)
    result["brightness"] = [_brightness(frame) for frame in result["brightness"]]
    return Sweep(**_with_tuples(result), dtype=images[0].dtype)


def apply(
    image: Photograph, result: Result | Registration | Sweep, *, frame: int | None = None, exposure: bool = False
) -> NDArray[Any]:
    """Resamples another photograph, taken like I2 or like one frame of a sweep, onto the pixels of the results.

    The type of the samples stays, but float64 comes back as float32. Pixels that the photograph does not cover are black.
    frame: index of the frame of a sweep, from 0. exposure: also match the brightness of I1.
    """
    (array,) = _images(image=image)
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
