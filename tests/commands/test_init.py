"""`sawbench init`: a configuration that the other commands take, from answers and from what is plugged in."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
import sawbench.acquisition.bench_search
from sawbench.acquisition.bench_search import FoundInstrument, FoundPort
from sawbench.acquisition.devices import build_devices
from sawbench.bench.config import load_config
from sawbench.commands.main import main

pytestmark = pytest.mark.pipeline

PORTS = tuple(FoundPort(interface="serial", port=f"COM{k}") for k in (3, 4, 5))


def instrument(driver, place, serial_number=None):
    return FoundInstrument(driver=driver, place=place, serial_number=serial_number, about=driver)


FOUND = (instrument("gsv8", PORTS[0], "11"), instrument("gsv8", PORTS[1], "22"), instrument("dbc_can", PORTS[2], "A9"))


@pytest.fixture
def bench(monkeypatch, tmp_path):
    """Work in an empty folder with the given ports and instruments plugged in."""
    monkeypatch.chdir(tmp_path)

    def plug(ports=PORTS, found=FOUND):
        monkeypatch.setattr(sawbench.acquisition.bench_search, "find_ports", lambda: ports)
        asked = lambda places, **_: tuple(f for f in found if f.place in places)  # noqa: E731
        monkeypatch.setattr(sawbench.acquisition.bench_search, "identify", asked)

    plug()
    return plug


@pytest.fixture
def answers(monkeypatch):
    """Give the answers in turn, the default for None; a question too many fails."""

    def give(*given):
        left = list(given)

        def prompt(_question, default, **_options):
            answer = left.pop(0)
            return default if answer is None else answer

        monkeypatch.setattr("click.prompt", prompt)
        return left

    return give


def devices(path="bench_config.toml"):
    config = load_config(path).config
    build_devices(config)
    return config.devices


def test_defaults_take_what_is_found_with_its_serial_number(bench, capsys):
    assert main(["init", "--defaults", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["path"] == "bench_config.toml" and all(d["is_found"] for d in said["devices"])
    written = devices()
    assert {name: (t["port"], t["serial_number"]) for name, t in written.items()} == {
        "load_cell": ("COM3", "11"),
        "stroke_sensor": ("COM4", "22"),
        "power": ("COM5", "A9"),
    }
    assert written["stroke_sensor"]["channels"]["displacement_mm"]["calibration"]["scale"] == 2.5


def test_answers_are_taken(bench, answers):
    #               machine, voltage, capacity, duty, look, load cell, stroke sensor, power
    left = answers(None, "36", "nonsense", "-2", "4", None, "y", "COM4", "COM4", "COM3", "none")
    assert main(["init", "shop"]) == 0
    assert not left
    config = load_config("shop/bench_config.toml").config
    assert (config.battery.nominal_voltage_v, config.battery.capacity_ah) == (36.0, 4.0)
    assert config.converter.default_duty == 0.4375
    assert {name: t["serial_number"] for name, t in devices("shop/bench_config.toml").items()} == {
        "load_cell": "22",
        "stroke_sensor": "11",
    }


def test_a_source_stays_beside_its_own_number_only(bench, answers):
    answers(None, "36", None, None, "n", None, None, None)
    main(["init"])
    text = Path("bench_config.toml").read_text(encoding="utf-8")
    lines = {line.split(" = ")[0]: line for line in text.splitlines()}
    assert "Table 3" not in lines["nominal_voltage_v"]
    assert "Appendix B" in lines["capacity_ah"]


def test_an_instrument_of_another_driver_brings_its_own_table(bench):
    bench(found=(instrument("gsv3", PORTS[0]), instrument("msc7xxx", PORTS[1])))
    assert main(["init", "--defaults"]) == 1
    written = devices()
    assert written["load_cell"]["driver"] == "gsv3" and list(written["load_cell"]["channels"]) == ["force_n"]
    assert written["stroke_sensor"]["driver"] == "msc7xxx"
    assert "serial_number" not in written["load_cell"]


def test_what_is_not_found_is_said(bench, capsys):
    bench(ports=(), found=())
    assert main(["init", "--defaults"]) == 1
    captured = capsys.readouterr()
    assert "not found" in captured.out and "none on this machine" in captured.err
    assert "serial_number" not in devices()["power"]


def test_a_can_interface_is_written_with_its_name(bench):
    channel = FoundPort(interface="socketcan", port="can0")
    bench(ports=(channel,), found=(instrument("dbc_can", channel),))
    assert main(["init", "--defaults"]) == 1
    assert (devices()["power"]["interface"], devices()["power"]["port"]) == ("socketcan", "can0")


def test_the_simulated_bench_needs_no_port(bench, capsys):
    bench(ports=None, found=None)  # Whoever looks at these fails.
    assert main(["init", "--simulated", "--machine", "slider_crank_saw"]) == 0
    assert "--simulated" in capsys.readouterr().out
    assert load_config("bench_config.toml").plant().mechanism == "slider_crank"
    assert set(devices()) == {"load_cell", "stroke_sensor", "power"}


def test_nothing_is_overwritten(bench, capsys):
    Path("bench_config.toml").write_text("mine")
    assert main(["init", "--defaults"]) == 2
    assert "already exists" in capsys.readouterr().err
    assert Path("bench_config.toml").read_text() == "mine"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--machine", "fretsaw"], "paper_jigsaw"),
        (["--simulated", "--machine", "linear_axis"], "linear axis"),
    ],
)
def test_wrong_usage_is_one_clear_message(bench, capsys, arguments, said):
    assert main(["init", "new", "--defaults", *arguments]) == 2
    assert said in capsys.readouterr().err
    assert not Path("new").exists()


def test_input_that_ends_is_said(bench, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert main(["init"]) == 2
    assert "--defaults" in capsys.readouterr().err
