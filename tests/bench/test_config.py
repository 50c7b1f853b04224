"""`bench_config.toml` as people write it: what is refused, with what words, and what is read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.config import SensorConfig, load_config, parse_config
from sawbench.bench.errors import ConfigError

pytestmark = pytest.mark.unit

TEXT = (Path(__file__).parents[2] / "bench_config.toml").read_text()


@pytest.mark.parametrize(
    ("right", "instead", "named"),
    [
        ("resistance_ohm = { nominal = 0.176", "resistance_ohm = { nominal = true", "plant.resistance_ohm.nominal"),
        ("resistance_ohm = { nominal = 0.176", 'resistance_ohm = { nominal = "0.176"', "plant.resistance_ohm.nominal"),
        (
            "resistance_ohm = { nominal = 0.176",
            "resistance_ohm = { nominal = 1e300",
            "plant.resistance_ohm.nominal: value out of range.*1e\\+300",
        ),
        ("gear_ratio = 9.333333333333334", "gear_ratio = 1e300", "plant.gear_ratio: value out of range"),
        (
            "inductance_h = { nominal = 0.00321",
            "inductance_h = { nominal = 1e-300",
            "plant.inductance_h.nominal: value out",
        ),
        ("capacity_ah = 1.5", "capacity_ah = 1e300", "battery.capacity_ah: value out of range"),
        (
            "resistance_ohm = { nominal = 0.176, rel_std = 0.05 }",
            "resistance_ohm = true",
            "plant.resistance_ohm: must be a number, or { nominal",
        ),
        ("gear_ratio = 9.333333333333334", "gear_ratio = true", "plant.gear_ratio"),
        ("nominal_voltage_v = 18.0", "nominal_voltage_v = false", "battery.nominal_voltage_v"),
        ("seconds = 10.0", 'seconds = "10"', "recording.seconds"),
    ],
)
def test_a_wrong_value_is_refused_by_its_key(right, instead, named):
    assert right in TEXT
    with pytest.raises(ConfigError, match=named):
        parse_config(TEXT.replace(right, instead, 1))


def test_whole_numbers_are_numbers():
    assert parse_config(TEXT.replace("seconds = 10.0", "seconds = 10", 1)).config.recording.seconds == 10.0


def test_brackets_without_end_are_one_clear_message():
    with pytest.raises(ConfigError, match="not valid TOML"):
        parse_config("x = " + 20_000 * "[")


def test_a_byte_order_mark_is_read_over(tmp_path):
    path = tmp_path / "bench_config.toml"
    path.write_text("\ufeff" + TEXT, encoding="utf-8")
    assert load_config(path).config == parse_config(TEXT).config


def test_text_of_another_encoding_is_one_clear_message(tmp_path):
    path = tmp_path / "bench_config.toml"
    path.write_text(TEXT, encoding="utf-16")
    with pytest.raises(ConfigError, match="is not UTF-8 text: byte 0 is 0xff") as caught:
        load_config(path)
    assert "bench_config.toml" in str(caught.value) and "save it as UTF-8" in str(caught.value)


BATTERY = "[battery]\nnominal_voltage_v = 18.0\ncapacity_ah = 1.5\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "beta"),
        ("beta = 0.9\nopen_circuit = { soc = [0, 0.5, 1], share = [0.8, 0.9, 1] }", "keep one"),
        ("open_circuit = { soc = [0, 0.5, 1], share = [0.8, 0.9] }", "share"),
        ("open_circuit = { soc = [0, 0.5, 1], share = [0.8, 0.9, 0.99] }", "share must end at 1"),
        ("open_circuit = { soc = [0, 0.5, 0.5, 1], share = [0.8, 0.9, 0.95, 1] }", "soc must increase"),
        ("open_circuit = { soc = [0.1, 0.5, 1], share = [0.8, 0.9, 1] }", "soc must start at 0"),
        ("beta = 0.9\nfitted = { runtime_rel_std = 0.1, current_a = [2, 1] }", "current_a must rise"),
        ("beta = 0.9\nfitted = { runtime_rel_std = 0.1 }", "current_a"),
    ],
)
def test_a_battery_is_one_curve_with_a_range(text, complaint):
    with pytest.raises(ConfigError, match=complaint):
        parse_config(BATTERY + text)


def test_a_table_battery_needs_no_beta():
    battery = parse_config(BATTERY + "open_circuit = { soc = [0, 0.5, 1], share = [0.8, 0.9, 1] }").battery()
    assert battery.open_circuit is not None
    assert battery.open_circuit.share == (0.8, 0.9, 1.0)


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("force = { gain = 1.01 }", "sensors.force: no channel has this name; known are .*force_n"),
        ("force_n = { gain = 0.1 }", "sensors.force_n.gain"),
        ("force_n = { zero = 0.1 }", "sensors.force_n.zero"),
    ],
)
def test_a_wrong_sensor_is_named(line, named):
    with pytest.raises(ConfigError, match=named):
        parse_config(f"{TEXT}\n[sensors]\n{line}\n", where="bench_config.toml")


def test_a_linear_axis_states_its_gains_elsewhere():
    axis = '[linear_axis]\nmoving_mass_kg = 5.0\ndrive_channel = "force_n"\nviscous_damping_n_s_per_m = 30.0\n'
    axis += "[sensors]\nforce_n = { gain = 1.01 }\n"
    with pytest.raises(ConfigError, match="for a saw"):
        parse_config(axis, where="axis.toml")


def test_a_gain_that_is_found_behind_a_stated_one_multiplies_it():
    """True 10, read by an inner sensor as 10.3, and that by an outer one as 9.27 + 1."""
    inner, outer = SensorConfig(gain=1.02, offset=0.1), SensorConfig(gain=0.9, offset=1.0)
    both = outer.after(inner.gain, inner.offset)
    assert both.true(np.array([0.9 * 10.3 + 1.0])) == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("line", "remedy"),
    [
        ("capacity_ah = 1,5", "write the number with a decimal point"),
        ("capacity_ah = 1.5\ncapacity_ah = 2.0", "keep one of the two: the key stands there already"),
        ("capacity_ah = = 1.5", "correct that line"),
        ('capacity_ah = "1,5"', "write numbers without quotes"),
        ('capacity_ah = "much"', "valid number (got 'much')"),
    ],
)
def test_slips_of_writing_say_what_to_write(line, remedy):
    with pytest.raises(ConfigError) as caught:
        parse_config(f"[battery]\n{line}\n", where="bench_config.toml")
    assert str(caught.value).endswith(remedy)
