"""`check` on simulated instruments over ptys: a healthy bench passes, and each failure is named."""

from __future__ import annotations

import contextlib
import json
import os
import re
import struct
import threading
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import sawbench.acquisition.calibration_book
import sawbench.acquisition.device_probe
import sawbench.commands.recording_session
from sawbench.acquisition.calibration_book import build_calibrated
from sawbench.acquisition.device_probe import probe_devices
from sawbench.acquisition.devices import build_devices
from sawbench.acquisition.preflight import Finding, Preflight, judge
from sawbench.acquisition.simulation.endpoints import PtyEndpoint
from sawbench.bench.config import BenchConfig, load_config
from sawbench.commands.check import describe
from sawbench.commands.main import main

from tests.rigs.resting import CONFIG, missampled, resting_bench

pytestmark = [pytest.mark.pipeline, pytest.mark.skipif(os.name != "posix", reason="this system has no pty")]
SECONDS = 1.2


def checked(rig, *, seconds=SECONDS, is_running=False):
    devices = build_devices(load_config(CONFIG).config, rig.ports, clock=rig.clock)
    probes = probe_devices(devices, seconds=seconds, clock=rig.clock)
    found = judge(probes, is_running=is_running)
    faults = {(f.device, f.channel, f.code): f for f in found.findings if f.severity == "fault"}
    return found, faults, {f.code for f in found.findings if f.severity == "note"}


def test_a_healthy_bench_passes_and_its_numbers_are_right():
    with resting_bench() as rig:
        found, faults, notes = checked(rig)
    assert not faults and not notes
    channels = {c.channel: c for c in found.channels}
    assert set(channels) == {
        "force_n", "displacement_mm", "motor_current_a", "battery_voltage_v", "battery_current_a"
    }  # fmt: skip
    assert channels["force_n"].noise_std == pytest.approx(0.3, rel=0.1)
    assert channels["displacement_mm"].mean == pytest.approx(4.0, abs=0.01)
    assert channels["battery_voltage_v"].latest == pytest.approx(18.0, abs=0.05)
    assert channels["force_n"].rate_hz == pytest.approx(6000, rel=0.03)
    assert channels["motor_current_a"].n_samples == pytest.approx(1000 * SECONDS, rel=0.2)


def test_saturated_frozen_and_noisy_are_named():
    behaviour = {
        "force_n": lambda t, noise: np.full(len(t), 5000.0),
        "displacement_mm": lambda t, noise: np.full(len(t), 4.0),
        "motor_current_a": lambda t, noise: 5.0 * np.sin(2 * np.pi * 50.0 * t) + 0.03 * noise,
        "battery_voltage_v": lambda t, noise: np.full(len(t), 17.5),
    }
    with resting_bench(behaviour) as rig:
        _, faults, notes = checked(rig)
    assert set(faults) == {
        ("load_cell", "force_n", "saturated"),
        ("stroke_sensor", "displacement_mm", "frozen"),
        ("power", "motor_current_a", "noisy"),
    }
    assert "100.0%" in faults["load_cell", "force_n", "saturated"].what
    assert "50 Hz hum" in faults["power", "motor_current_a", "noisy"].what
    # A voltage on the bus that does not leave its step may be at rest: said, but no fault.
    assert notes == {"not_moving"}


def test_wrong_rate_damage_and_silence_are_named():
    faults_in = [
        {"device": "stroke_sensor", "kind": "garble_bytes", "at_s": 0.5, "n_bytes": 24},
        {"device": "power", "kind": "silence", "at_s": -2.0, "seconds": 60.0},
    ]
    with resting_bench(faults=faults_in, clock_error_ppm={"load_cell": -4e5}) as rig:
        _, faults, notes = checked(rig)
    assert not notes
    assert ("load_cell", "", "rate_low") in faults
    assert "60%" in faults["load_cell", "", "rate_low"].what
    assert ("stroke_sensor", "", "bytes_damaged") in faults
    assert ("stroke_sensor", "", "samples_missing") in faults
    assert ("power", "", "no_bytes") in faults


def test_an_instrument_that_stops_is_named():
    faults_in = [{"device": "power", "kind": "silence", "at_s": 0.3, "seconds": 60.0}]
    with resting_bench(faults=faults_in) as rig:
        _, faults, _ = checked(rig)
    assert set(faults) == {("power", "", "stopped")}


def test_counted_samples_that_are_lost_are_counted():
    with resting_bench(faults=[{"device": "power", "kind": "silence", "at_s": 0.6, "seconds": 0.2}]) as rig:
        found, faults, _ = checked(rig, seconds=1.5)
    # A machine that is busy may send late too, which is a low rate and nothing that was lost.
    assert {code for _, _, code in faults} - {"rate_low"} == {"samples_missing"}
    current = next(c for c in found.channels if c.channel == "motor_current_a")
    assert current.n_missing == pytest.approx(200, abs=20)
    assert current.n_gaps == 1


def gsv8_alone(port):
    table = {"driver": "gsv8", "port": port, "channels": {"force_n": {"input": 1, "raw_range": [-3.5, 3.5]}}}
    return build_devices(BenchConfig(devices={"load_cell": table}))


def test_wrong_baud_no_bytes_and_no_port_are_told_apart(tmp_path):
    frame = b"\xaa\x10\xb0" + struct.pack(">f", 0.123) + b"\x85"
    garbage = missampled(frame * 20, sent_baud=115200, read_baud=57600)
    assert missampled(frame, sent_baud=115200, read_baud=115200) == frame
    assert frame not in garbage
    dead, wrong = PtyEndpoint(tmp_path / "dead"), PtyEndpoint(tmp_path / "wrong")
    stop = threading.Event()

    def stream():
        while not stop.wait(0.01):
            wrong.write(garbage)

    for endpoint in (dead, wrong):
        endpoint.plug()
    thread = threading.Thread(target=stream)
    thread.start()
    try:
        codes = {}
        for name, port in (("dead", dead.address), ("wrong", wrong.address), ("none", str(tmp_path / "none"))):
            found = judge(probe_devices(gsv8_alone(port), seconds=0.5))
            codes[name] = [f.code for f in found.findings if f.severity == "fault"]
            assert not found.is_good
    finally:
        stop.set()
        thread.join()
        for endpoint in (dead, wrong):
            endpoint.unplug()
    assert codes == {"dead": ["no_bytes"], "wrong": ["wrong_baud_or_instrument"], "none": ["cannot_open"]}


def test_a_channel_without_calibration_is_a_fault(monkeypatch, tmp_path, capsys):
    text = re.sub(r"\ncalibration = \{ scale = 250\.0.*\}\n", "\n", CONFIG.read_text(), count=1)
    path = tmp_path / "bench_config.toml"
    path.write_text(text)
    monkeypatch.setattr(sawbench.acquisition.device_probe, "probe_devices", lambda *_, **__: [])
    code = main(["check", "--config", str(path), "--json"])
    found = [f for f in json.loads(capsys.readouterr().out)["findings"] if f["code"] == "not_calibrated"]
    assert code == 1 and [f["channel"] for f in found] == ["force_n"]
    assert "sawbench calibrate --channel force_n" in found[0]["remedy"]


def test_a_fault_of_the_whole_bench_names_no_device():
    """As where the tool runs: whose fault it is stands between the word and the colon, or nothing does."""
    whole = Finding(severity="fault", code="x", device="", what="the tool is running", remedy="switch it off")
    one = replace(whole, device="load_cell", channel="force_n")
    said = describe(Preflight(channels=(), findings=(whole, one))).splitlines()
    assert said[0] == "FAULT: the tool is running"
    assert said[2] == "FAULT load_cell force_n: the tool is running"


def test_channels_that_nobody_gives_are_a_note(monkeypatch, tmp_path, capsys):
    text = CONFIG.read_text().split("[devices.stroke_sensor]")[0]
    path = tmp_path / "bench_config.toml"
    path.write_text(text)
    with resting_bench(config_path=path) as rig:
        bench = lambda *_, **__: contextlib.nullcontext(rig.ports)  # noqa: E731
        monkeypatch.setattr(sawbench.commands.recording_session, "simulated_bench", bench)
        monkeypatch.setattr(
            sawbench.acquisition.calibration_book, "build_calibrated", partial(build_calibrated, clock=rig.clock)
        )
        monkeypatch.setattr(sawbench.acquisition.device_probe, "probe_devices", partial(probe_devices, clock=rig.clock))
        code = main(["check", "--config", str(path), "--seconds", "1.2", "--simulated", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert code == 0 and said["is_good"]
    absent = ("displacement_mm", "motor_current_a", "battery_voltage_v", "battery_current_a")
    assert {(f["channel"], f["code"]) for f in said["findings"]} == {
        *((channel, "channel_not_configured") for channel in absent), ("force_n", "not_in_calibration_book"),
    }  # fmt: skip
    (own,) = [f for f in said["findings"] if f["channel"] == "force_n"]
    assert str(tmp_path / "bench_config.calibration-simulated.toml") in own["what"]


def test_a_fault_is_exit_code_1_and_a_wrong_configuration_2(tmp_path, capsys):
    path = tmp_path / "bench_config.toml"
    table = '[devices.cell]\ndriver = "gsv8"\nport = "{}"\n[devices.cell.channels.force_n]\ninput = 1\n'
    path.write_text(table.format(tmp_path / "nothing"))
    assert main(["check", "--config", str(path), "--seconds", "0.5"]) == 1
    assert "no such port" in capsys.readouterr().out
    path.write_text(table.format(tmp_path / "nothing").replace("gsv8", "gsv9"))
    assert main(["check", "--config", str(path), "--seconds", "0.5"]) == 2
    assert "gsv8" in capsys.readouterr().err


def test_a_running_tool_is_said_once_and_not_as_shield_and_ground():
    turning = {
        "force_n": lambda t, noise: 150.0 * np.maximum(0.0, np.sin(2 * np.pi * 12.0 * t)) + 0.3 * noise,
        "displacement_mm": lambda t, noise: 10.0 * (1.0 - np.cos(2 * np.pi * 12.0 * t)) + 0.01 * noise,
    }
    with resting_bench(turning) as rig:
        devices = build_devices(load_config(CONFIG).config, rig.ports, clock=rig.clock)
        found = judge(probe_devices(devices, seconds=1.2, clock=rig.clock))
    (fault,) = [f for f in found.findings if f.code == "tool_running"]
    assert fault.severity == "fault"
    assert "switch the tool off" in fault.remedy
    assert not [f for f in found.findings if "shield" in f.remedy]
