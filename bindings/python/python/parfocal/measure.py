"""Measures fields (relative blur, depth, focus): levels, steps, profiles, surface texture, repeated measurements.

Values are in the unit of the field, and lateral lengths in px.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native

__all__ = [
    "Estimate",
    "Interval",
    "Parameter",
    "RepeatedMaps",
    "Readings",
    "Roughness",
    "gauge_study",
    "level",
    "profile",
    "readings",
    "repeated_maps",
    "roughness",
    "step",
]


class Estimate(NamedTuple):
    """A value and its standard error, in the unit of the field; None is not determined."""

    value: float | None
    standard_error: float | None


class Interval(NamedTuple):
    """A value and its interval of 95 %, in the unit of the field; an end is None if it has no bound."""

    value: float
    low: float | None
    high: float | None


class Parameter(NamedTuple):
    """A parameter of a surface; NaN is not determined.

    `standard_deviation` is the root of the sum of the squares of `by_noise`, by the noise of each height, and
    `by_scale`, by the error that all heights have in common (None without one). `noise_bias` is how much noise adds to
    the value; it is not subtracted.
    """

    value: float
    standard_deviation: float
    by_noise: float
    by_scale: float | None
    noise_bias: float


@dataclass(frozen=True)
class Roughness:
    """The texture of a surface: areal parameters of ISO 25178-2 and profile parameters of ISO 21920-2.

    `found["Sa"]` is a `Parameter`. Units: Sa, Sq, Sp, Sv, Sz, Ra, Rq and Rz that of the heights; Ssk, Sku and Str none;
    Sdq none, or that of the heights per px without a `pixel_size`; Sdr per cent, NaN without a `pixel_size`; Sal px.
    """

    parameters: dict[str, Parameter]
    """The parameters by symbol."""
    area_px: int
    """Number of pixels of the region that the mask counts."""
    measured_px: int
    """Number of measured pixels in it."""
    profiles: int
    """Number of profiles of Ra, Rq and Rz."""
    sections: int
    """Number of section lengths of a profile."""
    str_is_upper_bound: bool
    """Whether Str is an upper bound: heights are correlated as far as the area reaches."""

    def __getitem__(self, symbol: str) -> Parameter:
        return self.parameters[symbol]


@dataclass(frozen=True)
class RepeatedMaps:
    """The noise of repeated height maps of one unmoved part, in the unit of the heights."""

    area_px: int
    """Number of pixels of the region that the mask counts."""
    measured_px: int
    """Number of them that all maps measure."""
    noise: Estimate
    """Measurement noise of a map (ISO 25178-700)."""
    pair_noise: tuple[float, float, float]
    """Median, least and greatest noise of a pair of maps."""
    repeatability_limit: Estimate
    """What two measurements of a pixel differ by in 95 of 100 cases at most."""
    shift_deviation: Interval
    """Standard deviation of the mean height between maps."""
    stated: float
    """Root mean square of the stated standard deviations."""
    seen_over_stated: Estimate
    """Differences over their stated standard deviations, root mean square: 1 if these are right. Its value is None if
    one of these is 0."""
    within: tuple[Estimate, Estimate]
    """Share of the differences within 1 and 2 of their stated deviations: 0.683 and 0.954 if these are right."""


@dataclass(frozen=True)
class Readings:
    """The scatter of repeated readings of one value, in its unit."""

    count: int
    """Number of readings."""
    mean: Estimate
    """Their mean."""
    standard_deviation: Interval
    """Their standard deviation."""
    range: float
    """The greatest reading less the least."""
    bias: Interval | None
    """The mean less the true value. This and the next two are None without a true value."""
    cg: Interval | None
    """Cg = 0.2 T / 6 s, a number; None also if all readings are equal."""
    cgk: Interval | None
    """Cgk = (0.1 T - |bias|) / 3 s, a number; None also if all readings are equal."""


def _field(values: ArrayLike) -> NDArray[np.float32]:
    field = np.asarray(np.ma.filled(np.ma.asarray(values, np.float32), np.nan))
    if field.ndim != 2 or not field.size:
        raise ValueError(f"a field has two dimensions; this array has the shape {field.shape}")
    return field


def level(values: ArrayLike, region: Sequence[int]) -> Estimate | None:
    """Returns the median of a region (x, y, width, height) after removing its tilt; None if fewer than 16 pixels are valid."""
    estimate = _native.level(_field(values), region)
    return estimate and Estimate(*estimate)


def step(values: ArrayLike, start: Sequence[int], end: Sequence[int]) -> Estimate | None:
    """Returns the level of the region `end` minus that of `start`."""
    estimate = _native.step(_field(values), start, end)
    return estimate and Estimate(*estimate)


def profile(values: ArrayLike, start: Sequence[float], end: Sequence[float], width: float = 1) -> NDArray[np.float64]:
    """Returns the values along a line between two pixels (x, y), each the mean over `width` px across; NaN where none is valid."""
    return _native.profile(_field(values), start, end, width)


def roughness(
    heights: ArrayLike,
    deviation: ArrayLike,
    *,
    common: ArrayLike | None = None,
    pixel_size: float | None = None,
    form: str = "plane",
    s_filter: float | None = None,
    l_filter: float | None = None,
    robust: bool = False,
    region: Sequence[int] | None = None,
    mask: ArrayLike | None = None,
    line: tuple[Sequence[float], Sequence[float]] | None = None,
    line_width: float = 1,
    realizations: int = 20,
    noise_window: float = 4,
) -> Roughness:
    """Evaluates the texture of a surface, as `parfocal roughness` does.

    heights: heights in any unit, positive towards the camera, NaN where there is none. Depth in mm grows away from the
        camera: pass `-depth`.
    deviation: their standard deviations.
    common: an error of each height of one standard deviation that all have in common, which `deviation` includes: for a
        pair `result.scale_deviation * result.relative_blur`. Where it is NaN or greater than `deviation`, there is no
        height.
    pixel_size: the size of a pixel on the surface, in the unit of the heights.
    form: what is removed first: "none" (the mean only), "plane", "quadric" or "cylinder".
    s_filter, l_filter: cutoff wavelengths, px, of the Gaussian filters that remove shorter and longer waves
        (ISO 16610-61).
    robust: whether the L-filter is the robust one (ISO 16610-71).
    region: x, y, width, height, px. Nothing outside is used.
    mask: an array of the size of the heights; pixels that are 0 do not count.
    line: the ends (x, y) of the profile of Ra, Rq and Rz, each value the mean over `line_width` px across it. Without
        one they are means over the rows.
    realizations: number of seeded realizations of noise from which standard deviations follow, 2 to 10000.
    noise_window: standard deviation of the window over which a solve averages noise, px: 4 for a pair, 2 for a sweep.
    """
    options = SimpleNamespace(
        form=form, s_filter=s_filter, l_filter=l_filter, robust=robust, region=region, mask=_mask(mask),
        line=None if line is None else (*line, line_width), pixel_size=pixel_size, realizations=realizations,
        noise_window=noise_window,
    )  # fmt: skip
    shared = None if common is None else _field(common)
    (area, measured, profiles, sections), is_bound, rows = _native.texture(
        _field(heights), _field(deviation), shared, options
    )
    parameters = {symbol: Parameter(*numbers) for symbol, *numbers in rows}
    return Roughness(parameters, area, measured, profiles, sections, is_bound)


def repeated_maps(
    heights: Iterable[ArrayLike],
    deviations: Iterable[ArrayLike],
    *,
    form: str = "none",
    region: Sequence[int] | None = None,
    mask: ArrayLike | None = None,
) -> RepeatedMaps:
    """Compares height maps of one part that was measured repeatedly and not moved, as `parfocal repeat` does.

    heights: 2 to 200 maps in any unit, NaN where there is no height.
    deviations: the standard deviations of each, without the part that all maps have in common, such as that of the
        scale of V: `np.sqrt(result.uncertainty**2 - (result.scale_deviation * result.relative_blur) ** 2)`.
    form: what is subtracted from the differences: "none" (their mean), "plane" or "quadric".
    region: x, y, width, height, px.
    mask: an array of the size of the heights; pixels that are 0 do not count.
    """
    maps = [(_field(values), _field(deviation)) for values, deviation in zip(heights, deviations, strict=True)]
    found = json.loads(_native.repeated(maps, form, region, _mask(mask)))
    return RepeatedMaps(
        area_px=found["area_px"],
        measured_px=found["measured_px"],
        noise=Estimate(**found["noise"]),
        pair_noise=tuple(found["pair_noise"]),
        repeatability_limit=Estimate(**found["repeatability_limit"]),
        shift_deviation=Interval(**found["shift_deviation"]),
        stated=found["stated"],
        seen_over_stated=Estimate(**found["seen_over_stated"]),
        within=tuple(Estimate(**share) for share in found["within"]),
    )


def readings(
    values: ArrayLike, true_value: float | None = None, tolerance_width: float | None = None
) -> Readings:
    """Evaluates repeated readings of a value; with its true value and the width T of its tolerance, a type-1 study."""
    if (true_value is None) != (tolerance_width is None):
        raise ValueError("give both true_value and tolerance_width, or neither")
    stated = None if true_value is None or tolerance_width is None else (true_value, tolerance_width)
    scatter, study = _native.readings(np.asarray(values, np.float64).ravel().tolist(), stated)
    found, of_study = json.loads(scatter), json.loads(study) if study else {}
    bias, cg, cgk = (Interval(**of_study[name]) if of_study.get(name) else None for name in ("bias", "cg", "cgk"))
    mean = Estimate(found["mean"], found["mean_standard_error"])
    deviation = Interval(**found["standard_deviation"])
    return Readings(found["count"], mean, deviation, found["range"], bias, cg, cgk)


def gauge_study(values: ArrayLike, tolerance_width: float | None = None) -> dict[str, Any]:
    """Analyses a gauge study (AIAG, MSA, 4th edition) of an array of operators x parts x trials, two or more of each.

    Returns the fields of `gauge` in repeat.json: `anova`, `components` and `categories`. Sums of squares and variances
    are in the square of the unit of the values. `tolerance_width` is in that unit.
    """
    array = np.asarray(values, np.float64)
    if array.ndim != 3:
        raise ValueError(f"a gauge study has operators x parts x trials; this array has the shape {array.shape}")
    found: dict[str, Any] = json.loads(_native.gauge(array.shape, array.ravel().tolist(), tolerance_width))
    return found


def _mask(mask: ArrayLike | None) -> NDArray[np.uint8] | None:
    return None if mask is None else np.where(np.asarray(mask) != 0, np.uint8(255), np.uint8(0))
