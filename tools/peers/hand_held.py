"""Compares the focus of sweeps taken by hand with that of a plain program; see README.md.

The plain program registers each frame with its neighbour (ECC, affine, from the middle outwards) and takes the frame
with the strongest Laplacian at each place. It is rough, and knows nothing of parallax.
"""

from __future__ import annotations

import argparse
import subprocess
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, laplace
from scipy.stats import spearmanr

from images import read_field, read_grey, write_grey

KINDS = {".jpg", ".jpeg", ".png", ".tif", ".tiff"}


def registered(frames: list[np.ndarray]) -> list[np.ndarray]:
    """Resamples each frame onto the one in the middle, through its neighbours."""
    height, width = frames[0].shape
    middle = len(frames) // 2
    maps = {middle: np.eye(3, dtype=np.float32)}
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-5)
    for side in (range(middle + 1, len(frames)), range(middle - 1, -1, -1)):
        last = middle
        for k in side:
            step = np.eye(3, dtype=np.float32)
            try:
                _, found = cv2.findTransformECC(
                    frames[last], frames[k], step[:2].copy(), cv2.MOTION_AFFINE, criteria, None, 5
                )
                step[:2] = found
            except cv2.error:
                print(f"  frame {k + 1}: ECC fails; it takes the place of its neighbour")
            maps[k] = step @ maps[last]
            last = k
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return [
        cv2.warpAffine(frame, maps[k][:2], (width, height), flags=how, borderMode=cv2.BORDER_REPLICATE)
        for k, frame in enumerate(frames)
    ]


def contrast(frame: np.ndarray) -> np.ndarray:
    """Returns the energy of the Laplacian of a Gaussian of 1 px, over a Gaussian of 5 px."""
    return gaussian_filter(laplace(gaussian_filter(frame.astype(float), 1)) ** 2, 5)


def compared(parfocal: Path, folder: Path, out: Path, options: list[str]) -> str:
    """Solves one sweep by both programs and returns a row of the table."""
    files = sorted(f for f in folder.iterdir() if f.suffix.lower() in KINDS)
    if len(files) < 3:
        raise SystemExit(f"{folder}: holds {len(files)} photographs, and a sweep has three or more")
    # Linear light, nearly: the curve of a camera is not known.
    frames = [read_grey(file) ** 2.2 for file in files]
    aligned = registered(frames)
    sharpest = np.argmax([contrast(frame) for frame in aligned], axis=0)
    out.mkdir(parents=True, exist_ok=True)
    write_grey(out / "peer_focus.png", sharpest / (len(files) - 1))
    write_grey(out / "peer_fused.png", np.take_along_axis(np.stack(aligned), sharpest[None], 0)[0])
    command = [parfocal, "stack", *files, "--output", out / "parfocal", "--no-html", "--quiet", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return f"| {folder.name} | {len(files)} | refused: {done.stderr.strip()} | |"
    focus = read_field(out / "parfocal" / "focus.exr")
    if focus.shape != sharpest.shape:
        return f"| {folder.name} | {len(files)} | of another size than the files: orientation | |"
    # The half of the pixels whose sharpest frame shows most.
    seen = np.max([contrast(frame) for frame in frames], axis=0)
    textured = seen > np.median(seen)
    measured = textured & np.isfinite(focus)
    correlation = spearmanr(focus[measured], sharpest[measured]).statistic
    return f"| {folder.name} | {len(files)} | {measured.sum() / textured.sum():.2f} | {correlation:.2f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", help="sweeps, one folder each, in the order of their names")
    parser.add_argument("--parfocal", type=Path, required=True, help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/hand-held"), help="default: %(default)s")
    parser.add_argument("--options", default="", help="further options of `parfocal stack`, in one argument")
    arguments = parser.parse_args()
    print("| sweep | frames | measured | rank correlation |\n| --- | --- | --- | --- |")
    for folder in arguments.folders:
        out = arguments.output / folder.name
        print(compared(arguments.parfocal, folder, out, arguments.options.split()), flush=True)


if __name__ == "__main__":
    main()
