"""Pairs and focus sweeps of GenICam cameras (GigE Vision, USB3 Vision), by aravis.

    with Camera(focus="LensPosition", positions=[120, 180]) as camera:
        for near, far in camera:
            result = parfocal.solve(near, far)

Needs aravis 0.8 and PyGObject, which come with the system's Python: apt install gir1.2-aravis-0.8 python3-gi.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from ._native import format_name
from ._solves import unpack

try:
    import gi

    gi.require_version("Aravis", "0.8")
    from gi.repository import Aravis, GLib
except (ImportError, ValueError) as error:
    raise ImportError(
        "parfocal.camera needs aravis and PyGObject: apt install gir1.2-aravis-0.8 python3-gi, and the system's Python"
    ) from error

__all__ = ["Camera", "CameraError", "cameras"]

Value = bool | int | float | str


class CameraError(RuntimeError):
    """There is no such camera or feature, or no whole frame came."""


def cameras() -> list[str]:
    """The names of the cameras that there are."""
    Aravis.update_device_list()
    return [Aravis.get_device_id(n) for n in range(Aravis.get_n_devices())]


class Camera:
    """A camera whose focus is stepped; iterating over it takes frame after frame at `positions`, again and again, a list each time.

    name: of `cameras`; the first without; "Fake_1" is aravis's camera without a camera. focus: the feature that is set to each of the
    positions: a number, an enumeration, or a line such as UserOutputValue; or what is called with each and returns once the focus is there.
    settle: seconds that the focus takes after that. features: others to set first, such as {"PixelFormat": "Mono12"}. timeout: seconds
    for a frame. tries: so many where one comes with holes, or not.

    Every frame is exposed after its focus was set: by a software trigger, or where the camera has none by a start of its own.
    Frames are copies: uint8, or uint16 whose white is 65535, grey or RGB, which Bayer patterns become. Raises CameraError,
    ValueError for other formats of pixels.
    """

    def __init__(
        self,
        name: str | None = None,
        *,
        focus: str | Callable[[Any], object],
        positions: Sequence[Any],
        settle: float = 0.0,
        features: Mapping[str, Value] | None = None,
        timeout: float = 5.0,
        tries: int = 3,
    ) -> None:
        self.positions, self.settle, self.timeout, self.tries = list(positions), settle, timeout, tries
        without_camera = name is not None and name.startswith("Fake_")
        if without_camera:
            Aravis.enable_interface("Fake")
        self._camera = _told(Aravis.Camera.new, name)
        for feature, value in (features or {}).items():
            self.set(feature, value)
        self._focus = focus if callable(focus) else lambda position: self.set(focus, position)
        # The one without a camera says that it is triggered, and runs free.
        self._triggered = not without_camera and _told(self._camera.is_software_trigger_supported)
        self._stream = _told(self._camera.create_stream, None, None)
        # One is exposed at a time; the other is for what comes late.
        for _ in range(2):
            self._stream.push_buffer(Aravis.Buffer.new_allocate(_told(self._camera.get_payload)))
        if self._triggered:
            _told(self._camera.set_trigger, "Software")
            _told(self._camera.set_acquisition_mode, Aravis.AcquisitionMode.CONTINUOUS)
            _told(self._camera.start_acquisition)
        else:
            _told(self._camera.set_acquisition_mode, Aravis.AcquisitionMode.SINGLE_FRAME)

    def set(self, feature: str, value: Value) -> None:
        """Sets a feature of the camera. Raises CameraError where it has none of that name, or not for this value."""
        node = self._camera.get_device().get_feature(feature)
        if node is None:
            raise CameraError(f"the camera has no feature {feature!r}; `arv-tool-0.8 features` lists those it has")
        if isinstance(node, Aravis.GcBoolean):
            _told(self._camera.set_boolean, feature, bool(value))
        elif isinstance(node, Aravis.GcEnumeration) or isinstance(value, str):
            _told(self._camera.set_string, feature, str(value))
        elif isinstance(node, Aravis.GcInteger):
            _told(self._camera.set_integer, feature, int(value))
        else:
            _told(self._camera.set_float, feature, float(value))

    def take(self) -> list[NDArray[Any]]:
        """A frame at each position."""
        frames = []
        for position in self.positions:
            self._focus(position)
            time.sleep(self.settle)
            frames.append(self._frame())
        return frames

    def __iter__(self) -> Iterator[list[NDArray[Any]]]:
        while True:
            yield self.take()

    def close(self) -> None:
        """Stops the camera and lets go of it, for other programs too."""
        if self._camera is not None:
            _told(self._camera.stop_acquisition)
            self._stream = self._camera = None

    def __enter__(self) -> Camera:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _frame(self) -> NDArray[Any]:
        problem = ""
        for _ in range(self.tries):
            # What came too late for an earlier trigger is of another focus.
            while late := self._stream.try_pop_buffer():
                self._stream.push_buffer(late)
            _told(self._camera.software_trigger if self._triggered else self._camera.start_acquisition)
            buffer = self._stream.timeout_pop_buffer(int(1e6 * self.timeout))
            if not self._triggered:
                _told(self._camera.stop_acquisition)
            if buffer is None:
                problem = f"none came within {self.timeout} s"
                continue
            try:
                if buffer.get_status() == Aravis.BufferStatus.SUCCESS:
                    return _array(buffer)
                problem = buffer.get_status().value_nick
            finally:
                self._stream.push_buffer(buffer)
        raise CameraError(f"no whole frame in {self.tries} tries: {problem}")


def _array(buffer: Any) -> NDArray[Any]:
    """A copy, as the camera writes into the buffer again."""
    width, height, kind = buffer.get_image_width(), buffer.get_image_height(), buffer.get_image_pixel_format()
    data: bytes = buffer.get_image_data()
    if (name := format_name(kind)) is None:
        raise ValueError(f"the camera sends pixel format 0x{kind:08x}: set PixelFormat to a Mono, RGB, BGR or Bayer format")
    return unpack(data, name, (width, height))


def _told(call: Callable[..., Any], *arguments: Any) -> Any:
    try:
        return call(*arguments)
    except GLib.Error as error:
        raise CameraError(error.message) from None
