"""Tests of streams: results come in order and equal those of `solve`."""

import _thread
import os
import queue
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import parfocal
from test_parfocal import VALIDATE, photograph

SIZE = (64, 48)
SETTINGS = dict(outer_iterations=6, max_relative_blur=36)
PAIRS = [(photograph(0.5, size=SIZE), photograph(1 + n / 2, (0.4, -0.2 * n), SIZE)) for n in range(4)]
FIELDS = ("relative_blur", "uncertainty", "confidence", "residual", "fused", "transform")


@pytest.fixture(scope="module")
def solved():
    engine = parfocal.Engine(validation=VALIDATE)
    yield [parfocal.solve(*pair, engine=engine, **SETTINGS) for pair in PAIRS]
    assert engine.messages == []


@pytest.fixture
def opened():
    """Opens streams, closes them after the test, and checks that validation reports nothing."""
    streams = []

    def stream(*arguments, **settings):
        streams.append(parfocal.Stream(*arguments, validation=VALIDATE, **SETTINGS | settings))
        return streams[-1]

    yield stream
    for one in streams:
        one.close()
        assert one.messages == []


def some(count):
    return [PAIRS[n % len(PAIRS)] for n in range(count)]


def assert_is(result, expected):
    for name in FIELDS:
        assert getattr(result, name).tobytes() == getattr(expected, name).tobytes(), name
    for name in ("warnings", "converged", "valid_fraction", "mean_confidence", "regularization", "region", "decode"):
        assert getattr(result, name) == getattr(expected, name), name
    assert type(result) is parfocal.Result


@pytest.mark.parametrize(("device", "slots"), [(None, 1), ("0", 3), (["0", "0"], 2)])
def test_results_are_in_order_and_equal_those_of_solve(opened, solved, device, slots):
    stream = opened(device, slots)
    results = list(stream.map(some(9)))
    for n, result in enumerate(results):
        assert_is(result, solved[n % len(solved)])
    assert len(results) == 9 and len(stream) == 0 and stream.capacity == 2 * slots * len(stream.devices)
    assert list(stream.map([])) == [] and "0 of" in repr(stream)


def test_a_stream_can_use_all_devices(opened, solved):
    stream = opened("all")
    assert_is(next(stream.map(PAIRS)), solved[0])
    # Dropping the iterator of `map` keeps the pairs that it has already taken.
    taken = len(stream)
    assert len(list(stream.map([]))) == taken


def test_one_thread_pushes_and_another_reads(opened, solved):
    stream = opened(slots=1)

    def push():
        for pair in some(8):
            stream.push(*pair, timeout=None)
        stream.finish()

    thread = threading.Thread(target=push)
    thread.start()
    results = list(stream)
    thread.join()
    for n, result in enumerate(results):
        assert_is(result, solved[n % len(solved)])
    assert len(results) == 8


def test_a_full_stream_says_so(opened, solved):
    stream = opened(slots=1)
    assert stream.next(0) is None and stream.next(0.01) is None
    for pair in some(2):
        stream.push(*pair)
    for timeout in (0, 0.07):
        with pytest.raises(queue.Full, match="read a result"):
            stream.push(*PAIRS[2], timeout=timeout)
    assert_is(stream.next(), solved[0])
    stream.push(*PAIRS[2])
    stream.finish()
    for result, expected in zip(stream, solved[1:], strict=False):
        assert_is(result, expected)


def test_a_pair_that_fails_raises_in_its_place(opened, solved):
    stream = opened(slots=2)
    small = tuple(image[:40] for image in PAIRS[0])
    pairs, found = iter([PAIRS[0], PAIRS[1], small, PAIRS[2], PAIRS[3]]), []
    while len(found) < 5:
        try:
            found.extend(stream.map(pairs))
        except ValueError as error:
            found.append(str(error))
    assert "prepared for 64x48" in found.pop(2)
    for result, expected in zip(found, solved):
        assert_is(result, expected)
    # An image of an unsupported type is refused and not pushed.
    with pytest.raises(TypeError, match="convert it"):
        stream.push(PAIRS[0][0].astype(int), PAIRS[0][1])
    assert len(stream) == 0


def test_leaving_the_context_closes_the_stream(opened):
    with opened() as stream:
        for pair in some(5):
            stream.push(*pair)
    assert list(stream) == [] and len(stream) == 0
    with pytest.raises(ValueError, match="closed"):
        stream.push(*PAIRS[0])
    del stream
    dropped = parfocal.Stream(**SETTINGS)
    dropped.push(*PAIRS[0])
    del dropped


@pytest.mark.parametrize("wait", [lambda stream: stream.next(), lambda stream: stream.push(*PAIRS[0], timeout=None)])
def test_ctrl_c_ends_a_wait(opened, wait):
    stream = opened(slots=1)
    if "push" in wait.__code__.co_names:
        for pair in some(stream.capacity):
            stream.push(*pair)
    timer = threading.Timer(0.3, _thread.interrupt_main)
    timer.start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        wait(stream)
    assert time.monotonic() - began < 5


def test_invalid_arguments_are_reported():
    for error, words, arguments in [
        (TypeError, "did you mean max_relative_blur", dict(max_relativ_blur=3)),
        (ValueError, "one slot", dict(slots=0)),
        (ValueError, "one device", dict(device=[])),
        (ValueError, "timeout", dict(timeout=0)),
        (parfocal.DeviceError, "no such thing", dict(device=["0", "no such thing"])),
    ]:
        with pytest.raises(error, match=words):
            parfocal.Stream(**arguments)
    with parfocal.Stream(max_relative_blur=2000) as stream:
        with pytest.raises(ValueError, match="max_relative_blur is 2000"):
            stream.push(*PAIRS[0])
        with pytest.raises(ValueError, match="timeout"):
            stream.next(-1)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_child_gets_an_error(opened):
    stream = opened()
    stream.push(*PAIRS[0])
    child = os.fork()
    if child == 0:
        try:
            stream.push(*PAIRS[0])
        except parfocal.DeviceError as error:
            os._exit(0 if "spawn" in str(error) else 1)
        os._exit(2)
    assert os.waitpid(child, 0)[1] == 0


def test_memory_does_not_grow_with_the_number_of_pairs():
    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    count = int(os.environ.get("PARFOCAL_PAIRS_OF_MEMORY", "48"))
    with parfocal.Stream(**SETTINGS) as stream:
        for n, result in enumerate(stream.map(some(count))):
            assert np.isfinite(result.relative_blur).any()
            if n == 23:
                before = resident()
        grown = resident() - before
    print(f"{count} pairs through a stream: {before >> 10} KiB after 24, {grown >> 10} KiB more at the end")
    assert grown < 8 << 20


def test_closing_a_stream_ends_a_waiting_push(opened):
    stream = opened(slots=1)
    for pair in some(stream.capacity):
        stream.push(*pair)
    threading.Timer(0.2, stream.close).start()
    with pytest.raises(ValueError, match="closed"):
        stream.push(*PAIRS[0], timeout=None)


def test_a_push_to_a_full_stream_does_not_undo_finish(opened):
    stream = opened(slots=1)
    for pair in some(stream.capacity):
        stream.push(*pair)
    stream.finish()
    with pytest.raises(queue.Full):
        stream.push(*PAIRS[0], timeout=0)
    assert len(list(stream)) == stream.capacity
