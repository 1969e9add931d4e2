"""Takes pairs and focus sweeps with GenICam cameras (GigE Vision, USB3 Vision), through aravis.

    with Camera(focus="LensPosition", positions=[120, 180]) as camera:
        for near, far in camera:
            result = parfocal.solve(near, far)

Needs aravis 0.8 and PyGObject of the system's Python: apt install gir1.2-aravis-0.8 python3-gi.
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
    """The camera or feature does not exist, or no complete frame arrived."""


def cameras() -> list[str]:
    """Returns the names of the available cameras."""
    Aravis.update_device_list()
    return [Aravis.get_device_id(n) for n in range(Aravis.get_n_devices())]


class Camera:
    """A camera with adjustable focus. Each iteration takes one frame per focus position and yields them as a list.

    name: a name from `cameras`; by default the first. "Fake_1" is aravis's simulated camera.
    focus: the feature to set to each position (a number, an enumeration, or a line such as UserOutputValue); or a function
    that is called with each position and returns once the focus is reached.
    positions: the focus positions.
    settle: seconds to wait after setting the focus.
    features: other features to set first, such as {"PixelFormat": "Mono12"}.
    timeout: seconds to wait for a frame. tries: attempts per frame, when one is incomplete or missing.

    Every frame is exposed after its focus was set: with a software trigger, or, if the camera has none, by starting the
    acquisition for each frame. Frames are copies, uint8 or uint16 with white at 65535, grey or RGB; Bayer patterns become
    RGB. Raises CameraError, and ValueError for an unsupported pixel format.
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
        is_simulated = name is not None and name.startswith("Fake_")
        if is_simulated:
            Aravis.enable_interface("Fake")
        self._camera = _checked(Aravis.Camera.new, name)
        for feature, value in (features or {}).items():
            self.set(feature, value)
        self._focus = focus if callable(focus) else lambda position: self.set(focus, position)
        # The simulated camera reports a software trigger, but runs free.
        self._triggered = not is_simulated and _checked(self._camera.is_software_trigger_supported)
        self._stream = _checked(self._camera.create_stream, None, None)
        # One buffer takes the current frame; the other takes a late one.
        for _ in range(2):
            self._stream.push_buffer(Aravis.Buffer.new_allocate(_checked(self._camera.get_payload)))
        if self._triggered:
            _checked(self._camera.set_trigger, "Software")
            _checked(self._camera.set_acquisition_mode, Aravis.AcquisitionMode.CONTINUOUS)
            _checked(self._camera.start_acquisition)
        else:
            _checked(self._camera.set_acquisition_mode, Aravis.AcquisitionMode.SINGLE_FRAME)

    def set(self, feature: str, value: Value) -> None:
        """Sets a feature of the camera. Raises CameraError if the feature does not exist or refuses the value."""
        node = self._camera.get_device().get_feature(feature)
        if node is None:
            raise CameraError(f"the camera has no feature {feature!r}; `arv-tool-0.8 features` lists them")
        if isinstance(node, Aravis.GcBoolean):
            _checked(self._camera.set_boolean, feature, bool(value))
        elif isinstance(node, Aravis.GcEnumeration) or isinstance(value, str):
            _checked(self._camera.set_string, feature, str(value))
        elif isinstance(node, Aravis.GcInteger):
            _checked(self._camera.set_integer, feature, int(value))
        else:
            _checked(self._camera.set_float, feature, float(value))

    def take(self) -> list[NDArray[Any]]:
        """Takes a frame at each position."""
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
        """Stops the camera and releases it for other programs."""
        if self._camera is not None:
            _checked(self._camera.stop_acquisition)
            self._stream = self._camera = None

    def __enter__(self) -> Camera:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _frame(self) -> NDArray[Any]:
        problem = ""
        for _ in range(self.tries):
            # A frame that came too late for an earlier trigger has another focus.
            while late := self._stream.try_pop_buffer():
                self._stream.push_buffer(late)
            _checked(self._camera.software_trigger if self._triggered else self._camera.start_acquisition)
            buffer = self._stream.timeout_pop_buffer(int(1e6 * self.timeout))
            if not self._triggered:
                _checked(self._camera.stop_acquisition)
            if buffer is None:
                problem = f"none arrived within {self.timeout} s"
                continue
            try:
                if buffer.get_status() == Aravis.BufferStatus.SUCCESS:
                    return _array(buffer)
                problem = buffer.get_status().value_nick
            finally:
                self._stream.push_buffer(buffer)
        raise CameraError(f"no complete frame in {self.tries} tries: {problem}")


def _array(buffer: Any) -> NDArray[Any]:
    """Copies the frame, since the camera reuses the buffer."""
    width, height, code = buffer.get_image_width(), buffer.get_image_height(), buffer.get_image_pixel_format()
    data: bytes = buffer.get_image_data()
    if (name := format_name(code)) is None:
        raise ValueError(f"the camera sends pixel format 0x{code:08x}: set PixelFormat to a Mono, RGB, BGR or Bayer format")
    return unpack(data, name, (width, height))


def _checked(call: Callable[..., Any], *arguments: Any) -> Any:
    try:
        return call(*arguments)
    except GLib.Error as error:
        raise CameraError(error.message) from None
