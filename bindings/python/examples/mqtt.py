#!/usr/bin/env python3
"""Publishes the verdict of a part by MQTT: a program for `parfocal watch --on-done`.

Needs Python 3.10 and paho-mqtt 2 (`pip install paho-mqtt`). The broker is MQTT_HOST:MQTT_PORT, the topic MQTT_TOPIC:

    MQTT_HOST=plc.local parfocal watch incoming -o results --config line.toml --on-done ./mqtt.py

There is a verdict only with `--golden`, on the command line or in line.toml. Without it this program fails.

Each run of this program is one message of quality 1. If the broker cannot be reached, or does not confirm the message,
this program fails and `watch` runs it again later, also after a restart. So each verdict arrives at least once. A
receiver recognizes one that arrives twice by its `serial` and `time`.
"""

import json
import os
import sys
from pathlib import Path

import paho.mqtt.client as mqtt


def message(folder: Path) -> dict:
    """The verdict from the environment, with the deviating regions from inspect.json if the part was solved."""
    environment = os.environ
    found = {
        "serial": environment["PARFOCAL_NAME"],
        "time": environment["PARFOCAL_TIME"],
        "verdict": environment["PARFOCAL_VERDICT"],
        "reasons": environment["PARFOCAL_REASONS"],
    }
    report = folder / "inspect.json"
    if environment["PARFOCAL_STATUS"] == "solved" and report.exists():
        inspected = json.loads(report.read_text(encoding="utf-8"))
        # An inspection by another program may have replaced this one.
        if (inspected["time"], inspected["verdict"]) == (found["time"], found["verdict"]):
            found |= {key: inspected[key] for key in ("tolerance", "unit", "regions")}
    return found


def publish(payload: str) -> None:
    """Publishes a message, and waits until the broker has confirmed it."""
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    host, port = os.environ.get("MQTT_HOST", "localhost"), int(os.environ.get("MQTT_PORT", "1883"))
    try:
        client.connect(host, port)
    except OSError as problem:
        sys.exit(f"mqtt.py: the broker {host}:{port} cannot be reached ({problem})")
    client.loop_start()
    sent = client.publish(os.environ.get("MQTT_TOPIC", "parfocal/verdict"), payload, qos=1)
    sent.wait_for_publish(timeout=10)
    client.loop_stop()
    if not sent.is_published():
        sys.exit("mqtt.py: the broker did not confirm the message within 10 s")
    client.disconnect()


if __name__ == "__main__":
    if "PARFOCAL_VERDICT" not in os.environ:
        sys.exit("mqtt.py: there is no verdict; run it by parfocal watch --on-done, with --golden")
    publish(json.dumps(message(Path(sys.argv[1]))))
