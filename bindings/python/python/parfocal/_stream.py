"""A stream of pairs: solves many pairs and returns the results in order."""

from __future__ import annotations

import queue
from collections.abc import Iterable, Iterator, Sequence
from types import TracebackType
from typing import TYPE_CHECKING

from . import _native
from ._results import Result
from ._solves import Photograph, Settings, _checked, _images, _result_fields

if TYPE_CHECKING:
    from typing_extensions import Self, Unpack


class Stream:
    """Solves many pairs of the same shape and type. Results come in the order in which pairs were pushed, as from `solve`:

        with parfocal.Stream() as stream:
            for result in stream.map(pairs):
                ...

    While the device solves one pair, the next is uploaded and the one before is read back.

    device: a device as in `Engine`, a list of devices, or "all"; each pair goes to the first free device.
    slots: pairs in flight per device; three keep a device busy.
    timeout: the time limit of one solve, seconds.
    Settings are those of `solve`. The first pair determines the shape and type of all.

    At most `capacity` pairs, two per slot, may be pushed and not yet read; reading makes room. One thread may push while
    another reads. Ctrl-C ends every wait except those of `close` and of the first push, which prepares the devices. A pair
    that fails raises in its place, and later pairs are unaffected. The pairs of a device that fails go to the others.
    `close`, or the end of `with`, waits for the pairs in flight and drops the rest.
    """

    def __init__(
        self,
        device: str | int | Sequence[str | int] | None = None,
        slots: int = 3,
        *,
        timeout: float = 600.0,
        validation: bool = False,
        **settings: Unpack[Settings],
    ) -> None:
        devices = [device] if isinstance(device, (str, int)) else device
        self._settings = _checked(settings)
        names = None if devices is None else [str(name) for name in devices]
        self._native = _native.Stream(names, slots, timeout, validation)

    def push(self, i1: Photograph, i2: Photograph, timeout: float | None = 0.0) -> None:
        """Copies a pair into the stream.

        timeout: seconds to wait for room; None waits without limit, for use when another thread reads.

        Raises queue.Full if there is no room in time, and TypeError or ValueError as `solve`; the pair then has no result.
        """
        images = _images(i1=i1, i2=i2)
        # All pairs have the type of the first. Another thread may read the result before the push returns.
        self._dtype = images[0].dtype
        if not self._native.push(*images, self._settings, timeout):
            raise queue.Full("the stream is full: read a result before the next push, or use map()")

    def next(self, timeout: float | None = None) -> Result | None:
        """Returns the result of the oldest pair that has not been read.

        timeout: seconds to wait for it; None waits without limit. Returns None if it is not solved in time, and after `finish`
        once all results have been read. Raises the error of a pair that failed.
        """
        result = self._native.next(timeout)
        return None if result is None else Result(**_result_fields(result), dtype=self._dtype)

    def finish(self) -> None:
        """Marks the end of input: iteration ends after the result of the last pair. A later push reopens the stream."""
        self._native.finish()

    def __iter__(self) -> Iterator[Result]:
        """Yields results as they arrive, until all have been read after `finish`."""
        while (result := self.next()) is not None:
            yield result

    def map(self, pairs: Iterable[tuple[Photograph, Photograph]]) -> Iterator[Result]:
        """Yields the results of `pairs`, after those of pairs pushed before. Pairs are drawn as there is room.

        If a pair raises, call `map` again with the same iterator to continue after it. No other thread may read meanwhile.
        """
        pairs = iter(pairs)
        while True:
            while len(self) >= self.capacity and (result := self.next()) is not None:
                yield result
            if (pair := next(pairs, None)) is None:
                break
            self.push(*pair)
            if (result := self.next(0)) is not None:
                yield result
        self.finish()
        yield from self

    @property
    def devices(self) -> list[str]:
        """The names of the devices."""
        return self._native.names

    @property
    def messages(self) -> list[str]:
        """The messages of the validation layer so far."""
        return self._native.messages

    @property
    def capacity(self) -> int:
        """The number of pairs that may be pushed and not yet read."""
        return self._native.capacity

    def __len__(self) -> int:
        """The number of pairs pushed and not yet read."""
        return len(self._native)

    def __bool__(self) -> bool:
        return True

    def close(self) -> None:
        """Waits for the pairs in flight and drops the rest."""
        self._native.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<parfocal.Stream on {', '.join(self.devices)}: {len(self)} of {self.capacity} pairs>"
