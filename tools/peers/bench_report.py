"""Writes the times of all systems on each pair as JSON and as tables."""

from __future__ import annotations

import json
import platform
from dataclasses import asdict, dataclass
from pathlib import Path

from report import DASH, number, replace, table
from similarity import Size
from spread import Spread, ratios, sweep_rates
from systems import ECC, FIXED_POINT, MORE_REFINEMENT, MORE_SOR, REFINEMENT, SOR, Reading

NOTES = """\
Medians over the rounds, in brackets the least and the largest. Times are from images in memory to results in memory.
Time over ECC's: both of the same round, ECC with OpenCV's defaults; above 1 is slower. Systems differ in what they
deliver: the second column says what."""

RELAXATION_NOTE = f"""\
A sweep is one red and one black half: every pixel once. Of OpenCV from the time that {MORE_SOR} instead of {SOR} SOR
iterations add, {FIXED_POINT} times each; it solves for two unknowns a pixel, parfocal for one. Of parfocal from the
time within its passes, all levels together."""


@dataclass(frozen=True)
class Outcome:
    """The readings of a system, one per round, or none and the reason."""

    system: str
    delivers: str
    readings: list[Reading]
    failure: str | None = None

    @property
    def ms(self) -> list[float]:
        return [reading.ms for reading in self.readings]


@dataclass(frozen=True)
class PairResult:
    """The outcomes of all systems on one pair."""

    pair: str
    size: Size
    outcomes: list[Outcome]

    @property
    def pixels(self) -> int:
        return self.size[0] * self.size[1]

    def ms_of(self, system: str) -> list[float]:
        return next((outcome.ms for outcome in self.outcomes if outcome.system == system), [])

    def over_ecc(self, outcome: Outcome) -> Spread | None:
        return ratios(outcome.ms, self.ms_of(ECC))

    def relaxations(self) -> dict[str, Spread | None]:
        """Returns the Mpx-sweeps/s of the systems that use relaxation."""
        rates = {
            outcome.system: Spread.of([r.mpx_sweeps_per_s for r in outcome.readings if r.mpx_sweeps_per_s])
            for outcome in self.outcomes
        }
        rates = {system: rate for system, rate in rates.items() if rate}
        fewer, more = self.ms_of(REFINEMENT), self.ms_of(MORE_REFINEMENT)
        if fewer and more:
            sweeps = FIXED_POINT * (MORE_SOR - SOR)
            rates["OpenCV VariationalRefinement"] = sweep_rates(self.pixels, sweeps, fewer, more)
        return rates


@dataclass(frozen=True)
class Setting:
    """The environment of the runs: the processor, the number of cores used, and the versions by package."""

    cpu: str
    threads: int
    versions: dict[str, str]


def cpu() -> str:
    """Returns the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def write(out: Path, setting: Setting, results: list[PairResult]) -> None:
    """Writes bench.json and bench.md, each under a temporary name first."""
    plain = asdict(setting) | {"device": _device(results), "pairs": [_plain(result) for result in results]}
    replace(out / "bench.json", json.dumps(plain, indent=2) + "\n")
    replace(out / "bench.md", markdown(setting, results))


def markdown(setting: Setting, results: list[PairResult]) -> str:
    """Returns the tables of times and relaxation rates of each pair, and the reasons of failures below them."""
    versions = ", ".join(f"{k} {v}" for k, v in setting.versions.items())
    ran = f"{setting.threads} cores of {setting.cpu}; parfocal on {_device(results) or DASH}; {versions}."
    parts = ["# Parfocal beside OpenCV", ran, NOTES]
    for result in results:
        rounds = max((len(outcome.ms) for outcome in result.outcomes), default=0)
        parts.append(f"## {result.pair}, {result.size[0]} x {result.size[1]} px, {rounds} rounds")
        rows = [_cells(result, outcome) for outcome in result.outcomes]
        parts.append(table("system|delivers|ms|Mpx/s|time over ECC's", rows))
        if relaxations := result.relaxations():
            rows = [[name, _spread(rate)] for name, rate in relaxations.items()]
            parts += [table("red-black relaxation|Mpx-sweeps/s", rows), RELAXATION_NOTE]
        parts += [f"{o.system}: {' '.join(o.failure.split())}" for o in result.outcomes if o.failure]
    return "\n\n".join(parts) + "\n"


def _cells(result: PairResult, outcome: Outcome) -> list[str]:
    ms = Spread.of(outcome.ms)
    speed = number(result.pixels / ms.median / 1000) if ms else DASH
    return [outcome.system, outcome.delivers, _spread(ms), speed, _spread(result.over_ecc(outcome))]


def _plain(result: PairResult) -> dict[str, object]:
    systems = []
    for outcome in result.outcomes:
        ms, over_ecc = Spread.of(outcome.ms), result.over_ecc(outcome)
        systems.append(
            {
                "system": outcome.system,
                "delivers": outcome.delivers,
                "ms": ms and asdict(ms),
                "mpx_per_s": ms and result.pixels / ms.median / 1000,
                "over_ecc": over_ecc and asdict(over_ecc),
                "failure": outcome.failure,
            }
        )
    rates = {name: rate and asdict(rate) for name, rate in result.relaxations().items()}
    width, height = result.size
    return {"pair": result.pair, "width": width, "height": height, "systems": systems, "mpx_sweeps_per_s": rates}


def _device(results: list[PairResult]) -> str | None:
    readings = [reading for result in results for outcome in result.outcomes for reading in outcome.readings]
    return next((reading.device for reading in readings if reading.device), None)


def _spread(spread: Spread | None) -> str:
    return f"{number(spread.median)} ({number(spread.min)} to {number(spread.max)})" if spread else DASH
