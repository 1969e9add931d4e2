"""Solves pairs and focus sweeps on a Ray cluster: one actor per device, exactly one row per input even if workers die.

    for row in parfocal.ray.map([("1/near.png", "1/far.png"), ("2/near.png", "2/far.png")], max_relative_blur=36):
        print(row["input"], row["converged"], row["median"], row["unit"])

An input is a sequence of frames: two for a pair, three or more for a sweep. A frame is an array, a path, or a URL that
fsspec supports, such as "s3://shots/near.png". Needs the extra parfocal[ray]: Ray, fsspec, PyArrow, xarray and Zarr.
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

# Rows per Parquet file: a driver that dies loses at most these, and a million inputs make 4000 files.
_ROWS = 256

# Arguments of `solve` and `stack` that are no settings.
_CALL_ARGUMENTS = frozenset(["crop_valid", "mask", "positions", "reference", "region", "unit"])

# The columns of a row, with the names of Arrow types.
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
    """The work of each worker."""

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
    """Solves each input with `parfocal.solve` or `parfocal.stack` and yields one row per input as they finish, in any order.

    Inputs are drawn as workers become free. Further arguments go to `solve` or `stack`.

    A row is a dictionary: `input`, counted from 0; `frames`, their paths; `error`, or None; `converged`, of pairs;
    `transforms`, 9 numbers each, row by row; `region`; `warnings`; `median` of depth, else of relative blur or focus, in
    `unit`; `valid_fraction`; `mean_confidence` and `saturated_fraction`, of pairs; `path` of the fields; `device`, `host`,
    `process`. If `error` is set, the result columns are None.

    fields: the fields to save, by the names of `to_xarray`, with a lens also `depth` and `deviation`. They are written as
    Zarr groups `into`/fields/NNNNNNNN.zarr.
    actors: the number of actors; by default as many as the cluster's GPUs allow, at least one.
    num_gpus: GPUs per actor; by default 1 if the cluster has any. With 0.5 one actor reads while another solves.
    retries: retries of an input whose worker died, whose device failed or whose URL could not be read. Then the row has the
    error; for a file that is no photograph it has it at once.

    Raises FileExistsError if `into` already has fields.
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
    """Works as `map`, but writes the rows to `into`/rows/NNNNNN.parquet, each after its fields are complete.

    Returns the numbers of rows that are `solved`, `not_converged` and `error`.

    resume: continues an earlier run with the same inputs, for example after a driver died. Raises FileExistsError if there
    are rows or fields and `resume` is False, and ValueError if the existing rows have other inputs.
    """
    store = _Store(_absolute(into))
    if store.files and not resume:
        raise FileExistsError(f"{into} holds rows: continue them with resume=True, or use another place")
    done = store.inputs()

    def missing() -> Iterator[tuple[int, Frames]]:
        for number, frames in enumerate(inputs):
            if number not in done:
                yield number, frames
            elif done[number] != _paths(frames):
                raise ValueError(f"{into} holds rows of other inputs: input {number} was {done[number]}, now {_paths(frames)}")

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
        raise ValueError("fields need a place: set into= to a folder or a URL")
    if plan.fields and not resume:
        place, folder = fsspec.core.url_to_fs(f"{plan.into}/fields")
        if place.exists(folder):
            raise FileExistsError(f"{folder} exists: continue it with write(..., resume=True), or use another place")
    # Here, so that a wrong setting fails once and not for each input.
    check_settings({name: value for name, value in plan.arguments.items() if name not in _CALL_ARGUMENTS})
    if not ray.is_initialized():
        ray.init(include_dashboard=False)
    gpus = ray.cluster_resources().get("GPU", 0)
    per_actor = min(gpus, 1) if num_gpus is None else num_gpus
    count = actors or max(1, int(gpus / per_actor) if per_actor else 1)
    options = {"num_gpus": per_actor, "max_restarts": -1, "max_task_retries": retries}
    return _finished(inputs, [_Worker.options(**options).remote(plan) for _ in range(count)])


def _finished(inputs: Iterable[tuple[int, Frames]], free: list[Any]) -> Iterator[Row]:
    """Yields finished rows. Each worker has one input at a time, so a dying worker loses one solve."""
    workers, running = list(free), {}

    def finish() -> Row:
        (done,), _ = ray.wait(list(running))
        worker, row = running.pop(done)
        free.append(worker)
        try:
            return row | ray.get(done)
        except ray.exceptions.RayError as error:
            return row | {"error": _message(error)}

    try:
        for number, frames in inputs:
            # The worker gets its next input before the caller gets the row.
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
    """An actor with one device. The first input opens the device, so that its failure is that input's error."""

    def __init__(self, plan: _Plan) -> None:
        self.plan = plan
        self.engine: parfocal.Engine | None = None

    @ray.method(retry_exceptions=[parfocal.DeviceError, OSError])
    def solve(self, number: int, frames: Frames) -> Row:
        self.engine = self.engine or parfocal.Engine(_device())
        solve = parfocal.stack if len(frames) > 2 else _solve
        try:
            result = solve([_read(frame) for frame in frames], engine=self.engine, **self.plan.arguments)
        except parfocal.DeviceError:
            # The engine is unusable; the retry opens another.
            self.engine = None
            raise
        place = {"device": self.engine.name, "host": socket.gethostname(), "process": os.getpid()}
        return _summary(result, self.plan, number) | place


def _device() -> str | None:
    """Returns the UUID of the GPU that Ray assigned to this process, or its index if nvidia-smi is missing; None without one.

    Vulkan lists all GPUs whatever CUDA_VISIBLE_DEVICES says; the UUID names the same GPU in both.
    """
    assigned = ray.get_runtime_context().get_accelerator_ids().get("GPU", [])
    if not assigned:
        return None
    query = ["nvidia-smi", f"--id={assigned[0]}", "--query-gpu=uuid", "--format=csv,noheader"]
    try:
        return subprocess.run(query, capture_output=True, check=True, text=True).stdout.strip().removeprefix("GPU-")
    except (OSError, subprocess.CalledProcessError):
        return assigned[0]


def _absolute(place: str | os.PathLike[str]) -> str:
    """Makes a path absolute, since workers run in other folders."""
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
        raise ValueError(f"an input has two frames (a pair) or three or more (a sweep), not {len(frames)}")
    return parfocal.solve(*frames, **arguments)


def _summary(result: parfocal.Result | parfocal.Sweep, plan: _Plan, number: int) -> Row:
    row: Row = {"warnings": result.warnings, "region": list(result.region)}
    fields = {}
    if isinstance(result, parfocal.Sweep):
        values, unit = (result.focus, result.unit) if result.depth is None else (result.depth, "mm")
        row |= {"transforms": result.transforms}
    else:
        values, unit = result.relative_blur, "px2"
        if plan.lens:
            depth = result.depth(plan.lens)
            values, unit = depth.depth, "mm"
            fields = {"depth": depth.depth, "deviation": depth.deviation}
            row["warnings"] = row["warnings"] + [depth.warning] * bool(depth.warning)
        row |= {"converged": result.converged, "transforms": [result.transform]}
        row |= {name: getattr(result, name) for name in ("mean_confidence", "saturated_fraction")}
    valid = np.isfinite(values)
    row |= {"median": float(np.median(values[valid])) if valid.any() else None, "unit": unit, "valid_fraction": float(valid.mean())}
    row["transforms"] = [transform.ravel().tolist() for transform in row["transforms"]]
    return row | {"path": _save(result, fields, plan, number)}


def _save(result: parfocal.Result | parfocal.Sweep, depth: dict[str, NDArray[Any]], plan: _Plan, number: int) -> str | None:
    """Writes the fields and returns their path. Overwrites the remains of a worker that died."""
    if not plan.fields:
        return None
    dataset = result.to_xarray()
    dataset = dataset.assign({name: (("y", "x"), values, {"units": "mm"}) for name, values in depth.items()})
    for name in set(plan.fields) - set(dataset):
        raise ValueError(f"there is no field {name!r}; the fields are {', '.join(dataset)}")
    path = f"{plan.into}/fields/{number:08}.zarr"
    dataset[list(plan.fields)].to_zarr(path, mode="w", consolidated=False)
    return path


def _message(error: ray.exceptions.RayError) -> str:
    cause = getattr(error, "cause", None)
    return f"{type(cause).__name__}: {cause}" if cause else f"the worker died: {str(error).splitlines()[0]}"


class _Store:
    """Parquet files of rows in a folder or at a URL."""

    def __init__(self, into: str) -> None:
        self.place, self.folder = fsspec.core.url_to_fs(f"{into}/rows")
        self.files: list[str] = sorted(self.place.glob(f"{self.folder}/*.parquet"))

    def inputs(self) -> dict[int, list[str | None]]:
        """Returns the frames' paths of each input that has a row."""
        from pyarrow import parquet

        read = (parquet.read_table(BytesIO(self.place.cat_file(file)), columns=["input", "frames"]) for file in self.files)
        return {row["input"]: row["frames"] for table in read for row in table.to_pylist()}

    def add(self, rows: list[Row]) -> None:
        """Writes another file. It gets its name once it is complete."""
        import pyarrow
        from pyarrow import parquet

        def arrow_type(name: Any) -> pyarrow.DataType:
            return pyarrow.list_(arrow_type(name[0])) if isinstance(name, list) else pyarrow.type_for_alias(name)

        schema = pyarrow.schema([(column, arrow_type(name)) for column, name in _COLUMNS.items()])
        written = BytesIO()
        parquet.write_table(pyarrow.Table.from_pylist(rows, schema), written)
        file, unfinished = f"{self.folder}/{len(self.files):06}.parquet", f"{self.folder}/_unfinished"
        self.place.makedirs(self.folder, exist_ok=True)
        self.place.pipe_file(unfinished, written.getvalue())
        self.place.mv(unfinished, file)
        self.files.append(file)
