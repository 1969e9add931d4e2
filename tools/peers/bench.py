"""Compares the times of parfocal and OpenCV on one machine. Each round runs every system once; see README.md."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import cv2

import bench_report
from bench_report import Outcome, PairResult, Setting
from images import read_grey
from program import Parfocal
from registration import Failed
from similarity import Size
from systems import Reading, System, systems

Files = tuple[Path, Path]
SMALLEST = 16
"""Width and height that parfocal takes, px."""


def rounds(entries: list[System], repeats: int) -> list[Outcome]:
    """Runs every system once per round, so that a temporary load on the machine slows all of them.

    The first round is not counted: it starts the threads of OpenCV and fills the pipeline cache of parfocal. A system
    that fails has no figures and is not run again.
    """
    readings: dict[str, list[Reading]] = {system.name: [] for system in entries}
    failures: dict[str, str] = {}
    for number in range(repeats + 1):
        say(f"round {number} of {repeats}" if number else "a round that does not count")
        for system in entries:
            if system.name in failures:
                continue
            try:
                readings[system.name].append(system.measure())
            except Failed as e:
                failures[system.name] = str(e)
                readings[system.name] = []
    return [Outcome(s.name, s.delivers, readings[s.name][1:], failures.get(s.name)) for s in entries]


def pairs(parfocal: Parfocal, arguments: argparse.Namespace, work: Path) -> Iterator[tuple[str, Size, Files, Path | None]]:
    """Yields the name, size, files and truth of each pair. A scene is rendered when it is reached."""
    if arguments.pair:
        i1, i2 = arguments.pair
        height, width = read_grey(i1).shape
        if read_grey(i2).shape != (height, width):
            raise Failed(f"{i1} and {i2} differ in size; give two images of one size")
        yield f"{i1.name}, {i2.name}", (width, height), (i1, i2), None
        return
    for width, height in arguments.sizes:
        say(f"rendering {width} x {height}")
        folder = work / f"{width}x{height}"
        parfocal.simulate(["relief", "--size", f"{width}x{height}"], folder)
        yield "relief", (width, height), (folder / "i1.png", folder / "i2.png"), folder / "truth.json"


def run(parfocal: Parfocal, arguments: argparse.Namespace) -> None:
    """Times every pair, and writes both result files after each pair."""
    versions = {package: version(package) for package in ("opencv-python-headless", "numpy")}
    results: list[PairResult] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, size, pair, truth in pairs(parfocal, arguments, Path(folder)):
            outcomes = rounds(systems(parfocal, pair, truth), arguments.repeats)
            results.append(PairResult(name, size, outcomes))
            bench_report.write(arguments.output, Setting(bench_report.cpu(), arguments.threads, versions), results)
    say(f"results in {arguments.output}: bench.md bench.json")


def bind(threads: int) -> None:
    """Limits this process and its children, and the threads of OpenCV and lavapipe, to a number of cores."""
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])
    cv2.setNumThreads(threads)
    os.environ["LP_NUM_THREADS"] = str(threads)


def say(line: str) -> None:
    print(f"bench: {line}", file=sys.stderr, flush=True)


def sizes(text: str) -> list[Size]:
    """`WxH,WxH`."""
    found = []
    for size in text.split(","):
        width, height = map(int, size.split("x"))
        if min(width, height) < SMALLEST:
            raise ValueError
        found.append((width, height))
    return found


def at_least_one(text: str) -> int:
    number = int(text)
    if number < 1:
        raise ValueError
    return number


def main() -> None:
    """The command line."""
    cores = len(os.sched_getaffinity(0))
    parser = argparse.ArgumentParser(description=__doc__)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--sizes", type=sizes, default="1024x1024", metavar="WxH,...", help="of the scene (1024x1024)")
    what.add_argument("--pair", type=Path, nargs=2, metavar=("I1", "I2"), help="these images instead of the scene")
    parser.add_argument("--repeats", type=at_least_one, default=7, metavar="N", help="rounds that count (7)")
    parser.add_argument("--threads", type=at_least_one, default=cores, metavar="N", help=f"cores (all: {cores})")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/bench"), help="folder for bench.md, bench.json")
    parser.add_argument("--parfocal", type=Path, default=Path("target/release/parfocal"), help="the program")
    arguments = parser.parse_args()
    if arguments.threads > cores:
        parser.error(f"--threads {arguments.threads}: there are {cores} cores to run on")
    if not arguments.parfocal.is_file():
        parser.error(f"{arguments.parfocal} is not there; build it: cargo build --release")
    arguments.output.mkdir(parents=True, exist_ok=True)
    bind(arguments.threads)
    try:
        run(Parfocal(arguments.parfocal.resolve()), arguments)
    except Failed as e:
        raise SystemExit(f"bench: {e}") from e


if __name__ == "__main__":
    main()
