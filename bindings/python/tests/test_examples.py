"""Tests of the examples: the notebook, verdicts by MQTT, and the napari plugin."""

import ast
import importlib
import json
import os
import queue
import re
import shutil
import socket
import subprocess
import sys
import time
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


def test_verdicts_are_published_by_mqtt(tmp_path):
    client = pytest.importorskip("paho.mqtt.client")
    broker = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if not broker:
        pytest.skip("mosquitto is missing")
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    part = {"NAME": "SN1", "TIME": "2026-01-02T03:04:05.000Z", "VERDICT": "no-go", "REASONS": "a dent"}
    part["STATUS"] = "solved"
    inspected = {"time": part["TIME"], "verdict": "no-go", "tolerance": 1.5, "unit": "mm", "regions": [], "more": 1}
    (tmp_path / "inspect.json").write_text(json.dumps(inspected))
    environment = os.environ | {f"PARFOCAL_{name}": text for name, text in part.items()} | {"MQTT_PORT": str(port)}

    def publish():
        command = [sys.executable, EXAMPLES / "mqtt.py", tmp_path]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)

    refused = publish()
    assert refused.returncode == 1
    assert refused.stderr.startswith(f"mqtt.py: the broker localhost:{port} cannot be reached")
    with subprocess.Popen([broker, "-p", str(port)], stderr=subprocess.DEVNULL) as running:
        try:
            received = queue.Queue()
            receiver = client.Client(client.CallbackAPIVersion.VERSION2)
            receiver.on_message = lambda *message: received.put(json.loads(message[2].payload))
            receiver.on_subscribe = lambda *_: received.put("subscribed")
            for _ in range(100):
                try:
                    receiver.connect("localhost", port)
                    break
                except OSError:
                    time.sleep(0.1)
            receiver.subscribe("parfocal/verdict", 1)
            receiver.loop_start()
            assert received.get(timeout=20) == "subscribed"
            published = publish()
            assert published.returncode == 0, published.stderr
            message = received.get(timeout=20)
            receiver.loop_stop()
        finally:
            running.terminate()
    expected = {"serial": "SN1", "time": part["TIME"], "verdict": "no-go", "reasons": "a dent"}
    assert message == expected | {"tolerance": 1.5, "unit": "mm", "regions": []}


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
