"""Pairs and focus sweeps over a Ray cluster: one actor a device, exactly one row an input, whatever becomes of the workers.

    for row in parfocal.ray.map([("1/near.png", "1/far.png"), ("2/near.png", "2/far.png")], max_relative_blur=36):
        print(row["input"], row["converged"], row["median"], row["unit"])

An input is the frames of a pair or, from three on, of a sweep: arrays, or paths and URLs that fsspec knows, such as
"s3://shots/near.png". Needs what the extra parfocal[ray] brings: Ray, fsspec, PyArrow, xarray and Zarr.
"""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, Union

import fsspec
import numpy as np
import ray
from numpy.typing import NDArray

import parfocal

from ._solves import check_settings

__all__ = ["map", "write"]

Frames = Sequence[Union[str, "os.PathLike[str]", NDArray[Any]]]
Row = dict[str, Any]

# Rows of a file of Parquet: what a driver that dies loses, against files of which a million inputs make 4000.
_ROWS = 256

# What `solve` and `stack` take that is no setting.
_OF_CALLS = frozenset(["crop_valid", "mask", "positions", "reference", "region", "unit"])

# What a row holds, by the names of Arrow's types.
_COLUMNS = {
    "input": "int64",
    "frames": ["string"],
    "error": "string",
    "converged": "bool",
    "transforms": [["float64"]],
    "region": ["int32"],
    "warnings": ["string"],
    "median": "float64",
    "unit": "string",
    "valid_fraction": "float64",
    "mean_confidence": "float64",
    "saturated_fraction": "float64",
    "path": "string",
    "device": "string",
    "host": "string",
    "process": "int64",
}


class _Plan(NamedTuple):
    """What workers do with each input."""

    fields: Sequence[str]
    into: str | None
    lens: parfocal.Lens | None
    arguments: dict[str, Any]


def map(
    inputs: Iterable[Frames],
    *,
    into: str | os.PathLike[str] | None = None,
    fields: Sequence[str] = (),
    lens: parfocal.Lens | None = None,
    actors: int | None = None,
    num_gpus: float | None = None,
    retries: int = 3,
    **arguments: Any,
) -> Iterator[Row]:
    """Solves each input by `parfocal.solve` or `parfocal.stack`, which take the further arguments; yields a row an input as they
    finish, in any order, and draws inputs as workers are free.

    A row is a dictionary: `input`, counted from 0; `frames`, their paths; `error`, why there is nothing else, or None; `converged`,
    of pairs; `transforms`, 9 numbers each, row by row; `region`; `warnings`; `median` of depth or what there is instead, in `unit`;
    `valid_fraction`; `mean_confidence` and `saturated_fraction` of pairs; `path` of the fields; `device`, `host` and `process`.

    fields: what to keep of each pixel, by the names of `to_xarray`, with a lens also `depth` and `deviation`, in Zarr groups
    `into`/fields/NNNNNNNN.zarr. actors: as many as the cluster's GPUs allow, or one. num_gpus: of each actor, 1 where there are any;
    with 0.5 one reads while another solves. retries: of an input whose worker died, whose device failed or whose URL could not be
    read; after these, and at once for what is no photograph, the row tells the error. Raises FileExistsError where there are fields.
    """
    plan = _Plan(fields, None if into is None else _absolute(into), lens, arguments)
    return _rows(enumerate(inputs), plan, actors, num_gpus, retries)


def write(
    inputs: Iterable[Frames],
    into: str | os.PathLike[str],
    *,
    fields: Sequence[str] = (),
    lens: parfocal.Lens | None = None,
    actors: int | None = None,
    num_gpus: float | None = None,
    retries: int = 3,
    resume: bool = False,
    **arguments: Any,
) -> dict[str, int]:
    """As `map`, to files: rows as `into`/rows/NNNNNN.parquet, of inputs whose fields are whole. How many rows were
    written that are `solved`, `not_converged`, `error`.

    resume: goes on with the same inputs where there are rows or fields, as after a driver that died; without it these are a
    FileExistsError, and with other inputs a ValueError.
    """
    store = _Store(_absolute(into))
    if store.files and not resume:
        raise FileExistsError(f"{into} holds rows: resume=True goes on with them; or take another place")
    done = store.inputs()

    def missing() -> Iterator[tuple[int, Frames]]:
        for number, frames in enumerate(inputs):
            if number not in done:
                yield number, frames
            elif done[number] != _paths(frames):
                raise ValueError(f"{into} holds rows of other inputs: {number} was {done[number]}, and is {_paths(frames)}")

    counts = {"solved": 0, "not_converged": 0, "error": 0}
    rows = _rows(missing(), _Plan(fields, _absolute(into), lens, arguments), actors, num_gpus, retries, resume)
    while part := list(itertools.islice(rows, _ROWS)):
        store.add(part)
        for row in part:
            counts["error" if row["error"] else "not_converged" if row["converged"] is False else "solved"] += 1
    return counts


def _rows(
    inputs: Iterable[tuple[int, Frames]],
    plan: _Plan,
    actors: int | None,
    num_gpus: float | None,
    retries: int,
    resume: bool = False,
) -> Iterator[Row]:
    if plan.fields and plan.into is None:
        raise ValueError("fields need a place: into=, a folder or a URL")
    if plan.fields and not resume:
        place, folder = fsspec.core.url_to_fs(f"{plan.into}/fields")
        if place.exists(folder):
            raise FileExistsError(f"{folder} is there: write(..., resume=True) goes on with it; or take another place")
    # Now, and not once an input.
    check_settings({name: value for name, value in plan.arguments.items() if name not in _OF_CALLS})
    if not ray.is_initialized():
        ray.init(include_dashboard=False)
    there = ray.cluster_resources().get("GPU", 0)
    each = min(there, 1) if num_gpus is None else num_gpus
    count = actors or max(1, int(there / each) if each else 1)
    options = {"num_gpus": each, "max_restarts": -1, "max_task_retries": retries}
    return _finished(inputs, [_Worker.options(**options).remote(plan) for _ in range(count)])


def _finished(inputs: Iterable[tuple[int, Frames]], free: list[Any]) -> Iterator[Row]:
    """Rows of inputs, one at a time a worker: what a worker's end costs is the input at hand."""
    workers, running = list(free), {}

    def finish() -> Row:
        (done,), _ = ray.wait(list(running))
        worker, row = running.pop(done)
        free.append(worker)
        try:
            return row | ray.get(done)
        except ray.exceptions.RayError as error:
            return row | {"error": _told(error)}

    try:
        for number, frames in inputs:
            # The worker has its next input before the caller has the row.
            row = None if free else finish()
            worker = free.pop()
            paths = _paths(frames)
            sent = worker.solve.remote(number, [path or frame for path, frame in zip(paths, frames)])
            running[sent] = worker, dict.fromkeys(_COLUMNS) | {"input": number, "frames": paths}
            if row:
                yield row
        while running:
            yield finish()
    finally:
        for worker in workers:
            ray.kill(worker)


@ray.remote
class _Worker:
    """A device. It is opened with the first input, so that what is wrong with it is told as an input's error."""

    def __init__(self, plan: _Plan) -> None:
        self.plan = plan
        self.engine: parfocal.Engine | None = None

    @ray.method(retry_exceptions=[parfocal.DeviceError, OSError])
    def solve(self, number: int, frames: Frames) -> Row:
        self.engine = self.engine or parfocal.Engine(_device())
        solve = parfocal.stack if len(frames) > 2 else _solve
        try:
            found = solve([_read(frame) for frame in frames], engine=self.engine, **self.plan.arguments)
        except parfocal.DeviceError:
            # It is done for; the retry opens another.
            self.engine = None
            raise
        at = {"device": self.engine.name, "host": socket.gethostname(), "process": os.getpid()}
        return _summary(found, self.plan, number) | at


def _device() -> str | None:
    """The GPU that Ray lends this process. Vulkan shows all of them, whatever CUDA_VISIBLE_DEVICES says, and by its UUID each is
    the same one to both; where NVIDIA's tool is not there, by its number."""
    lent = ray.get_runtime_context().get_accelerator_ids().get("GPU", [])
    if not lent:
        return None
    asked = ["nvidia-smi", f"--id={lent[0]}", "--query-gpu=uuid", "--format=csv,noheader"]
    try:
        return subprocess.run(asked, capture_output=True, check=True, text=True).stdout.strip().removeprefix("GPU-")
    except (OSError, subprocess.CalledProcessError):
        return lent[0]


def _absolute(place: str | os.PathLike[str]) -> str:
    """The same for workers, which run in folders of their own."""
    place = os.fspath(place)
    return place if "://" in place else os.path.abspath(place)


def _paths(frames: Frames) -> list[str | None]:
    return [_absolute(frame) if isinstance(frame, (str, os.PathLike)) else None for frame in frames]


def _read(frame: str | NDArray[Any]) -> NDArray[Any]:
    if not isinstance(frame, str):
        return frame
    if "://" not in frame:
        return parfocal.read(frame)
    url, mark, page = frame.partition("#")
    place, path = fsspec.core.url_to_fs(url)
    with tempfile.TemporaryDirectory() as folder:
        copy = str(Path(folder, Path(path).name))
        place.get_file(path, copy)
        try:
            return parfocal.read(copy + mark + page)
        except ValueError as error:
            raise ValueError(str(error).replace(copy, url)) from None


def _solve(frames: list[NDArray[Any]], **arguments: Any) -> parfocal.Result:
    if len(frames) != 2:
        raise ValueError(f"an input is the two frames of a pair, or three or more of a sweep, not {len(frames)}")
    return parfocal.solve(*frames, **arguments)


def _summary(found: parfocal.Result | parfocal.Sweep, plan: _Plan, number: int) -> Row:
    row: Row = {"warnings": found.warnings, "region": list(found.region)}
    fields = {}
    if isinstance(found, parfocal.Sweep):
        shown, unit = (found.focus, found.unit) if found.depth is None else (found.depth, "mm")
        row |= {"transforms": found.transforms}
    else:
        shown, unit = found.relative_blur, "px2"
        if plan.lens:
            depth = found.depth(plan.lens)
            shown, unit = depth.depth, "mm"
            fields = {"depth": depth.depth, "deviation": depth.deviation}
            row["warnings"] = row["warnings"] + [depth.warning] * bool(depth.warning)
        row |= {"converged": found.converged, "transforms": [found.transform]}
        row |= {name: getattr(found, name) for name in ("mean_confidence", "saturated_fraction")}
    valid = np.isfinite(shown)
    row |= {"median": float(np.median(shown[valid])) if valid.any() else None, "unit": unit, "valid_fraction": float(valid.mean())}
    row["transforms"] = [transform.ravel().tolist() for transform in row["transforms"]]
    return row | {"path": _keep(found, fields, plan, number)}


def _keep(found: parfocal.Result | parfocal.Sweep, depth: dict[str, NDArray[Any]], plan: _Plan, number: int) -> str | None:
    """Writes the fields. What a worker that died left of them is written over."""
    if not plan.fields:
        return None
    kept = found.to_xarray()
    kept = kept.assign({name: (("y", "x"), values, {"units": "mm"}) for name, values in depth.items()})
    for name in set(plan.fields) - set(kept):
        raise ValueError(f"there is no field {name!r}; there are {', '.join(kept)}")
    path = f"{plan.into}/fields/{number:08}.zarr"
    kept[list(plan.fields)].to_zarr(path, mode="w", consolidated=False)
    return path


def _told(error: ray.exceptions.RayError) -> str:
    cause = getattr(error, "cause", None)
    return f"{type(cause).__name__}: {cause}" if cause else f"the worker died: {str(error).splitlines()[0]}"


class _Store:
    """Rows as files of Parquet in a folder, or what a URL takes for one."""

    def __init__(self, into: str) -> None:
        self.place, self.folder = fsspec.core.url_to_fs(f"{into}/rows")
        self.files: list[str] = sorted(self.place.glob(f"{self.folder}/*.parquet"))

    def inputs(self) -> dict[int, list[str | None]]:
        """The paths of the frames of the inputs that there are rows of."""
        from pyarrow import parquet

        read = (parquet.read_table(BytesIO(self.place.cat_file(file)), columns=["input", "frames"]) for file in self.files)
        return {row["input"]: row["frames"] for table in read for row in table.to_pylist()}

    def add(self, rows: list[Row]) -> None:
        """Writes another file, which has its name once it is whole."""
        import pyarrow
        from pyarrow import parquet

        def kind(of: Any) -> pyarrow.DataType:
            return pyarrow.list_(kind(of[0])) if isinstance(of, list) else pyarrow.type_for_alias(of)

        schema = pyarrow.schema([(name, kind(of)) for name, of in _COLUMNS.items()])
        written = BytesIO()
        parquet.write_table(pyarrow.Table.from_pylist(rows, schema), written)
        file, unfinished = f"{self.folder}/{len(self.files):06}.parquet", f"{self.folder}/_unfinished"
        self.place.makedirs(self.folder, exist_ok=True)
        self.place.pipe_file(unfinished, written.getvalue())
        self.place.mv(unfinished, file)
        self.files.append(file)
