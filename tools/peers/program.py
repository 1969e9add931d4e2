"""Runs the program parfocal and reads the files that it writes."""

from __future__ import annotations

import json
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from images import read_field
from registration import Failed
from similarity import Similarity


@dataclass(frozen=True)
class Solve:
    """The result of a solve and its duration in seconds as parfocal reports it, without the start of the program."""

    transform: Similarity
    blur: np.ndarray
    seconds: float


@dataclass(frozen=True)
class Parfocal:
    """A build of the program."""

    path: Path

    def simulate(self, scene: list[str], out: Path) -> Similarity:
        """Renders a scene (name, then options) to i1.png, i2.png and relative_blur.exr in `out`. Returns the true T."""
        self._run(["simulate", *scene, "--output", str(out)])
        return read_transform(out / "truth.json")

    def solve(self, pair: tuple[Path, Path], out: Path, method: str, options: list[str]) -> Solve:
        """Solves a pair with a method of the program."""
        self._run(["solve", *map(str, pair), "--output", str(out), "--method", method, *options])
        report = json.loads((out / "report.json").read_text())
        blur = read_field(out / "relative_blur.exr")
        return Solve(read_transform(out / "report.json"), blur, report["timings_ms"]["total"] / 1000)

    def solve_held(self, pair: tuple[Path, Path], out: Path, transform: Similarity, options: list[str]) -> Solve:
        """Solves a pair with T held at the result of another program. Gain and offset are still solved for."""
        file = out.with_suffix(".json")
        file.write_text(json.dumps({"transform": asdict(transform)}))
        return self.solve(pair, out, "aligned", ["--transform", str(file), "--hold", *options])

    def bench(self, pair: tuple[Path, Path], method: str, truth: Path | None = None) -> dict[str, Any]:
        """Returns the report of `parfocal bench --json` on one warm solve. Aligned holds T at the truth."""
        options = ["--methods", method, "--warmup", "1", "--repeats", "1", "--json"]
        if truth:
            options += ["--transform", str(truth)]
        printed = self._run(["bench", "--pair", *map(str, pair), *options])
        try:
            return json.loads(printed)
        except json.JSONDecodeError as e:
            raise Failed(f"{self.path} bench printed no report: {e}") from e

    def _run(self, arguments: list[str]) -> str:
        done = subprocess.run([self.path, *arguments, "--quiet"], capture_output=True, text=True, check=False)
        if done.returncode:
            raise Failed(done.stderr.strip() or f"{self.path} {arguments[0]} ended with {done.returncode}")
        return done.stdout


def read_transform(path: Path) -> Similarity:
    """Reads T of I2 from a report.json or truth.json, or from a file that has only the fields of T."""
    file = json.loads(path.read_text())
    transform = file["frames"][1]["transform"] if "frames" in file else file
    return Similarity(*(transform[name] for name in ("tx_px", "ty_px", "rotation_deg", "scale")))
