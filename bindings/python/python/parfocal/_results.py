"""The result types of the solves."""

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
    """One pyramid level of a solve: its size, px, and the energy after each iteration."""

    width: int
    height: int
    energy: NDArray[np.float64]


class Brightness(NamedTuple):
    """Maps a photograph's intensities to those of I1: gain · shading · value + offset.

    `shading` holds the coefficients of a polynomial over `region`, px.
    """

    gain: float
    offset: float
    shading: NDArray[np.float64]
    region: Region


@dataclass(frozen=True)
class Lens:
    """A lens in front of the sensor. Raises ValueError if it cannot exist.

    It has no field: V is taken as if the lens were the same at every place.

    focal_length: focal length, mm.
    f_number: f-number, at infinity.
    pixel_pitch: distance between pixels on the sensor, mm.
    focus: distances from the lens at which the first and the second photograph are focused, mm.
    kappa: standard deviation of the blur over its radius; 0.5 is a disk.
    telecentric: whether the lens is telecentric on the image side, so that focus does not change its magnification.
    """

    focal_length: float
    f_number: float
    pixel_pitch: float
    focus: tuple[float, float]
    kappa: float = 0.5
    telecentric: bool = False

    def __post_init__(self) -> None:
        optics = (self.focal_length, self.f_number, self.pixel_pitch)
        _native.check_lens(optics, self.focus, self.kappa, self.telecentric)


class Depth(NamedTuple):
    """Depth from the lens and its standard deviation, mm; NaN where there is none.

    `out_of_range` counts the pixels whose V the lens cannot produce. `warning` says what speaks against the lens.
    """

    depth: Field
    deviation: Field
    out_of_range: int
    warning: str | None


def _about_corner(matrix: NDArray[np.float64], photograph: tuple[int, int]) -> NDArray[np.float64]:
    """Converts T from points about the image centre to pixels whose first is (0, 0)."""
    width, height = photograph
    shift = np.array([[1, 0, (width - 1) / 2], [0, 1, (height - 1) / 2], [0, 0, 1]])
    moved: NDArray[np.float64] = shift @ matrix @ np.linalg.inv(shift)
    moved /= moved[2, 2]
    return moved


@dataclass(frozen=True, eq=False, repr=False)
class Registration:
    """The registration of a pair: I2(T x) matches I1(x)."""

    transform: NDArray[np.float64]
    """T, 3x3, for points in px from the image centre."""
    brightness: Brightness
    """Maps I2 to the brightness of I1."""
    region: Region
    """The part of I1 that the fields cover: x, y, width, height."""
    photograph: tuple[int, int]
    """Width and height of the photographs."""
    clipped_fractions: tuple[float, float]
    """Fraction of the pixels of I1 and of I2 that are clipped, of those that no mask excludes."""
    converged: bool
    """Whether the finest level settled on a solution that the images support."""
    warnings: list[str]
    """Reasons for doubt and other notes, one sentence each."""
    other_motion: str | None
    """A motion model that would fit better or as well, in words."""
    levels: list[Level]
    """The pyramid levels, coarse to fine."""
    decode: str
    """How stored values became intensities: "none" or "srgb"."""
    total_ms: float
    """Time from call to return, ms."""
    gpu_ms: float
    """Time on the device, ms."""

    @property
    def pixel_transform(self) -> NDArray[np.float64]:
        """T, 3x3, for pixel coordinates whose first pixel centre is (0, 0), as in OpenCV and scikit-image."""
        return _about_corner(self.transform, self.photograph)

    def __repr__(self) -> str:
        tx, ty = self.transform[:2, 2]
        size = "x".join(map(str, self.region[2:]))
        state = "converged" if self.converged else "not converged"
        return f"<parfocal.{type(self).__name__} {size}, T {tx:+.3f} {ty:+.3f} px, {state}, {len(self.warnings)} warnings>"


@dataclass(frozen=True, eq=False, repr=False)
class Result(Registration):
    """The result of a pair. Fields have the pixels of I1."""

    relative_blur: Field
    """V, px² of I1, positive where I2 is more blurred than I1; NaN where not valid."""
    uncertainty: Field
    """Standard deviation of V, px²; 1000 where the images do not determine V or it is at its limit, NaN where V is NaN."""
    confidence: Field
    """Confidence in V, 0 to 1, computed from the standard deviation."""
    residual: Field
    """The difference that neither blur nor T explains, intensities; NaN where V is NaN."""
    fused: Field | None
    """At each pixel the sharper photograph, linear intensities with white at 1; (height, width) or (height, width, 3).
    None with fused=False. `fused_image` has the type of the photographs."""
    dtype: np.dtype[Any]
    """The type of the photographs' samples."""
    scale: float
    """Scale of T at the image centre."""
    transform_deviation: tuple[float, float] | None
    """Standard deviation of T at the corner that is determined worst, px, and the direction in which it is, in degrees from
    the rows. None if it is not known."""
    regularization: float
    """Smoothness weight α of the finest level, stated or estimated."""
    kernel_shape: float | None
    """Shape of the estimated kernel: 0 is a Gaussian, 1 a disk. None if the kernel was stated."""
    separation: float | None
    """How far the two focus settings are apart, if it was found: the variance of the blur in one photograph of what is in
    focus in the other, px². None if the blur is Gaussian."""
    parallax: tuple[float, float, float]
    """Parallax of a camera that moved: a pixel x is displaced by `(parallax[:2] + parallax[2] * (x - c)) * V` before T maps
    it, c being the image centre. 0 if none was found."""
    parallax_deviation: tuple[float, float, float]
    """Standard deviations of these numbers."""
    scale_deviation: float
    """Standard deviation of the scale of V, as a share of V. The uncertainty includes it."""
    valid_fraction: float
    """Fraction of the pixels with a valid V, 0 to 1."""
    mean_confidence: float
    """Mean of `confidence` over the valid pixels, 0 to 1."""
    saturated_fraction: float
    """Fraction of the valid pixels at the limit of |V|."""
    unsettled_fraction: float
    """Fraction of the valid pixels below the limit of |V| that the last step moved by a tenth of their deviation."""
    unexplained_fraction: float
    """Fraction of the valid pixels that are not measured because the photographs differ by more than noise and blur."""
    noise: float
    """Standard deviation of the noise in the difference of the two photographs, intensities."""
    max_relative_blur: float
    """The limit of |V|, px², as set or as found."""

    @property
    def fused_image(self) -> NDArray[Any] | None:
        """`fused` to look at and to save: with the type, white and transfer curve of the photographs.

        None with fused=False.
        """
        return None if self.fused is None else _picture.encoded(self.fused, self.dtype, srgb=self.decode == "srgb")

    def depth(self, lens: Lens) -> Depth:
        """Computes depth, mm, through a lens."""
        optics = (lens.focal_length, lens.f_number, lens.pixel_pitch)
        fields = (self.relative_blur, self.uncertainty)
        limits = (self.scale, self.max_relative_blur)
        return Depth(*_native.depth(*fields, *limits, optics, lens.focus, lens.kappa, lens.telecentric))

    def to_xarray(self) -> xarray.Dataset:
        """Returns the fields as an xarray Dataset with units and I1's pixel coordinates. Shares memory; needs xarray."""
        fields = {
            "relative_blur": (self.relative_blur, "px2", "blur variance of I2 minus that of I1"),
            "uncertainty": (self.uncertainty, "px2", "standard deviation of relative_blur"),
            "confidence": (self.confidence, "1", "confidence"),
            "residual": (self.residual, "1", "difference that neither blur nor registration explains"),
        }
        if self.fused is not None:
            fields["fused"] = (self.fused, "1", "all-in-focus image")
        attributes = {"converged": int(self.converged), "transform": self.transform.ravel(), "warnings": self.warnings}
        return _dataset(fields, self.region, attributes)

    def _repr_html_(self) -> str:
        blur = "relative blur: yellow is nearer where I1 is focused nearer"
        pictures = [_picture.tag(_picture.colormapped(self.relative_blur), blur)]
        if self.fused is not None:
            pictures.insert(0, _picture.tag(_picture.for_display(self.fused, linear=self.decode == "srgb"), "fused"))
        return _page(repr(self), pictures, self.warnings)


@dataclass(frozen=True, eq=False, repr=False)
class Sweep:
    """The result of a focus sweep. Fields have the pixels of the reference frame."""

    focus: Field
    """The focus setting at which each pixel is sharp; NaN where it is not measured."""
    uncertainty: Field
    """Standard deviation of `focus`, in settings."""
    depth: Field | None
    """Depth, mm; None unless positions are in mm."""
    deviation: Field | None
    """Standard deviation of `depth`, mm."""
    beyond: NDArray[np.int8]
    """-1 where the focus is before the first frame, 1 where it is beyond the last, else 0."""
    fused: Field
    """The all-in-focus image, linear intensities with white at 1; (height, width) or (height, width, 3). `fused_image`
    has the type of the frames."""
    dtype: np.dtype[Any]
    """The type of the frames' samples."""
    frame: NDArray[np.uint16]
    """The frame that each pixel of `fused` comes from, counted from 1."""
    transforms: list[NDArray[np.float64]]
    """T of each frame, 3x3, for points in px from the image centre."""
    parallax: list[tuple[float, float]]
    """Parallax of each frame, of a camera that moved, px per setting: what is in focus at u is displaced by (u - m) times
    this, to the right and downwards, before T. m is the middle between the first and the last position."""
    brightness: list[Brightness]
    """Maps each frame to the brightness of the reference."""
    region: Region
    """The part of the reference that the fields cover: x, y, width, height."""
    photograph: tuple[int, int]
    """Width and height of the frames."""
    reference: int
    """Index of the reference frame among the solved frames, from 0."""
    positions: NDArray[np.float64]
    """The focus setting of each frame."""
    unit: str
    """The unit of focus settings."""
    blur_rate: float
    """Growth of the blur variance, px², with the squared distance from focus in settings."""
    clipped_fractions: list[float]
    """Fraction of the pixels of each frame that are clipped, of those that no mask excludes."""
    order: list[int]
    """For each solved frame its index among the frames passed, from 0."""
    decode: str
    """How stored values became intensities: "none" or "srgb"."""
    warnings: list[str]
    """Notes and reasons for doubt, one sentence each."""

    def __repr__(self) -> str:
        size = "x".join(map(str, self.region[2:]))
        return f"<parfocal.Sweep {size}, {len(self.transforms)} frames, {len(self.warnings)} warnings>"

    @property
    def fused_image(self) -> NDArray[Any]:
        """`fused` to look at and to save: with the type, white and transfer curve of the frames."""
        return _picture.encoded(self.fused, self.dtype, srgb=self.decode == "srgb")

    def to_xarray(self) -> xarray.Dataset:
        """Returns the fields as an xarray Dataset with units and the reference's pixel coordinates. Shares memory; needs xarray."""
        fields = {
            "focus": (self.focus, self.unit, "focus setting"),
            "uncertainty": (self.uncertainty, self.unit, "standard deviation of focus"),
            "beyond": (self.beyond, "1", "focus before the first frame or beyond the last"),
            "fused": (self.fused, "1", "all-in-focus image"),
            "frame": (self.frame, "1", "source frame of each fused pixel, from 1"),
        }
        if self.depth is not None and self.deviation is not None:
            fields["depth"] = (self.depth, "mm", "depth")
            fields["deviation"] = (self.deviation, "mm", "standard deviation of depth")
        return _dataset(fields, self.region, {"blur_rate": self.blur_rate, "warnings": self.warnings})

    def _repr_html_(self) -> str:
        # The first frame is assumed to be the nearest.
        nearness = -self.depth if self.depth is not None else -np.sign(np.ptp(self.positions[[0, -1]])) * self.focus
        pictures = [
            _picture.tag(_picture.for_display(self.fused, linear=self.decode == "srgb"), "fused"),
            _picture.tag(_picture.colormapped(nearness), "focus: yellow is the first frame"),
        ]
        return _page(repr(self), pictures, self.warnings)


def _dataset(fields: dict[str, tuple[Any, str, str]], region: Region, attributes: dict[str, Any]) -> xarray.Dataset:
    try:
        import xarray
    except ImportError as error:
        raise ImportError("to_xarray needs xarray: pip install xarray") from error
    x, y, width, height = region
    variables = {
        name: (("y", "x", "channel")[: values.ndim], values, {"units": unit, "long_name": description})
        for name, (values, unit, description) in fields.items()
    }
    coordinates = {
        "x": ("x", x + np.arange(width), {"units": "px"}),
        "y": ("y", y + np.arange(height), {"units": "px"}),
    }
    return xarray.Dataset(variables, coordinates, attributes)


def _page(title: str, pictures: list[str], warnings: list[str]) -> str:
    listed = "".join(f"<div>warning: {html.escape(warning)}</div>" for warning in warnings)
    return f"<div><div>{html.escape(title)}</div>{' '.join(pictures)}{listed}</div>"
