"""Registers two photographs with OpenCV: ECC with our pyramid, ECC with its own pyramid, and SIFT."""

from __future__ import annotations

import cv2
import numpy as np

from similarity import Similarity

# The settings with the smallest errors on the scenes, of all settings in README.md.
ECC_GAUSS_FILT_SIZE = 1
ECC_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-6)
ECC_SHORTEST_SIDE = 64
ECC_MULTI_SCALE_GAUSS_FILT_SIZE = 3
ECC_MULTI_SCALE_LEVELS = 4
ECC_MULTI_SCALE_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-8)
SIFT_RATIO = 0.7
SIFT_INLIER_PX = 0.5
SIFT_FEWEST_MATCHES = 4


class Failed(Exception):
    """The reason why a registration failed."""


def ecc(i1: np.ndarray, i2: np.ndarray) -> Similarity:
    """Runs `findTransformECC`, affine, on a Gaussian pyramid. Images are float32 with one channel and equal size."""
    pyramid = [(i1, i2)]
    while min(pyramid[-1][0].shape) >= 2 * ECC_SHORTEST_SIDE:
        pyramid.append((cv2.pyrDown(pyramid[-1][0]), cv2.pyrDown(pyramid[-1][1])))
    warp = np.eye(2, 3, dtype=np.float32)
    for template, image in reversed(pyramid):
        warp[:, 2] *= 2  # pixel i of a level is pixel 2i of the next finer one
        try:
            _, warp = cv2.findTransformECC(
                template, image, warp.copy(), cv2.MOTION_AFFINE, ECC_CRITERIA, None, ECC_GAUSS_FILT_SIZE
            )
        except cv2.error as e:
            if template is i1:  # a coarser level only improves the start; if it fails, the start is kept
                raise Failed(f"findTransformECC: {e.err}") from e
    return Similarity.nearest(warp, _size(i1))


def ecc_multi_scale(i1: np.ndarray, i2: np.ndarray) -> Similarity:
    """Runs `findTransformECCMultiScale`, affine, from identity, on bytes, with its own pyramid. Images in 0 to 1."""
    parameters = cv2.ECCParameters()
    parameters.motionType = cv2.MOTION_AFFINE
    parameters.gaussFiltSize = ECC_MULTI_SCALE_GAUSS_FILT_SIZE
    parameters.nlevels = ECC_MULTI_SCALE_LEVELS
    parameters.criteria = ECC_MULTI_SCALE_CRITERIA
    return _multi_scale(i1, i2, parameters)


def ecc_multi_scale_default(i1: np.ndarray, i2: np.ndarray) -> Similarity:
    """Runs the same with the defaults of OpenCV: 4 levels, 50 iterations to 1e-6, filter of 5 px."""
    return _multi_scale(i1, i2, cv2.ECCParameters())


def _multi_scale(i1: np.ndarray, i2: np.ndarray, parameters: cv2.ECCParameters) -> Similarity:
    in_bytes = (np.rint(255 * image).astype(np.uint8) for image in (i1, i2))
    try:
        _, warp = cv2.findTransformECCMultiScale(*in_bytes, np.eye(2, 3, dtype=np.float32), parameters)
    except cv2.error as e:
        raise Failed(f"findTransformECCMultiScale: {e.err}") from e
    return Similarity.nearest(warp, _size(i1))


def ecc_default(i1: np.ndarray, i2: np.ndarray) -> Similarity:
    """Runs `findTransformECC` with its defaults: affine, identity, one level, 50 iterations to 1e-3, filter of 5 px."""
    try:
        _, warp = cv2.findTransformECC(i1, i2, np.eye(2, 3, dtype=np.float32))
    except cv2.error as e:
        raise Failed(f"findTransformECC: {e.err}") from e
    return Similarity.nearest(warp, _size(i1))


def sift(i1: np.ndarray, i2: np.ndarray) -> Similarity:
    """Matches SIFT key-points by ratio test and cross-check. Fits a similarity by RANSAC. Images in 0 to 1."""
    detector = cv2.SIFT_create()
    (points1, descriptors1), (points2, descriptors2) = (
        detector.detectAndCompute(np.rint(255 * image).astype(np.uint8), None) for image in (i1, i2)
    )
    if min(len(points1), len(points2)) < 2:
        raise Failed(f"{len(points1)} and {len(points2)} SIFT key-points are too few")
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = {match.queryIdx: match.trainIdx for match in matcher.match(descriptors2, descriptors1)}
    matches = [
        best
        for best, second in matcher.knnMatch(descriptors1, descriptors2, k=2)
        if best.distance < SIFT_RATIO * second.distance and back[best.trainIdx] == best.queryIdx
    ]
    if len(matches) < SIFT_FEWEST_MATCHES:
        raise Failed(f"{len(matches)} SIFT matches are too few")
    cv2.setRNGSeed(1)
    affine, _ = cv2.estimateAffinePartial2D(
        np.array([points1[match.queryIdx].pt for match in matches]),
        np.array([points2[match.trainIdx].pt for match in matches]),
        method=cv2.RANSAC,
        ransacReprojThreshold=SIFT_INLIER_PX,
        maxIters=5000,
        confidence=0.999,
        refineIters=50,
    )
    if affine is None:
        raise Failed(f"no similarity fits {len(matches)} SIFT matches")
    return Similarity.nearest(affine, _size(i1))


def _size(image: np.ndarray) -> tuple[int, int]:
    return image.shape[1], image.shape[0]
