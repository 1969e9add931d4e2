"""Solves the pair in data/heatsink at a quarter of its size and writes the result as an HTML page."""

from pathlib import Path

import numpy as np
import parfocal
from PIL import Image

folder = Path(__file__).resolve().parents[3] / "data/heatsink"
i1, i2 = (np.asarray(Image.open(folder / name).convert("RGB").reduce(4)) for name in ("frame_15.png", "frame_30.png"))

result = parfocal.solve(i1, i2)

print(result)
print(f"V from {np.nanmin(result.relative_blur):.2f} to {np.nanmax(result.relative_blur):.2f} px²")
for warning in result.warnings:
    print("warning:", warning)

Path("pair.html").write_text(f"<!doctype html><meta charset=utf-8>{result._repr_html_()}")
print("wrote pair.html")
