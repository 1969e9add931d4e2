"""Writes the results of all systems as JSON and as tables in the format of `tools/evaluate`."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from similarity import Similarity, Size

DASH = "–"
UNIFIED = "parfocal unified"


@dataclass(frozen=True)
class Error:
    """The estimate minus the truth."""

    tx_px: float
    ty_px: float
    rotation_deg: float
    scale_percent: float
    corner_px: float

    @classmethod
    def of(cls, found: Similarity, truth: Similarity, size: Size) -> Error:
        return cls(
            found.tx_px - truth.tx_px,
            found.ty_px - truth.ty_px,
            found.rotation_deg - truth.rotation_deg,
            100 * (found.scale - truth.scale),
            found.corner_distance(truth, size),
        )


@dataclass(frozen=True)
class Row:
    """The result of one system on one scene. A field is None without a truth, or after the failure `failure`."""

    scene: str
    system: str
    transform: Similarity | None = None
    error: Error | None = None
    v_rms_px2: float | None = None
    registration_seconds: float | None = None
    solve_seconds: float | None = None
    from_unified_px: float | None = None
    failure: str | None = None


def write(out: Path, versions: dict[str, str], scenes: list[Row], real: list[Row], peers: list[str]) -> None:
    """Writes peers.json and peers.md, each under a temporary name first."""
    results = {"versions": versions, "registration": _plain(scenes), "real": _plain(real)}
    replace(out / "peers.json", json.dumps(results, indent=2) + "\n")
    replace(out / "peers.md", markdown(versions, scenes, real, peers))


def ratios(rows: list[Row], peers: list[str]) -> dict[str, list[float | None]]:
    """Returns, for each scene, the corner error of unified divided by that of each peer. None if either failed."""
    corners = {(row.scene, row.system): row.error.corner_px for row in rows if row.error}

    def ratio(scene: str, peer: str) -> float | None:
        ours, theirs = corners.get((scene, UNIFIED)), corners.get((scene, peer))
        return ours / theirs if ours is not None and theirs else None

    return {scene: [ratio(scene, peer) for peer in peers] for scene in dict.fromkeys(row.scene for row in rows)}


def markdown(versions: dict[str, str], scenes: list[Row], real: list[Row], peers: list[str]) -> str:
    """Returns all tables, and the reasons of failures below them."""
    parts = ["# Peers", "Errors against the truth, found less true. V: root mean square, 16 px border left out."]
    parts.append(table("scene|system|t_x px|t_y px|θ °|s %|corner px|V rms px²|seconds", map(_scene_cells, scenes)))
    parts.append("Unified's corner error over that of each peer; at most 0.5 is asked for.")
    names = [peer.removesuffix(" → aligned") for peer in peers]
    rows = [[scene, *map(number, found)] for scene, found in ratios(scenes, peers).items()]
    parts.append(table("|".join(["scene", *names]), rows))
    if real:
        parts.append("Real pairs have no truth: T itself, and how far it puts a corner from where unified puts it.")
        parts.append(table("pair|system|t_x px|t_y px|θ °|s|from unified px|seconds", map(_real_cells, real)))
    parts += [f"{row.scene}, {row.system}: {row.failure}" for row in scenes + real if row.failure]
    parts.append("Seconds: registration, then solve. " + ", ".join(f"{k} {v}" for k, v in versions.items()) + ".")
    return "\n\n".join(parts) + "\n"


def _scene_cells(row: Row) -> list[str]:
    errors = asdict(row.error).values() if row.error else [None] * 5
    return [row.scene, row.system, *map(number, errors), number(row.v_rms_px2), _seconds(row)]


def _real_cells(row: Row) -> list[str]:
    transform = [f"{v:.4f}" for v in asdict(row.transform).values()] if row.transform else [DASH] * 4
    return [row.scene, row.system, *transform, number(row.from_unified_px), _seconds(row)]


def _seconds(row: Row) -> str:
    parts = [s for s in (row.registration_seconds, row.solve_seconds) if s is not None]
    return " + ".join(f"{s:.2f}" for s in parts) or DASH


def number(value: float | None) -> str:
    """Formats a number with three significant digits."""
    if value is None or not math.isfinite(value):
        return DASH
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    return f"{value:.{max(2 - exponent, 0)}f}" if -7 <= exponent <= 5 else f"{value:.2e}"


def table(columns: str, rows: Iterable[list[str]]) -> str:
    """Returns a Markdown table. `|` separates the names of the columns."""
    head = columns.split("|")
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [head, ["---"] * len(head), *rows])


def _plain(rows: list[Row]) -> list[dict[str, object]]:
    return [asdict(row) for row in rows]


def replace(path: Path, text: str) -> None:
    """Writes a file under a temporary name, then renames it."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)
