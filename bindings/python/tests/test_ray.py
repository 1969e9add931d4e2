"""Tests of parfocal.ray on a local cluster of two workers. Some tests kill a worker."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest
import xarray
from pyarrow import parquet

# Ray sends no usage statistics and uses only the loopback address, as on macOS. It reads these variables at import.
os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}
import ray

import parfocal.ray
from test_parfocal import FAR, NEAR, ROOT, SIZE, as_kind, photograph, write

SETTINGS = {"max_relative_blur": 9, "outer_iterations": 20}


@pytest.fixture(scope="module", autouse=True)
def cluster():
    ray.init(num_cpus=2, num_gpus=0, include_dashboard=False, log_to_driver=False)
    assert ray.nodes()[0]["NodeManagerAddress"] == "127.0.0.1"
    yield
    ray.shutdown()


@pytest.fixture
def shots(tmp_path):
    """Writes two pairs to files."""
    for name in ("1", "2"):
        (tmp_path / name).mkdir()
        write(tmp_path / name / "near.png", as_kind(NEAR, np.uint16, False))
        write(tmp_path / name / "far.png", as_kind(FAR, np.uint16, False))
    return [(tmp_path / name / "near.png", tmp_path / name / "far.png") for name in ("1", "2")]


def test_no_row_is_lost_if_a_worker_is_killed():
    kill = True
    rows = []
    for row in parfocal.ray.map([(NEAR, FAR)] * 6, actors=2, **SETTINGS):
        rows.append(row)
        if kill:
            # The worker already has its next input.
            os.kill(row["process"], signal.SIGKILL)
            kill = False
    assert sorted(row["input"] for row in rows) == list(range(6))
    assert [row["error"] for row in rows] == [None] * 6 and len({row["process"] for row in rows}) == 3
    alone = parfocal.solve(NEAR, FAR, **SETTINGS)
    for row in rows:
        assert row["converged"] == alone.converged and row["transforms"] == [alone.transform.ravel().tolist()]
        assert row["median"] == np.nanmedian(alone.relative_blur) and row["unit"] == "px2"


def test_an_input_that_fails_is_a_row_with_an_error(tmp_path):
    class Deadly:
        """An array that ends the process that converts it."""

        def __array__(self, *_, **__):
            os._exit(1)

    frames = [photograph(0.3 + (n - 1.2) ** 2, (0.1 * n, 0)) for n in range(4)]
    inputs = [(Deadly(), FAR), (NEAR, FAR[:70]), (tmp_path / "none.png", FAR), (NEAR,), frames, (NEAR, FAR)]
    rows = sorted(parfocal.ray.map(inputs, retries=1, **SETTINGS), key=lambda row: row["input"])
    errors = [row["error"] for row in rows]
    assert "the worker died" in errors[0] and "ValueError" in errors[1] and "none.png" in errors[2] and "pair" in errors[3]
    assert errors[4:] == [None, None] and rows[4]["unit"] == "settings" and abs(rows[4]["median"] - 1.2) < 0.1
    assert rows[4]["converged"] is None and len(rows[4]["transforms"]) == 4
    with pytest.raises(TypeError, match="did you mean max_relative_blur"):
        parfocal.ray.map([], max_relativ_blur=9)
    with pytest.raises(ValueError, match="into="):
        parfocal.ray.map([], fields=["depth"])


def test_rows_and_fields_are_written_once(shots, tmp_path):
    lens = parfocal.Lens(50, 4, 0.0075, (300, 310), telecentric=True)
    options = {"fields": ["relative_blur", "depth"], "lens": lens} | SETTINGS
    into = tmp_path / "results"
    urls = [[path.as_uri() for path in shot] for shot in shots]
    assert parfocal.ray.write(urls[:1], into, **options)["error"] == 0
    with pytest.raises(FileExistsError, match="resume=True"):
        parfocal.ray.write(urls, into, **options)
    with pytest.raises(FileExistsError, match="fields exists"):
        parfocal.ray.map(urls, into=into, **options)
    with pytest.raises(ValueError, match="of other inputs"):
        parfocal.ray.write(urls[1:], into, resume=True, **options)
    assert sum(parfocal.ray.write(urls, into, resume=True, **options).values()) == 1
    names = sorted(path.relative_to(into).as_posix() for path in into.glob("*/*"))
    assert names == ["fields/00000000.zarr", "fields/00000001.zarr", "rows/000000.parquet", "rows/000001.parquet"]
    rows = parquet.read_table(into / "rows").to_pylist()
    assert [(row["input"], row["frames"]) for row in rows] == list(enumerate(urls))
    alone = parfocal.solve(*map(parfocal.read, shots[0]), **SETTINGS)
    for row in rows:
        kept = xarray.open_zarr(row["path"], consolidated=False)
        assert set(kept) == {"relative_blur", "depth"} and kept.depth.units == "mm" and kept.sizes["x"] == SIZE[0]
        assert np.array_equal(kept.relative_blur.values, alone.relative_blur, equal_nan=True)
        assert row["unit"] == "mm" and 300 < row["median"] < 310 and row["region"] == [0, 0, *SIZE]


def test_a_gpu_is_found_by_its_uuid(tmp_path, monkeypatch):
    context = ray.get_runtime_context()
    monkeypatch.setattr(type(context), "get_accelerator_ids", lambda _: {"GPU": ["1"]})
    monkeypatch.setenv("PATH", str(tmp_path))
    assert parfocal.ray._device() == "1"
    tool = tmp_path / "nvidia-smi"
    tool.write_text('#!/bin/sh\n[ "$1" = --id=1 ] && echo GPU-0123abcd-0001\n')
    tool.chmod(0o755)
    assert parfocal.ray._device() == "0123abcd-0001"


@pytest.mark.parametrize("page", ["docs/guide/src/ray.md", "bindings/python/README.md"])
def test_examples_of_the_guide_run(page, shots, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = (ROOT / page).read_text().split("```python\n")[1:]
    shown = [block.split("```")[0] for block in blocks if "parfocal.ray" in block]
    exec("".join(shown), {"lens": parfocal.Lens(50, 4, 0.0075, (300, 310))})
    assert shown and Path("results/rows/000000.parquet").exists()
