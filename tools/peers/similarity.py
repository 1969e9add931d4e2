"""The similarity of parfocal: T x = c + s R(θ) (x - c) + t with the image centre c. I2(T x) corresponds to I1(x)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

Size = tuple[int, int]
"""Width and height, px."""


@dataclass(frozen=True)
class Similarity:
    """Translation in px to the right and down, rotation in degrees from x towards y, and scale, about the centre."""

    tx_px: float = 0.0
    ty_px: float = 0.0
    rotation_deg: float = 0.0
    scale: float = 1.0

    @classmethod
    def nearest(cls, affine: np.ndarray, size: Size) -> Similarity:
        """Returns the least-squares fit of a similarity to `affine` over the pixels of an image of this size.

        `affine` is the 2x3 matrix of OpenCV: x' = A x + b. Pixel centres are at integers; the first is the origin.
        """
        linear, shift = affine[:, :2].astype(float), affine[:, 2].astype(float)
        centre = _centre(size)
        xx, yy = ((n * n - 1) / 12 for n in size)  # mean squares of x - c and y - c over the pixels
        a = (linear[0, 0] * xx + linear[1, 1] * yy) / (xx + yy)
        b = (linear[1, 0] * xx - linear[0, 1] * yy) / (xx + yy)
        t = linear @ centre + shift - centre
        return cls(float(t[0]), float(t[1]), math.degrees(math.atan2(b, a)), math.hypot(a, b))

    def affine(self, size: Size) -> np.ndarray:
        """Returns the 2x3 matrix of OpenCV for the same map."""
        linear, centre = self.linear(), _centre(size)
        return np.column_stack([linear, centre - linear @ centre + [self.tx_px, self.ty_px]])

    def linear(self) -> np.ndarray:
        """s R(θ)."""
        angle = math.radians(self.rotation_deg)
        cos, sin = self.scale * math.cos(angle), self.scale * math.sin(angle)
        return np.array([[cos, -sin], [sin, cos]])

    def after(self, first: Similarity) -> Similarity:
        """Returns the similarity that applies `first` and then `self`."""
        tx, ty = self.linear() @ [first.tx_px, first.ty_px] + [self.tx_px, self.ty_px]
        rotation, scale = self.rotation_deg + first.rotation_deg, self.scale * first.scale
        return Similarity(float(tx), float(ty), rotation, scale)

    def corner_distance(self, other: Similarity, size: Size) -> float:
        """Returns the largest distance, px, between the positions that the two give a corner of the image."""
        width, height = size
        corners = np.array([[x, y, 1] for x in (0, width - 1) for y in (0, height - 1)]).T
        apart = (self.affine(size) - other.affine(size)) @ corners
        return float(np.hypot(*apart).max())


def _centre(size: Size) -> np.ndarray:
    return (np.array(size) - 1) / 2
