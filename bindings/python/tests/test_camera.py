"""Tests of cameras, in the system's Python, and of their pixel formats."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import parfocal
from test_parfocal import ROOT


def test_fake_cameras_work():
    # Only the system's Python has aravis and PyGObject. It can import the same wheel.
    python = os.environ.get("PARFOCAL_PYTHON", "/usr/bin/python3")
    here = Path(__file__).parent
    environment = os.environ | {"PYTHONPATH": str(Path(parfocal.__file__).parents[1])}
    command = [python, here / "cameras.py", ROOT / "docs/guide/src/cameras.md"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("format", "data", "expected"),
    [
        ("Mono8", b"\x01\xff", [1, 255]),
        ("Mono12", b"\x00\x00\xff\x0f", [0, 65535]),
        ("Mono10p", b"\xff\x03\x00", [65535, 0]),
        ("Mono12p", b"\x23\x61\x45", [0x123 * 65535 / 4095, 0x456 * 65535 / 4095]),
        ("Mono12Packed", b"\x12\x63\x45", [0x123 * 65535 / 4095, 0x456 * 65535 / 4095]),
    ],
)
def test_frames_are_unpacked(format, data, expected):
    frame = parfocal.unpack(memoryview(data), format, (2, 1))
    assert frame.shape == (1, 2) and frame.dtype == (np.uint8 if format == "Mono8" else np.uint16)
    assert frame.tolist() == [[round(value) for value in expected]]
    with pytest.raises(ValueError, match="the frame: is of 4 bytes|the frame: is of 2 bytes|the frame: is of 3 bytes"):
        parfocal.unpack(data, format, (3, 1))
    with pytest.raises(ValueError, match="give one of Mono8"):
        parfocal.unpack(data, "YUV422", (2, 1))
