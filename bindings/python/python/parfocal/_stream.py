"""Many pairs one after the other."""

from __future__ import annotations

import queue
from collections.abc import Iterable, Iterator, Sequence
from types import TracebackType
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from . import _native
from ._results import Result
from ._solves import Settings, _found, _image, _named

if TYPE_CHECKING:
    from typing_extensions import Self, Unpack


class Stream:
    """Many pairs of one size and kind, their results in the order in which they were pushed, each as `solve` gives it:

        with parfocal.Stream() as stream:
            for result in stream.map(pairs):
                ...

    The next pair goes up and the one before comes down while the device solves. device: as of `Engine`, several in a list, each pair
    goes to whichever is free, or "all"; the most capable without. slots: pairs under way on each; three keep it busy. timeout: the
    longest wait for one solve, seconds. Settings are those of `solve`; the first pair says of what size and kind all are.

    At most `capacity` pairs, two for each slot, are pushed and not yet read: only reading makes room. One thread may push while another reads;
    Ctrl-C ends every wait but that of `close` and of the first push, which prepares. A pair that fails raises in its place, as `solve` would, and the next ones go on; what a device that fails
    had the others solve. `close`, or the end of `with`, waits for what the devices have and forgets the rest.
    """

    def __init__(
        self,
        device: str | Sequence[str] | None = None,
        slots: int = 3,
        *,
        timeout: float = 600.0,
        validation: bool = False,
        **settings: Unpack[Settings],
    ) -> None:
        devices = [device] if isinstance(device, str) else device
        self._named = _named(settings)
        self._native = _native.Stream(None if devices is None else list(devices), slots, timeout, validation)

    def push(self, i1: ArrayLike, i2: ArrayLike, timeout: float | None = 0.0) -> None:
        """Copies a pair and hands it over.

        Raises queue.Full where there is no room within so many seconds, None for ever, which is of use where another thread reads;
        TypeError or ValueError, as `solve`, for what is no photograph, and of the first pair for settings: such a pair has no result.
        """
        if not self._native.push(_image(i1), _image(i2), self._named, timeout):
            raise queue.Full("the stream is full: read a result before the next pair, or take map()")

    def next(self, timeout: float | None = None) -> Result | None:
        """The result of the oldest pair that has not been read, if it is there within so many seconds, None for ever.

        None where it is not, and after `finish` where all have been read. Raises what the pair failed of.
        """
        found = self._native.next(timeout)
        return None if found is None else Result(**_found(found))

    def finish(self) -> None:
        """Says that no more pairs come, so that iteration ends with the result of the last. Another push takes it back."""
        self._native.finish()

    def __iter__(self) -> Iterator[Result]:
        """Results as they come, until all have been read after `finish`."""
        while (result := self.next()) is not None:
            yield result

    def map(self, pairs: Iterable[tuple[ArrayLike, ArrayLike]]) -> Iterator[Result]:
        """The results of these pairs, which are taken as there is room for them; those of pairs that were pushed before come first.

        Where a pair has raised, `map` of the same iterator goes on behind it. Nobody else reads meanwhile.
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
        """Their names."""
        return self._native.names

    @property
    def messages(self) -> list[str]:
        """What validation has said so far."""
        return self._native.messages

    @property
    def capacity(self) -> int:
        """How many pairs may be pushed and not yet read."""
        return self._native.capacity

    def __len__(self) -> int:
        """How many pairs were pushed and not yet read."""
        return len(self._native)

    def __bool__(self) -> bool:
        return True

    def close(self) -> None:
        """Waits for what the devices have, and forgets the rest."""
        self._native.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<parfocal.Stream on {', '.join(self.devices)}: {len(self)} of {self.capacity} pairs>"
