"""Roughness of generated surfaces by surfalize and SurfaceTopography, as constants of src/metric/roughness/peer.rs.

    python -m venv /tmp/venv && /tmp/venv/bin/pip install surfalize==0.19.2 SurfaceTopography==1.27.1
    /tmp/venv/bin/python tools/peers/roughness.py           # the constants
    /tmp/venv/bin/python tools/peers/roughness.py --speed   # seconds for 2 Mpx
"""

from __future__ import annotations

import math
import sys
import time
import warnings

import numpy as np
from surfalize import Profile, Surface
from surfalize.filter import GaussianFilter
from SurfaceTopography import Topography

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
OF_HEIGHT = ["Sa", "Sq", "Ssk", "Sku", "Sp", "Sv", "Sz"]
AREAL = [*OF_HEIGHT, "Sdq", "Sdr", "Sal", "Str"]
PROFILE = ["Ra", "Rq", "Rz"]

warnings.simplefilter("ignore")


def topography(z: np.ndarray, order: int | None, mask: np.ndarray | None = None) -> Topography:
    """Heights without their mean, plane (1) or quadric (2), as SurfaceTopography fits them."""
    heights = z if mask is None else np.ma.masked_array(z, mask=mask)
    found = Topography(heights.T, physical_sizes=(float(z.shape[1]), float(z.shape[0])))
    return found if order is None else found.detrend({0: "center", 1: "height", 2: "curvature"}[order])


def speed() -> None:
    """Prints the seconds for a surface of 2 Mpx: a plane is removed, then the parameters that each package has."""
    random = np.random.default_rng(1)
    z = random.normal(size=(1080, 1920)) + 0.01 * np.arange(1920)
    start = time.perf_counter()
    levelled = Surface(z, 1, 1).level()
    [getattr(levelled, parameter)() for parameter in AREAL]
    print(f"surfalize: {time.perf_counter() - start:.2f} s for the plane and {len(AREAL)} parameters")
    start = time.perf_counter()
    filtered = GaussianFilter(100, "highpass")(GaussianFilter(10, "lowpass")(levelled))
    print(f"surfalize: {time.perf_counter() - start:.2f} s for S and L filters of 10 and 100 px")
    start = time.perf_counter()
    levelled = topography(z, 1)
    levelled.rms_height_from_area(), levelled.rms_gradient()
    print(f"SurfaceTopography: {time.perf_counter() - start:.2f} s for the plane, Sq and Sdq")
    assert filtered.data.shape == z.shape


if "--speed" in sys.argv:
    speed()
    sys.exit()

for name, z in SURFACES.items():
    # The package evaluates only height parameters without masked pixels.
    values = [getattr(z, parameter)() for parameter in (OF_HEIGHT if z.has_masked_points else AREAL)]
    if not z.has_masked_points:
        rows = [Profile(row, 1) for row in z.data]
        values += [np.mean([getattr(row, parameter)() for row in rows]) for parameter in PROFILE]
    values += [math.nan] * (len(AREAL) + len(PROFILE) - len(values))
    print(f'("{name}", [' + ", ".join("f64::NAN" if math.isnan(v) else f"{v:.9}" for v in values) + "]),")

# SurfaceTopography: Sq, Sz and Sdq. It has no other of the parameters, and another filter.
mask = (x % 20 < 7) & (y % 16 < 6)
OTHER = {
    "sine and tilt, plane": topography(2 * np.sin(2 * math.pi * x / 25) + 0.05 * x - 0.02 * y, 1),
    "isotropic waves, quadric": topography(waves(1, 60, 10, 40, 1) + quadric_form(), 2),
    "lay, no form": topography(waves(2, 60, 8, 30, 0.15), 0),
    "peaks and noise, plane": topography(bumps(5), 1),
    "missing pixels, plane": topography(waves(1, 60, 10, 40, 1), 1, mask),
}
for name, z in OTHER.items():
    heights = z.heights()
    values = [z.rms_height_from_area(), float(heights.max() - heights.min()), z.rms_gradient()]
    print(f'("{name}", [' + ", ".join("f64::NAN" if not np.isfinite(v) else f"{v:.9}" for v in values) + "]),")
