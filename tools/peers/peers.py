"""Registers parfocal's scenes with OpenCV, then measures V with parfocal's aligned mode; see README.md."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

import registration
import report
from images import blur_rms, displaced, read_field, read_grey, write_grey
from program import Parfocal, read_transform
from registration import Failed
from report import Error, Row
from similarity import Similarity, Size

Register = Callable[[np.ndarray, np.ndarray], Similarity]

PEERS: dict[str, Register] = {
    "ECC → aligned": registration.ecc,
    "ECC MultiScale → aligned": registration.ecc_multi_scale,
    "OpenCV SIFT → aligned": registration.sift,
}
OURS = {report.UNIFIED: "unified", "parfocal appearance": "appearance", "parfocal SIFT": "sift"}

AS_STORED = ["--decode", "none"]
"""Photographs are not linearized, because OpenCV does not linearize them either."""
HALF_GAUSSIAN = ["--kernel", "half-gaussian"]
SIGMAS_PX = ("1.0", "1.5", "2.5")
CUP_DISPLACED_BY = Similarity(1.8, 2.3, 0.2, 1.01)
REAL = {
    "heatsink": ("frame_15.png", "frame_30.png"),
    "pcb-header": ("pcb_003.jpg", "pcb_005.jpg"),
    "pcb-macro": ("pcb_003.JPG", "pcb_006.JPG"),
    "dimple": ("image05.jpg", "image09.jpg"),
    "leaves": ("02sm.png", "04sm.png"),
    "cup": ("breakfast_near.png", "breakfast_far.png"),
}


@dataclass(frozen=True)
class Case:
    """A pair with known T, its V or None, and the options of its solve."""

    scene: str
    pair: tuple[Path, Path]
    size: Size
    truth: Similarity
    blur: np.ndarray | None
    options: list[str] = field(default_factory=list)

    def blur_rms(self, found: np.ndarray) -> float | None:
        """Returns the rms error of V, px², or None if the true V is unknown."""
        return None if self.blur is None else blur_rms(found, self.blur)


def scenes() -> dict[str, tuple[list[str], list[str]]]:
    """Returns the arguments of `parfocal simulate` and the options of `parfocal solve` for each scene."""
    plain = {name: ([name], []) for name in ("plane", "relief", "steps", "cylinders")}
    half_gaussian = {
        f"{name}, σ {sigma}": ([name, "--sigma", sigma], HALF_GAUSSIAN)
        for name in ("half-gaussian-texture", "half-gaussian-dots")
        for sigma in SIGMAS_PX
    }
    return plain | half_gaussian


def cases(parfocal: Parfocal, data: Path, work: Path) -> Iterator[Case]:
    """Yields the synthetic scenes, then the displaced Cup pair if its files exist."""
    for name, (scene, options) in scenes().items():
        folder = work / name.replace(", σ ", "-")
        truth = parfocal.simulate(scene, folder)
        blur = read_field(folder / "relative_blur.exr")
        yield Case(name, (folder / "i1.png", folder / "i2.png"), size_of(blur), truth, blur, options)
    if (data / "cup").is_dir():
        yield cup_displaced(parfocal, data / "cup", work)
    for part in sorted((data / "part").glob("*/truth.json")):
        pair = (part.parent / "I1.png", part.parent / "I2.png")
        yield Case(f"part {part.parent.name}", pair, size_of(read_grey(pair[0])), read_transform(part), None)


def cup_displaced(parfocal: Parfocal, cup: Path, work: Path) -> Case:
    """Returns the Cup pair with a displaced I2. The truth is the unified solve of the original pair."""
    near, far = (cup / name for name in REAL["cup"])
    taken = parfocal.solve((near, far), work / "cup-as-taken", "unified", AS_STORED)
    moved = work / "cup-displaced.png"
    write_grey(moved, displaced(read_grey(far), CUP_DISPLACED_BY))
    return Case("cup, displaced", (near, moved), size_of(taken.blur), CUP_DISPLACED_BY.after(taken.transform), taken.blur, AS_STORED)


def size_of(image: np.ndarray) -> Size:
    """Width and height, px."""
    return image.shape[1], image.shape[0]


def peer_row(parfocal: Parfocal, case: Case, system: str, out: Path) -> Row:
    """Registers a pair with a peer, then solves it with this T held."""
    try:
        found, seconds = timed(PEERS[system], case.pair)
    except Failed as e:
        return Row(case.scene, system, failure=str(e))
    error = Error.of(found, case.truth, case.size)
    row = Row(case.scene, system, found, error, registration_seconds=seconds)
    try:
        solve = parfocal.solve_held(case.pair, out, found, case.options)
    except Failed as e:
        return replace(row, failure=str(e))
    return replace(row, v_rms_px2=case.blur_rms(solve.blur), solve_seconds=solve.seconds)


def our_row(parfocal: Parfocal, case: Case, system: str, out: Path) -> Row:
    """Solves with one of parfocal's own methods."""
    try:
        solve = parfocal.solve(case.pair, out, OURS[system], case.options)
    except Failed as e:
        return Row(case.scene, system, failure=str(e))
    error = Error.of(solve.transform, case.truth, case.size)
    rms = case.blur_rms(solve.blur)
    return Row(case.scene, system, solve.transform, error, rms, solve_seconds=solve.seconds)


def real_rows(parfocal: Parfocal, name: str, data: Path, work: Path) -> list[Row]:
    """Returns the results of the unified method and of the peers on a real pair."""
    i1, i2 = REAL[name]
    pair = (data / name / i1, data / name / i2)
    try:
        ours = parfocal.solve(pair, work / f"{name}-unified", "unified", AS_STORED)
    except Failed as e:
        return [Row(name, report.UNIFIED, failure=str(e))]
    size = size_of(ours.blur)
    rows = [Row(name, report.UNIFIED, ours.transform, from_unified_px=0.0, solve_seconds=ours.seconds)]
    for system, register in PEERS.items():
        label = system.removesuffix(" → aligned")
        try:
            found, seconds = timed(register, pair)
            apart = found.corner_distance(ours.transform, size)
            rows.append(Row(name, label, found, registration_seconds=seconds, from_unified_px=apart))
        except Failed as e:
            rows.append(Row(name, label, failure=str(e)))
    return rows


def timed(register: Register, pair: tuple[Path, Path]) -> tuple[Similarity, float]:
    """Returns a registration and its duration in seconds, without reading the images."""
    i1, i2 = map(read_grey, pair)
    start = time.perf_counter()
    found = register(i1, i2)
    return found, time.perf_counter() - start


def run(parfocal: Parfocal, data: Path, out: Path) -> None:
    """Runs every system on every pair, and writes both result files after each pair."""
    versions = {package: version(package) for package in ("opencv-python-headless", "numpy")}
    found: list[Row] = []
    real: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        for case in cases(parfocal, data, work):
            say(case.scene)
            found += [peer_row(parfocal, case, system, work / "solve") for system in PEERS]
            found += [our_row(parfocal, case, system, work / "solve") for system in OURS]
            report.write(out, versions, found, real, list(PEERS))
        for name in REAL:
            if not (data / name).is_dir():
                say(f"{data / name} is not there; its pair is left out")
                continue
            say(name)
            real += real_rows(parfocal, name, data, work)
            report.write(out, versions, found, real, list(PEERS))
    say(f"results in {out}: peers.md peers.json")


def say(line: str) -> None:
    print(f"peers: {line}", file=sys.stderr, flush=True)


def check() -> None:
    """Runs the tests in the folder of this file."""
    import unittest  # not needed otherwise

    tests = unittest.defaultTestLoader.discover(str(Path(__file__).parent))
    raise SystemExit(not unittest.TextTestRunner().run(tests).wasSuccessful())


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/peers"), help="folder for peers.md, peers.json")
    parser.add_argument("--data", type=Path, default=Path("data"), help="folder of the real pairs, one folder each")
    parser.add_argument("--parfocal", type=Path, default=Path("target/release/parfocal"), help="the program")
    parser.add_argument("--check", action="store_true", help="only test OpenCV's conventions against parfocal's")
    arguments = parser.parse_args()
    if arguments.check:
        check()
    if not arguments.parfocal.is_file():
        parser.error(f"{arguments.parfocal} is not there; build it: cargo build --release")
    arguments.output.mkdir(parents=True, exist_ok=True)
    try:
        run(Parfocal(arguments.parfocal.resolve()), arguments.data, arguments.output)
    except Failed as e:
        raise SystemExit(f"peers: {e}") from e


if __name__ == "__main__":
    main()
