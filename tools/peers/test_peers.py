"""Tests that OpenCV and parfocal use equal conventions, on a picture in closed form: tools/peers/run --check."""

from __future__ import annotations

import unittest
from collections.abc import Callable

import numpy as np

import registration
import report
from images import blur_rms, displaced
from similarity import Similarity

SIZE = (320, 240)
TRUTH = Similarity(3.2, -2.1, 0.6, 1.015)


def picture(transform: Similarity) -> np.ndarray:
    """Returns I2 with I2(T x) = I1(x): waves and blobs, evaluated at T⁻¹ x without resampling."""
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    matrix = np.vstack([transform.affine(SIZE), [0, 0, 1]])
    x, y, _ = np.tensordot(np.linalg.inv(matrix), np.stack([x, y, np.ones_like(x)]), 1)
    random = np.random.default_rng(1)
    value = np.full(x.shape, 0.5)
    for _ in range(40):
        angle, phase, wave = random.uniform(0, 2 * np.pi), random.uniform(0, 2 * np.pi), random.uniform(12, 80)
        value += 0.01 * np.cos(2 * np.pi / wave * (x * np.cos(angle) + y * np.sin(angle)) + phase)
    for _ in range(150):
        cx, cy, sigma = random.uniform(0, SIZE[0]), random.uniform(0, SIZE[1]), random.uniform(2, 5)
        value += random.choice([-0.15, 0.15]) * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma * sigma))
    return np.clip(value, 0, 1).astype(np.float32)


class Conventions(unittest.TestCase):
    def test_ecc_recovers_a_known_transform(self) -> None:
        self.assert_recovered(registration.ecc)

    def test_ecc_multi_scale_recovers_a_known_transform(self) -> None:
        self.assert_recovered(registration.ecc_multi_scale)

    def test_sift_recovers_a_known_transform(self) -> None:
        self.assert_recovered(registration.sift)

    def assert_recovered(self, register: Callable[[np.ndarray, np.ndarray], Similarity]) -> None:
        found = register(picture(Similarity()), picture(TRUTH))
        print(f"{register.__name__}: {found}, corners {found.corner_distance(TRUTH, SIZE):.4f} px")
        self.assertLess(abs(found.tx_px - TRUTH.tx_px), 0.02)
        self.assertLess(abs(found.ty_px - TRUTH.ty_px), 0.02)
        self.assertLess(found.corner_distance(TRUTH, SIZE), 0.05)

    def test_ecc_says_why_it_failed(self) -> None:
        noise = np.random.default_rng(1).random((2, 64, 64), dtype=np.float32)
        with self.assertRaisesRegex(registration.Failed, "findTransformECC: .+"):
            registration.ecc(noise[0], 1 - noise[0])
        with self.assertRaisesRegex(registration.Failed, "findTransformECCMultiScale: .+"):
            registration.ecc_multi_scale(noise[0], 1 - noise[0])

    def test_sift_says_why_it_failed(self) -> None:
        flat = np.full((64, 64), 0.5, dtype=np.float32)
        with self.assertRaisesRegex(registration.Failed, "too few"):
            registration.sift(flat, flat)

    def test_a_ratio_is_of_unified_to_the_peer_on_one_scene(self) -> None:
        def row(scene: str, system: str, corner: float) -> report.Row:
            return report.Row(scene, system, error=report.Error(0, 0, 0, 0, corner))

        rows = [row("a", "peer", 0.04), row("a", report.UNIFIED, 0.01), row("b", report.UNIFIED, 1.0)]
        self.assertEqual(report.ratios([*rows, report.Row("b", "peer", failure="why")], ["peer"]), {"a": [0.25], "b": [None]})

    def test_affine_and_back(self) -> None:
        self.assertLess(Similarity.nearest(TRUTH.affine(SIZE), SIZE).corner_distance(TRUTH, SIZE), 1e-9)

    def test_after_is_the_product(self) -> None:
        first = Similarity(-1.0, 0.5, -2.0, 0.97)
        matrices = [np.vstack([t.affine(SIZE), [0, 0, 1]]) for t in (TRUTH, first)]
        np.testing.assert_allclose(TRUTH.after(first).affine(SIZE), (matrices[0] @ matrices[1])[:2], atol=1e-9)

    def test_displaced_resamples_as_the_closed_form(self) -> None:
        inner = np.s_[16:-16, 16:-16]
        error = displaced(picture(Similarity()), TRUTH) - picture(TRUTH)
        self.assertLess(np.abs(error[inner]).max(), 1e-3)

    def test_blur_rms_ignores_border_and_what_is_not_valid(self) -> None:
        truth = np.zeros((64, 64), dtype=np.float32)
        found = truth + 2
        found[:16], found[20, 20] = 1e9, np.nan
        self.assertEqual(blur_rms(found, truth), 2)


if __name__ == "__main__":
    unittest.main()
