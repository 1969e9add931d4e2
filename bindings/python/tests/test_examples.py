"""Tests of the examples: the notebook and the napari plugin."""

import ast
import importlib
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from test_parfocal import FAR, NEAR, ROOT, as_kind, photograph, write

EXAMPLES = ROOT / "bindings/python/examples"


def test_the_notebook_runs(monkeypatch):
    monkeypatch.chdir(EXAMPLES)
    notebook = json.loads((EXAMPLES / "heatsink.ipynb").read_text())
    names, outputs = {}, []
    for cell in notebook["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert cell["outputs"] == [] and cell["execution_count"] is None, "strip the outputs"
        # Like a Jupyter kernel, shows the last line of a cell if it is an expression. Installing Jupyter takes longer
        # than all tests.
        body = ast.parse("".join(cell["source"])).body
        last = body.pop() if isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), "cell", "exec"), names)
        if last:
            outputs.append(eval(compile(ast.Expression(last.value), "cell", "eval"), names))
    assert names["result"].converged and names["step"].value > 5 * names["step"].standard_error
    assert sum("data:image/png" in one._repr_html_() for one in outputs if isinstance(one, type(names["result"]))) == 1


@pytest.fixture
def plugin(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES / "napari-parfocal")
    return importlib.import_module("napari_parfocal")


def test_napari_reads_photographs(plugin, tmp_path):
    files = [str(tmp_path / f"{n}.pgm") for n in range(3)]
    for n, file in enumerate(files):
        write(Path(file), as_kind(NEAR + n / 100, np.uint16, False))
    ((data, shown, kind),) = plugin.reader(files)(files[::-1])
    assert data.shape == (3, *NEAR.shape) and data.dtype == np.uint16 and kind == "image" and shown == {"name": "0", "rgb": False}
    assert data[0].mean() < data[1].mean() < data[2].mean()
    assert plugin.reader(files[1])(files[1])[0][0].shape == NEAR.shape
    write(tmp_path / "0.pgm", as_kind(NEAR[:50], np.uint16, False))
    with pytest.raises(ValueError, match="0.pgm and the others differ"):
        plugin.reader(files)(files)
    # Every function in the manifest exists.
    manifest = (EXAMPLES / "napari-parfocal/napari_parfocal/napari.yaml").read_text()
    functions = re.findall(r"python_name: napari_parfocal:(\w+)", manifest)
    assert len(functions) == 3 and all(callable(getattr(plugin, name)) for name in functions)


def test_napari_solves(plugin):
    def layer(data):
        return SimpleNamespace(data=data)

    fused, blur, deviation = plugin.pair(layer(NEAR), layer(FAR), max_relative_blur=9)
    assert abs(np.nanmedian(blur[0]) - 1) < 0.05 and blur[1]["colormap"] == "viridis"
    assert fused[0].shape == deviation[0].shape == NEAR.shape and fused[1]["translate"] == (0, 0)
    frames = np.stack([photograph(0.3 + (n - 1.2) ** 2, (0.1 * n, 0)) for n in range(4)])
    _, depth = plugin.sweep(layer(frames), first=5.0, step=0.1, in_mm=True)
    assert depth[1]["name"] == "depth, mm" and depth[1]["metadata"] == {"warnings": []}
    assert abs(np.nanmedian(depth[0]) - 5.12) < 0.02
