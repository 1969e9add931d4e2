"""Measures pairs taken by a camera that moved against the truth, or against those of a camera that stood still; see
README.md.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
from pathlib import Path

import cv2
import numpy as np
from hand_held import contrast
from images import BORDER_PX, blur_rms, read_field, read_grey, write_grey
from scipy import ndimage
from similarity import Similarity

MOVES_PX = (0, 1, 2, 3, 6)
NOISES = (0.003, 0.01)
MARGIN = 64
"""Rendered around the photograph, so that its borders are real content."""
TRANSFORM = Similarity(1.2, -0.8, 0.12, 1.006)
NOT_MEASURED = 1000
"""The standard deviation of V where the photographs do not determine it."""
EDGE, WRONG, NEAR_PX = 1.5, 1.0, 10
"""A jump of V that is an edge and an error of V that is wrong, px², and how near to an edge pixels count."""


def smooth(size: int, sigma: float, seed: int) -> np.ndarray:
    """Returns a random field of deviation 1, in Fourier space: periodic."""
    frequency = 2 * np.pi * np.fft.fftfreq(size)
    square = frequency[:, None] ** 2 + frequency**2
    noise = np.fft.fft2(np.random.default_rng(seed).standard_normal((size, size)))
    field = np.fft.ifft2(noise * np.exp(-square * sigma**2 / 2)).real
    return (field - field.mean()) / field.std()


def defocused(radiance: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Blurs each pixel by a Gaussian of its own variance, px²."""
    steps = np.linspace(0, math.sqrt(variance.max()), 40)
    stack = [ndimage.gaussian_filter(radiance, step, mode="wrap", truncate=6) for step in steps]
    at = np.sqrt(variance) / steps[1]
    return ndimage.map_coordinates(np.stack(stack), [at, *np.indices(at.shape)], order=3, mode="nearest")


def relief(size: int, moved_px: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns I1, I2 and V of a smooth relief, V up to 6 px² and its hills as wide as an eighth of the photograph, and p
    that displaces the nearest against the farthest by `moved_px`, in a direction that differs with the seed."""
    full = size + 2 * MARGIN
    v = smooth(full, 28 * size / 192, seed)
    v *= 6 / np.abs(v).max()
    radiance = sum(smooth(full, sigma, 1000 * seed + n) for n, sigma in enumerate((0.7, 1.5, 4, 10)))
    radiance = (radiance - radiance.min()) / np.ptp(radiance)
    i1, i2 = (defocused(radiance, 0.6 + np.clip(sign * v, 0, None)) for sign in (-1, 1))
    inside = np.s_[MARGIN:-MARGIN, MARGIN:-MARGIN]
    p = moved_px / np.ptp(v[inside]) * np.array([math.cos(2.4 * seed), math.sin(2.4 * seed)])
    y, x = np.indices(v.shape, dtype=float)
    a, b, tx = TRANSFORM.affine((full, full))[0]
    c, d, ty = TRANSFORM.affine((full, full))[1]
    back = np.linalg.inv([[a, b], [c, d]])
    to = np.tensordot(back, np.stack([x - tx, y - ty]), 1)
    at = to.copy()
    for _ in range(30):
        displaced = ndimage.map_coordinates(v, at[::-1], order=1, mode="nearest")
        at = to - p[:, None, None] * displaced
    i2 = ndimage.map_coordinates(i2, at[::-1], order=5, mode="mirror")
    return i1[inside], i2[inside], v[inside], p


class Solved:
    """What the program reports of a pair, and its V."""

    def __init__(self, parfocal: Path, pair: list[Path], out: Path, options: list[str]) -> None:
        command = [parfocal, "solve", *pair, "--output", out, "--no-html", "--quiet", "--force", *options]
        subprocess.run(command, check=True)
        report = json.loads((out / "report.json").read_text())
        self.converged, self.scale_deviation = report["converged"], report["scale_deviation"]
        self.energy = next(value for value in reversed(report["levels"][-1]["energy"]) if value is not None)
        self.v = read_field(out / "relative_blur.exr")
        self.is_measured = read_field(out / "uncertainty.exr") < NOT_MEASURED
        found = report.get("parallax", {"across": [0, 0], "deviation": {"across": [0, 0]}})
        self.p, self.deviation = (np.array(of["across"]) for of in (found, found["deviation"]))


def measure_relief(parfocal: Path, out: Path, size: int, seeds: int, moves: tuple[int, ...]) -> None:
    """Prints V and p of generated reliefs."""
    print("| px wide | noise | near to far, px | found | V rms, px² | over that without movement | p off, % | in its deviations |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for noise in NOISES:
        still: dict[int, float] = {}
        for moved in moves:
            rows = []
            for seed in range(1, seeds + 1):
                i1, i2, v, p = relief(size, moved, seed)
                random = np.random.default_rng(seed)
                pair = [out / "i1.png", out / "i2.png"]
                out.mkdir(parents=True, exist_ok=True)
                for file, image in zip(pair, (i1, i2), strict=True):
                    # Room for noise: 16 bits hold 0 to 1.
                    write_grey(file, 0.05 + 0.9 * image + 0.9 * noise * random.standard_normal(image.shape))
                solved = Solved(parfocal, pair, out / "solved", [])
                rms = blur_rms(solved.v, v)
                still.setdefault(seed, rms)
                off, found = solved.p - p, bool(solved.p.any())
                share = 100 * np.hypot(*off) / np.hypot(*p) if moved and found else math.nan
                own = np.max(np.abs(off) / solved.deviation) if moved and found else math.nan
                rows.append((found and solved.converged, rms, rms / still[seed], share, own))
            found, *columns = zip(*rows, strict=True)
            of = [f"{np.nanmedian(c):.2g} ({np.nanmax(c):.2g})" if np.isfinite(c).any() else "" for c in columns]
            print(f"| {size} | {noise} | {moved} | {sum(found)} of {seeds} | {' | '.join(of)} |", flush=True)


def measure_edges(parfocal: Path, out: Path, seeds: int) -> None:
    """Prints how much of V is wrong near edges where a near surface hides a far one."""
    print("| scene | noise | wrong, % of what is measured: still, moved | ratio | measured, %: still, moved |")
    print("| --- | --- | --- | --- | --- |")
    for scene in ("card", "blocks", "bars"):
        for noise in NOISES:
            wrong, measured = np.zeros(2), np.zeros(2)
            for seed in range(1, seeds + 1):
                for n, moves in enumerate(("0,0", "2.6,1.5")):
                    folder = out / f"{scene}{n}"
                    options = ["--size", "320x240", "--noise", str(noise), "--seed", str(seed), "--camera-moves", moves]
                    command = [parfocal, "simulate", scene, "-o", folder, "--force", "--quiet", *options]
                    subprocess.run(command, check=True)
                    truth = read_field(folder / "relative_blur.exr")
                    solved = Solved(parfocal, [folder / "i1.png", folder / "i2.png"], folder / "solved", [])
                    jumps = ndimage.maximum_filter(truth, 2) - ndimage.minimum_filter(truth, 2) > EDGE
                    near = ndimage.distance_transform_edt(~jumps) <= NEAR_PX
                    near[:BORDER_PX] = near[-BORDER_PX:] = near[:, :BORDER_PX] = near[:, -BORDER_PX:] = False
                    off = np.abs(solved.v - truth)[near]
                    known = solved.is_measured[near]
                    wrong[n] += np.mean(off[known] > WRONG) / seeds
                    measured[n] += np.mean(known) / seeds
            (a, b), (c, d) = 100 * wrong, 100 * measured
            print(f"| {scene} | {noise} | {a:.1f}, {b:.1f} | {b / a:.2f} | {c:.0f}, {d:.0f} |", flush=True)


def measure_pairs(parfocal: Path, out: Path, folders: list[Path]) -> None:
    """Prints how much of pairs of frames of sweeps taken by hand is measured, and what is left of them."""
    print("| sweep | frames | parallax | p, px per px² | converged | texture measured, % | energy |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for folder in folders:
        files = sorted(folder.iterdir())
        count = len(files)
        for pair in ((round(count / 4), round(3 * count / 4)), (round(count / 3), round(2 * count / 3))):
            names = [files[k] for k in pair]
            seen = np.max([contrast(read_grey(file) ** 2.2) for file in names], axis=0)
            textured = seen > np.median(seen)
            without = None
            for how in ("off", "auto", "on"):
                solved = Solved(parfocal, names, out / f"{folder.name}-{how}", ["--parallax", how])
                without = without or solved.energy
                share = solved.is_measured[textured].mean()
                p = ", ".join(f"{p:.2f} ± {d:.2f}" for p, d in zip(solved.p, solved.deviation, strict=True))
                print(
                    f"| {folder.name} | {pair[0]}, {pair[1]} | {how} | {p if solved.p.any() else ''} | "
                    f"{'yes' if solved.converged else 'no'} | {100 * share:.0f} | {solved.energy / without:.2f} |",
                    flush=True,
                )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=["relief", "edges", "pairs"])
    parser.add_argument("folders", type=Path, nargs="*", help="of pairs: sweeps, one folder each")
    parser.add_argument("--size", type=int, default=256, help="of the relief, px")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--moves", type=int, nargs="+", default=MOVES_PX, help="of the relief, px, first 0")
    parser.add_argument("--parfocal", type=Path, required=True, help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/parallax"), help="default: %(default)s")
    arguments = parser.parse_intermixed_args()
    out = arguments.output / arguments.part
    if arguments.part == "relief":
        measure_relief(arguments.parfocal, out, arguments.size, arguments.seeds, arguments.moves)
    elif arguments.part == "edges":
        measure_edges(arguments.parfocal, out, arguments.seeds)
    else:
        measure_pairs(arguments.parfocal, out, arguments.folders)


if __name__ == "__main__":
    main()
