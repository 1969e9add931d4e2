"""Tests of the statistics, rounds, tables and report parser of the bench: tools/peers/run --check."""

from __future__ import annotations

import json
import tempfile
import unittest
from functools import partial
from pathlib import Path

import cv2
import numpy as np

import bench
import bench_report
import registration
from bench_report import Outcome, PairResult, Setting
from program import Parfocal
from registration import Failed
from similarity import Similarity
from spread import Spread, ratios, sweep_rates
from systems import ECC, MORE_REFINEMENT, REFINEMENT, Reading, System, ours
from test_peers import TRUTH, picture

REPORT = {
    "device": {"name": "a device"},
    "runs": [{"solve_ms": {"median": 4321.5}, "relaxation": {"mpx_sweeps_per_s": 123.0}}],
}


def program(folder: str, script: str) -> Parfocal:
    """Writes a script that replaces the program."""
    path = Path(folder) / "parfocal"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return Parfocal(path)


class Statistics(unittest.TestCase):
    def test_spread_has_median_and_ends(self) -> None:
        self.assertEqual(Spread.of([4.0, 1.0, 2.0, 9.0]), Spread(3.0, 1.0, 9.0, [4.0, 1.0, 2.0, 9.0]))

    def test_nothing_has_no_spread(self) -> None:
        self.assertIsNone(Spread.of([]))
        self.assertIsNone(ratios([], [1.0]))
        self.assertIsNone(ratios([1.0], []))

    def test_ratios_are_of_one_round(self) -> None:
        """A machine that is three times slower in one round does not change a ratio."""
        self.assertEqual(ratios([10.0, 30.0, 10.0], [5.0, 15.0, 5.0]), Spread(2.0, 2.0, 2.0, [2.0] * 3))

    def test_ratios_of_different_rounds_are_refused(self) -> None:
        with self.assertRaises(ValueError):
            ratios([1.0, 2.0], [1.0])

    def test_sweep_rate_is_what_the_further_sweeps_cost(self) -> None:
        """100 sweeps of a megapixel take 100 ms. A round without a difference is excluded."""
        rates = sweep_rates(1_000_000, 100, [150.0, 150.0], [250.0, 150.0])
        self.assertEqual(rates, Spread(1000.0, 1000.0, 1000.0, [1000.0]))


class Rounds(unittest.TestCase):
    def test_systems_take_turns_and_the_first_round_does_not_count(self) -> None:
        order: list[str] = []

        def measure(name: str) -> Reading:
            order.append(name)
            return Reading(float(len(order)))

        a, b = bench.rounds([System(name, "", partial(measure, name)) for name in "ab"], 2)
        self.assertEqual(order, ["a", "b"] * 3)
        self.assertEqual((a.ms, b.ms), ([3.0, 5.0], [4.0, 6.0]))

    def test_a_failure_keeps_no_figures_and_stops_nobody_else(self) -> None:
        counts = {"fails": 0, "runs": 0}

        def fails() -> Reading:
            counts["fails"] += 1
            if counts["fails"] == 2:
                raise Failed("why")
            return Reading(1.0)

        failed, other = bench.rounds([System("fails", "", fails), System("runs", "", lambda: Reading(2.0))], 3)
        self.assertEqual((failed.ms, failed.failure, counts["fails"]), ([], "why", 2))
        self.assertEqual(other.ms, [2.0] * 3)


class Program(unittest.TestCase):
    def test_reads_the_report_of_a_bench(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            parfocal = program(folder, f"cat <<'END'\n{json.dumps(REPORT)}\nEND")
            unified = ours(parfocal, (Path("i1.png"), Path("i2.png")), None)[0]
            self.assertEqual(unified.measure(), Reading(4321.5, "a device", 123.0))

    def test_says_why_a_bench_failed(self) -> None:
        for script, why in (("echo no such device >&2; exit 1", "no such device"), ("echo nothing", "no report")):
            with tempfile.TemporaryDirectory() as folder, self.assertRaisesRegex(Failed, why):
                program(folder, script).bench((Path("i1.png"), Path("i2.png")), "unified")


class Tables(unittest.TestCase):
    def test_report_holds_ratios_rates_and_failures(self) -> None:
        outcomes = [
            Outcome("parfocal unified", "all", [Reading(400.0, "a device", 50.0)]),
            Outcome("parfocal aligned", "less", [], "no\nmemory"),
            Outcome(ECC, "registration", [Reading(200.0)]),
            Outcome(REFINEMENT, "flow", [Reading(150.0)]),
            Outcome(MORE_REFINEMENT, "flow", [Reading(250.0)]),
        ]
        result = PairResult("relief", (1000, 1000), outcomes)
        with tempfile.TemporaryDirectory() as folder:
            bench_report.write(Path(folder), Setting("a processor", 2, {"numpy": "1"}), [result])
            written = json.loads((Path(folder) / "bench.json").read_text())
            text = (Path(folder) / "bench.md").read_text()
            self.assertEqual(len(list(Path(folder).iterdir())), 2)
        self.assertIn("| parfocal unified | all | 400 (400 to 400) | 2.50 | 2.00 (2.00 to 2.00) |", text)
        self.assertIn("| parfocal aligned | less | – | – | – |", text)
        self.assertIn("parfocal aligned: no memory", text)
        self.assertIn("| OpenCV VariationalRefinement | 1000 (1000 to 1000) |", text)
        self.assertEqual(written["device"], "a device")
        self.assertEqual(written["pairs"][0]["systems"][0]["over_ecc"]["median"], 2.0)
        self.assertEqual(written["pairs"][0]["mpx_sweeps_per_s"]["parfocal unified"]["median"], 50.0)


class Settings(unittest.TestCase):
    def test_default_ecc_is_the_one_described(self) -> None:
        i1, i2 = picture(Similarity()), picture(TRUTH)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)
        _, warp = cv2.findTransformECC(i1, i2, np.eye(2, 3, dtype=np.float32), cv2.MOTION_AFFINE, criteria, None, 5)
        stated = Similarity.nearest(warp, (i1.shape[1], i1.shape[0]))
        self.assertEqual(registration.ecc_default(i1, i2), stated)

    def test_sizes_are_read(self) -> None:
        self.assertEqual(bench.sizes("1024x1024,640x480"), [(1024, 1024), (640, 480)])
        for wrong in ("1024", "8x8", "1024x", "axb", "1x2x3"):
            with self.assertRaises(ValueError):
                bench.sizes(wrong)


if __name__ == "__main__":
    unittest.main()
