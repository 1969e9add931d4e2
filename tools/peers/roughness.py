"""Roughness of five generated surfaces by surfalize, as constants of the test in src/metric/roughness/peer.rs.

    python -m venv /tmp/venv && /tmp/venv/bin/pip install surfalize==0.19.2
    /tmp/venv/bin/python tools/peers/roughness.py
"""

from __future__ import annotations

import math
import warnings

import numpy as np
from surfalize import Profile, Surface
from surfalize.filter import GaussianFilter

WIDTH, HEIGHT = 200, 160
MASK = (1 << 64) - 1


def mix(z: int) -> int:
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


class Random:
    """SplitMix64, as src/base/random.rs."""

    def __init__(self, seed: int) -> None:
        stream = mix(0)
        self.state = (mix(seed) + (((stream << 32) | (stream >> 32)) & MASK)) & MASK

    def uniform(self) -> float:
        self.state = (self.state + 0x9E3779B97F4A7C15) & MASK
        return (mix(self.state) >> 11) / float(1 << 53)


x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))


def waves(seed: int, count: int, shortest: float, longest: float, spread: float) -> np.ndarray:
    """Cosines of random wavelength, direction and phase; with spread 1 their directions are uniform."""
    random, z = Random(seed), np.zeros_like(x)
    for _ in range(count):
        wavelength = shortest + (longest - shortest) * random.uniform()
        angle = math.pi * spread * (random.uniform() - 0.5)
        phase = 2 * math.pi * random.uniform()
        k = 2 * math.pi / wavelength
        z += 0.2 * np.cos(k * (math.cos(angle) * x + math.sin(angle) * y) + phase)
    return z


def bumps(seed: int) -> np.ndarray:
    """Peaks of 2 px on waves, and independent noise."""
    random, z = Random(seed), waves(seed + 1, 40, 15, 60, 1)
    for _ in range(60):
        u, v, peak = WIDTH * random.uniform(), HEIGHT * random.uniform(), 1 + 2 * random.uniform()
        z += peak * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 18)
    noise = [0.2 * (random.uniform() - 0.5) for _ in range(WIDTH * HEIGHT)]
    return z + np.array(noise).reshape(HEIGHT, WIDTH)


def surface(z: np.ndarray) -> Surface:
    return Surface(z, 1, 1)


def quadric_form() -> np.ndarray:
    return 0.0005 * (x - 80) ** 2 - 0.0003 * (x - 80) * (y - 50) + 0.0008 * (y - 50) ** 2


def cylinder_form() -> np.ndarray:
    c, s = math.cos(0.3), math.sin(0.3)
    return np.sqrt(900.0**2 - (c * (y - 75) - s * (x - 90)) ** 2) + 0.02 * (c * (x - 90) + s * (y - 75))


def filtered() -> Surface:
    z = surface(bumps(5)).level()
    z = GaussianFilter(6, "lowpass")(z)
    z = GaussianFilter(50, "highpass")(z)
    return surface(z.data[50:-50, 50:-50])


SURFACES = {
    "sine and tilt, plane": surface(2 * np.sin(2 * math.pi * x / 25) + 0.05 * x - 0.02 * y).level(),
    "isotropic waves, quadric": surface(waves(1, 60, 10, 40, 1) + quadric_form()).detrend_polynomial(2),
    "lay, no form": surface(waves(2, 60, 8, 30, 0.15)),
    "peaks and noise, S 6 px, L 50 px": filtered(),
    "waves on a cylinder, cylinder": surface(waves(3, 60, 10, 40, 1) + cylinder_form()).remove_cylinder(),
    "missing pixels, plane": Surface(waves(1, 60, 10, 40, 1), 1, 1, mask=(x % 20 < 7) & (y % 16 < 6)).level(),
}
HEIGHT = ["Sa", "Sq", "Ssk", "Sku", "Sp", "Sv", "Sz"]
AREAL = [*HEIGHT, "Sdq", "Sdr", "Sal", "Str"]
PROFILE = ["Ra", "Rq", "Rz"]

warnings.simplefilter("ignore")
for name, z in SURFACES.items():
    # The package evaluates only height parameters without masked pixels.
    values = [getattr(z, parameter)() for parameter in (HEIGHT if z.has_masked_points else AREAL)]
    if not z.has_masked_points:
        rows = [Profile(row, 1) for row in z.data]
        values += [np.mean([getattr(row, parameter)() for row in rows]) for parameter in PROFILE]
    values += [math.nan] * (len(AREAL) + len(PROFILE) - len(values))
    print(f'("{name}", [' + ", ".join("f64::NAN" if math.isnan(v) else f"{v:.9}" for v in values) + "]),")
