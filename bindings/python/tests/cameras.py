"""Tests of parfocal.camera on aravis fake cameras. test_camera.py runs them in the system's Python, without pytest."""

import itertools
import sys

import numpy as np

import parfocal
from parfocal.camera import Aravis, Camera, CameraError, cameras

EXPOSURES = [1000.0, 5000.0, 10000.0]


def raises(kind, words, call, *arguments, **named):
    try:
        call(*arguments, **named)
    except kind as error:
        assert words in str(error), error
    else:
        raise AssertionError(f"no {kind.__name__}: {words}")


def check_sweeps(name, **options):
    """Takes two sweeps and checks that each frame has its own exposure."""
    small = {"Width": 64, "Height": 48, "PixelFormat": "Mono16"}
    with Camera(name, focus="ExposureTimeAbs", positions=EXPOSURES, features=small, **options) as camera:
        first, second = itertools.islice(camera, 2)
        kept = [frame.copy() for frame in first]
        camera.take()
    for frames in (first, second):
        assert [frame.shape for frame in frames] == [(48, 64)] * 3 and frames[0].dtype == np.uint16
        # The picture is a moving ramp whose slope is proportional to the exposure.
        slopes = [np.median(np.diff(frame.astype(int))) for frame in frames]
        assert np.allclose(slopes, [0, 179, 256], atol=1), slopes
    assert all(np.array_equal(*both) for both in zip(first, kept)), "the camera changed a frame that it had returned"


def triggered():
    """Tests a triggered GigE Vision camera on the loopback address."""
    fake = Aravis.GvFakeCamera.new("127.0.0.1", "parfocal")
    if not fake.is_running():
        sys.exit("the port of GigE Vision is in use on 127.0.0.1: stop the other fake camera")
    check_sweeps("127.0.0.1")


def started():
    """Tests a camera without a trigger."""
    check_sweeps("Fake_1", settle=0.02)
    assert "Fake_1" in cameras()


def kinds():
    moved = []
    features = {"Width": 32, "Height": 16, "PixelFormat": "RGB8", "GainAuto": "Off", "GainRaw": 1}
    with Camera("Fake_1", focus=moved.append, positions=["near", "far"], features=features) as camera:
        near, far = camera.take()
        assert near.shape == (16, 32, 3) and near.dtype == np.uint8 and moved == ["near", "far"]
        raises(CameraError, "'Focus'", camera.set, "Focus", 3)
    camera.close()
    with Camera("Fake_1", focus=moved.append, positions=[1], features=features | {"PixelFormat": "BayerRG8"}) as bayer:
        [frame] = bayer.take()
        assert frame.shape == (16, 32, 3) and frame.dtype == np.uint8
    raises(CameraError, "not found", Camera, "nothing", focus="Gain", positions=[1])


def focused(frames):
    """Returns pictures of one texture, each of them blurred more, for frames of a camera that has no lens."""
    [height, width] = frames[0].shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width))
    texture = np.fft.fft2(np.random.default_rng(1).normal(size=(height, width))) / (frequency + 0.02)
    blurs = [np.exp(-2 * (np.pi * frequency) ** 2 * (1 + 2 * n * n)) for n in range(len(frames))]
    pictures = [np.fft.ifft2(texture * blur).real for blur in blurs]
    return [(32768 + 8000 * picture / pictures[0].std()).clip(0, 65535).astype(np.uint16) for picture in pictures]


def guide(page):
    blocks = open(page).read().split("```python\n")[1:]
    take = Camera.take
    Camera.take = lambda camera: focused(take(camera))
    names = {}
    exec("".join(block.split("```")[0] for block in blocks), names)
    assert isinstance(names["result"], parfocal.Result) and isinstance(names["sweep"], parfocal.Sweep)


triggered()
started()
kinds()
guide(sys.argv[1])
