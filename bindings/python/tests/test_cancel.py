"""Tests of progress, cancellation and Ctrl-C."""

import _thread
import threading
import time

import numpy as np
import pytest

import parfocal
from test_parfocal import FAR, NEAR, VALIDATE, photograph

LARGE = [photograph(variance, shift, (640, 480)) for variance, shift in [(0.5, (0, 0)), (1.5, (0.8, -0.6))]]
# With these settings a level takes long enough to be cancelled.
LONG = dict(outer_iterations=400, regularization=0.01)


@pytest.fixture(scope="module")
def engine():
    engine = parfocal.Engine(validation=VALIDATE)
    parfocal.solve(NEAR, FAR, engine=engine)
    yield engine
    assert engine.messages == []


def test_progress_rises_to_one(engine):
    reported = []
    result = parfocal.solve(NEAR, FAR, engine=engine, progress=reported.append)
    assert reported[-1] == 1 and reported == sorted(reported) and len(reported) >= len(result.levels)
    reported.clear()
    parfocal.register(NEAR, FAR, engine=engine, progress=reported.append)
    assert reported[-1] == 1
    reported.clear()
    frames = [photograph(0.3 + n * n, (0.1 * n, 0)) for n in range(-1, 2)]
    parfocal.stack(frames, engine=engine, progress=reported.append)
    assert reported[-1] == 1 and reported == sorted(reported)


def test_an_exception_in_progress_ends_the_call(engine):
    def progress(share):
        raise KeyError("enough")

    for call in (parfocal.solve, parfocal.register):
        with pytest.raises(KeyError, match="enough"):
            call(NEAR, FAR, engine=engine, progress=progress)
    assert parfocal.solve(NEAR, FAR, engine=engine).converged


def test_a_thread_cancels_a_solve_and_the_engine_stays_usable(engine):
    before = parfocal.solve(NEAR, FAR, engine=engine)
    cancel = parfocal.CancellationToken()
    threading.Timer(0.3, cancel.cancel).start()
    with pytest.raises(parfocal.Cancelled, match="cancelled"):
        parfocal.solve(*LARGE, engine=engine, cancel=cancel, **LONG)
    assert cancel.is_cancelled
    with pytest.raises(parfocal.Cancelled):
        parfocal.solve(NEAR, FAR, engine=engine, cancel=cancel)
    after = parfocal.solve(NEAR, FAR, engine=engine)
    assert np.array_equal(before.relative_blur, after.relative_blur, equal_nan=True)


def test_ctrl_c_ends_a_solve(engine):
    threading.Timer(0.3, _thread.interrupt_main).start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        parfocal.solve(*LARGE, engine=engine, **LONG)
    print(f"after {time.monotonic() - began:.1f} s")
    assert parfocal.solve(NEAR, FAR, engine=engine).converged


def test_frames_of_colour_cameras_are_unpacked():
    rows = parfocal.unpack(bytes(range(1, 97)), "BGR8", (8, 4))
    assert rows.shape == (4, 8, 3) and rows[0, 0].tolist() == [3, 2, 1]
    mosaic = np.zeros((4, 8), np.uint16)
    mosaic[0::2, 0::2], mosaic[1::2, 1::2], mosaic[0::2, 1::2], mosaic[1::2, 0::2] = 4000, 10, 200, 200
    colours = parfocal.unpack(mosaic.tobytes(), "BayerRG12", (8, 4))
    assert (colours == [round(v * 65535 / 4095) for v in (4000, 200, 10)]).all()
