"""What solves find."""

from __future__ import annotations

import html
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _native, _picture

if TYPE_CHECKING:
    import xarray

Field = NDArray[np.float32]
Region = tuple[int, int, int, int]


class Level(NamedTuple):
    """What one pyramid level did."""

    width: int
    height: int
    energy: NDArray[np.float64]


class Brightness(NamedTuple):
    """What brings a photograph to the brightness of I1: gain · shading · value + offset, intensities."""

    gain: float
    offset: float
    shading: NDArray[np.float64]
    region: Region


@dataclass(frozen=True)
class Lens:
    """A lens in front of the sensor, focused at `focus` mm for each of the two photographs; lengths in mm."""

    focal_length: float
    f_number: float
    pixel_pitch: float
    focus: tuple[float, float]
    kappa: float = 0.5
    telecentric: bool = False


class Depth(NamedTuple):
    """Depth from the lens and its standard deviation, mm, NaN where there is none; how many pixels have a V that is out of the
    lens' range; and what speaks against the lens."""

    depth: Field
    deviation: Field
    out_of_range: int
    warning: str | None


def _about_corner(matrix: NDArray[np.float64], photograph: tuple[int, int]) -> NDArray[np.float64]:
    """T of pixels, whose first is (0, 0), instead of points from the centre."""
    width, height = photograph
    shift = np.array([[1, 0, (width - 1) / 2], [0, 1, (height - 1) / 2], [0, 0, 1]])
    found: NDArray[np.float64] = shift @ matrix @ np.linalg.inv(shift)
    found /= found[2, 2]
    return found


@dataclass(frozen=True, eq=False, repr=False)
class Registration:
    """How I2 lies on I1: I2(T x) lines up with I1(x)."""

    transform: NDArray[np.float64]
    """T, 3x3, of points from the image centre, px."""
    brightness: Brightness
    """What brings I2 to the brightness of I1."""
    region: Region
    """The part of I1 that fields are of: x, y, width, height."""
    photograph: tuple[int, int]
    """Width and height of the photographs."""
    converged: bool
    """Whether the solve settled on an answer that the images support."""
    warnings: list[str]
    """Why not, or what else there is to know; a sentence each."""
    other_motion: str | None
    """Another motion model that would do, in words."""
    levels: list[Level]
    """Coarse to fine."""
    decode: str
    """How stored values became intensities: "none" or "srgb"."""
    total_ms: float
    """From the call to the answer."""
    gpu_ms: float
    """On the device."""

    @property
    def pixel_transform(self) -> NDArray[np.float64]:
        """T, 3x3, of pixels whose first has its centre at (0, 0), as OpenCV and scikit-image have it."""
        return _about_corner(self.transform, self.photograph)

    def __repr__(self) -> str:
        tx, ty = self.transform[:2, 2]
        size = "x".join(map(str, self.region[2:]))
        state = "converged" if self.converged else "not converged"
        return f"<parfocal.{type(self).__name__} {size}, T {tx:+.3f} {ty:+.3f} px, {state}, {len(self.warnings)} warnings>"


@dataclass(frozen=True, eq=False, repr=False)
class Result(Registration):
    """What was found of a pair; fields are on the pixels of I1."""

    relative_blur: Field
    """V, px² of I1, positive where I2 is the more blurred; NaN where not valid."""
    uncertainty: Field
    """Standard deviation of V, px²; 1000 where the images say nothing, NaN where V is."""
    confidence: Field
    """The same from 0 to 1."""
    residual: Field
    """What neither blur nor T explains, intensities; NaN where V is."""
    fused: Field | None
    """Of each pixel the sharper photograph, intensities; (height, width) or (height, width, 3). None with fused=False."""
    scale: float
    """s of T at the centre."""
    regularization: float
    """Smoothness of the finest level, stated or found."""
    kernel_shape: float | None
    """Where the kernel was to be found: 0 is a Gaussian, 1 a disk."""
    valid_fraction: float
    mean_confidence: float
    saturated_fraction: float
    """Fraction of the valid pixels at the limit of |V|."""
    max_relative_blur: float
    """That limit, px²."""

    def depth(self, lens: Lens) -> Depth:
        """Depth in mm, through a lens."""
        optics = (lens.focal_length, lens.f_number, lens.pixel_pitch)
        fields = (self.relative_blur, self.uncertainty)
        limits = (self.scale, self.max_relative_blur)
        return Depth(*_native.depth(*fields, *limits, optics, lens.focus, lens.kappa, lens.telecentric))

    def to_xarray(self) -> xarray.Dataset:
        """The fields with their units and the pixels of I1 as coordinates, over the same memory; needs xarray."""
        fields = {
            "relative_blur": (self.relative_blur, "px2", "variance of I2's blur less that of I1's"),
            "uncertainty": (self.uncertainty, "px2", "standard deviation of relative_blur"),
            "confidence": (self.confidence, "1", "confidence"),
            "residual": (self.residual, "1", "what neither blur nor registration explains"),
        }
        if self.fused is not None:
            fields["fused"] = (self.fused, "1", "all-in-focus image")
        about = {"converged": int(self.converged), "transform": self.transform.ravel(), "warnings": self.warnings}
        return _dataset(fields, self.region, about)

    def _repr_html_(self) -> str:
        blur = "relative blur: yellow is nearer where I1 is focused nearer"
        pictures = [_picture.tag(_picture.coloured(self.relative_blur), blur)]
        if self.fused is not None:
            pictures.insert(0, _picture.tag(_picture.shown(self.fused, linear=self.decode == "srgb"), "fused"))
        return _page(repr(self), pictures, self.warnings)


@dataclass(frozen=True, eq=False, repr=False)
class Sweep:
    """What was found of a focus sweep; fields are on the pixels of the reference."""

    focus: Field
    """The setting at which each pixel is in focus; NaN where none is known."""
    uncertainty: Field
    """Its standard deviation, in settings."""
    depth: Field | None
    """Depth, mm, where positions are in mm."""
    deviation: Field | None
    """Its standard deviation, mm."""
    beyond: NDArray[np.int8]
    """-1 where the focus lies before the first frame, 1 beyond the last, else 0."""
    fused: Field
    """The image sharp all over, intensities; (height, width) or (height, width, 3)."""
    frame: NDArray[np.uint16]
    """The frame that each pixel of it is of, from 1."""
    transforms: list[NDArray[np.float64]]
    """T of each frame, 3x3, of points from the image centre, px."""
    brightness: list[Brightness]
    """What brings each frame to the brightness of the reference."""
    region: Region
    """The part of the reference that fields are of: x, y, width, height."""
    photograph: tuple[int, int]
    """Width and height of the frames."""
    reference: int
    """Of the frames that were solved, from 0."""
    positions: NDArray[np.float64]
    """The setting of each frame."""
    unit: str
    """Of the settings."""
    blur_rate: float
    """By how many px² of variance blur grows with the squared distance from the focus, in settings."""
    order: list[int]
    """Which of the frames given each of those solved is, from 0."""
    decode: str
    """How stored values became intensities: "none" or "srgb"."""
    warnings: list[str]
    """What there is to know; a sentence each."""

    def __repr__(self) -> str:
        size = "x".join(map(str, self.region[2:]))
        return f"<parfocal.Sweep {size}, {len(self.transforms)} frames, {len(self.warnings)} warnings>"

    def to_xarray(self) -> xarray.Dataset:
        """The fields with their units and the pixels of the reference as coordinates, over the same memory; needs xarray."""
        fields = {
            "focus": (self.focus, self.unit, "setting in focus"),
            "uncertainty": (self.uncertainty, self.unit, "standard deviation of focus"),
            "beyond": (self.beyond, "1", "before the first frame, or beyond the last"),
            "fused": (self.fused, "1", "all-in-focus image"),
            "frame": (self.frame, "1", "frame of each pixel of fused, from 1"),
        }
        if self.depth is not None and self.deviation is not None:
            fields["depth"] = (self.depth, "mm", "depth")
            fields["deviation"] = (self.deviation, "mm", "standard deviation of depth")
        return _dataset(fields, self.region, {"blur_rate": self.blur_rate, "warnings": self.warnings})

    def _repr_html_(self) -> str:
        # The first frame is taken for the nearest, as the program does.
        nearness = -self.depth if self.depth is not None else -np.sign(np.ptp(self.positions[[0, -1]])) * self.focus
        pictures = [
            _picture.tag(_picture.shown(self.fused, linear=self.decode == "srgb"), "fused"),
            _picture.tag(_picture.coloured(nearness), "focus: yellow is the first frame"),
        ]
        return _page(repr(self), pictures, self.warnings)


def _dataset(fields: dict[str, tuple[Any, str, str]], region: Region, about: dict[str, Any]) -> xarray.Dataset:
    try:
        import xarray
    except ImportError as error:
        raise ImportError("to_xarray needs xarray: pip install xarray") from error
    x, y, width, height = region
    variables = {
        name: (("y", "x", "channel")[: values.ndim], values, {"units": unit, "long_name": words})
        for name, (values, unit, words) in fields.items()
    }
    places = {
        "x": ("x", x + np.arange(width), {"units": "px"}),
        "y": ("y", y + np.arange(height), {"units": "px"}),
    }
    return xarray.Dataset(variables, places, about)


def _page(words: str, pictures: list[str], warnings: list[str]) -> str:
    told = "".join(f"<div>warning: {html.escape(warning)}</div>" for warning in warnings)
    return f"<div><div>{html.escape(words)}</div>{' '.join(pictures)}{told}</div>"
