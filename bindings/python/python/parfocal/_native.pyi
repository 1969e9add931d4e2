"""The compiled module: plain arrays and dictionaries. Use the package `parfocal` instead."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

__version__: str

class DeviceError(RuntimeError):
    """No device is usable, or the device failed or exceeded the time limit."""

class Cancelled(RuntimeError):
    """The call was cancelled."""

class CancellationToken:
    """Cancels solves, from any thread: solves that use the token raise Cancelled soon, and so do later ones."""

    def __init__(self) -> None: ...
    def cancel(self) -> None:
        """Cancels all solves that use this token."""
    @property
    def is_cancelled(self) -> bool:
        """Whether `cancel` was called."""

class Engine:
    """A Vulkan device. Calls from several threads run one after another."""

    def __init__(self, device: str | int | None = None, *, timeout: float = 600.0, validation: bool = False) -> None: ...
    @property
    def name(self) -> str: ...
    @property
    def messages(self) -> list[str]: ...
    def solve(
        self,
        i1: NDArray[Any],
        i2: NDArray[Any],
        settings: dict[str, Any],
        region: Sequence[int] | None,
        mask: NDArray[np.uint8] | None,
        crop_valid: bool,
        progress: Callable[[float], object] | None,
        cancel: CancellationToken | None,
    ) -> dict[str, Any]: ...
    def register(
        self,
        i1: NDArray[Any],
        i2: NDArray[Any],
        settings: dict[str, Any],
        progress: Callable[[float], object] | None,
        cancel: CancellationToken | None,
    ) -> dict[str, Any]: ...
    def stack(
        self,
        frames: list[NDArray[Any]],
        settings: dict[str, Any],
        positions: list[float] | None,
        unit: str,
        reference: int | None,
        region: Sequence[int] | None,
        mask: NDArray[np.uint8] | None,
        progress: Callable[[float], object] | None,
        cancel: CancellationToken | None,
    ) -> dict[str, Any]: ...

class Stream:
    """A stream of pairs, on its own devices."""

    def __init__(self, devices: list[str] | None, slots: int, timeout: float, validation: bool) -> None: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def messages(self) -> list[str]: ...
    @property
    def capacity(self) -> int: ...
    def __len__(self) -> int: ...
    def push(self, i1: NDArray[Any], i2: NDArray[Any], settings: dict[str, Any], timeout: float | None) -> bool: ...
    def next(self, timeout: float | None) -> dict[str, Any] | None: ...
    def finish(self) -> None: ...
    def close(self) -> None: ...

def devices() -> list[tuple[str, str | None]]: ...
def unpack(data: bytes, format: str) -> NDArray[Any]: ...
def format_name(code: int) -> str | None: ...
def setting_table() -> list[tuple[str, str, str, str]]: ...
def check_lens(
    optics: tuple[float, float, float], focus: Sequence[float], kappa: float, telecentric: bool
) -> None: ...
def read(path: str | PathLike[str]) -> NDArray[Any]: ...
def apply(
    of: NDArray[Any],
    transform: NDArray[np.float64],
    brightness: tuple[float, float, list[float], Sequence[int]] | None,
    decode: str,
    region: Sequence[int],
) -> NDArray[Any]: ...
def depth(
    blur: NDArray[np.float32],
    uncertainty: NDArray[np.float32],
    scale: float,
    limit: float,
    optics: tuple[float, float, float],
    focus: Sequence[float],
    kappa: float,
    telecentric: bool,
) -> tuple[NDArray[np.float32], NDArray[np.float32], int, str | None]: ...
def level(values: NDArray[np.float32], of: Sequence[int]) -> tuple[float, float] | None: ...
def step(values: NDArray[np.float32], from_: Sequence[int], to: Sequence[int], /) -> tuple[float, float] | None: ...
def profile(
    values: NDArray[np.float32], start: Sequence[float], end: Sequence[float], across: float
) -> NDArray[np.float64]: ...
def texture(
    values: NDArray[np.float32],
    deviation: NDArray[np.float32],
    common: NDArray[np.float32] | None,
    options: object,
) -> tuple[tuple[int, int, int, int], bool, list[tuple[str, float, float, float, float | None, float]]]: ...
def repeated(
    maps: list[tuple[NDArray[np.float32], NDArray[np.float32]]],
    form_name: str,
    region: Sequence[int] | None,
    within: NDArray[np.uint8] | None,
) -> str: ...
def readings(values: list[float], stated: tuple[float, float] | None) -> tuple[str, str | None]: ...
def gauge(counts: Sequence[int], readings: list[float], tolerance_width: float | None) -> str: ...
