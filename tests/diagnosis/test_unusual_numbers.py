"""Numbers that were probably stated in another unit are named; those of machines at hand are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.config import Uncertain, load_config
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.bench.unusual_numbers import unusual_numbers
from sawbench.commands.batch import named_config
from sawbench.diagnosis.plausibility import explain_faults
from sawbench.diagnosis.unusual_numbers import naming, slow_channels, unusual_settings
from sawbench.inputs import config_for
from sawbench.modeling.residuals import Baseline

pytestmark = pytest.mark.unit

CONFIG = load_config(Path(__file__).parents[2] / "bench_config.toml").config


def with_plant(key, factor):
    stated = getattr(CONFIG.plant, key)
    changed = Uncertain(nominal=stated.nominal * factor) if isinstance(stated, Uncertain) else stated * factor
    return CONFIG.model_copy(update={"plant": CONFIG.plant.model_copy(update={key: changed})})


@pytest.mark.parametrize(
    "key",
    [
        "resistance_ohm", "inductance_h", "back_emf_constant_v_s_per_rad", "torque_constant_n_m_per_a",
        "rotor_inertia_kg_m2", "yoke_inertia_kg_m2", "reciprocating_mass_kg", "crank_radius_m",
        "motor_damping_n_m_s_per_rad",
    ],
)  # fmt: skip
def test_a_number_in_a_unit_a_thousand_times_smaller_is_named_and_half_or_twice_of_it_is_not(key):
    (said,) = unusual_numbers(with_plant(key, 1000.0))
    assert said.startswith(f"[plant] {key} = ")
    assert said.endswith("check its unit")
    assert unusual_numbers(with_plant(key, 2.0)) == unusual_numbers(with_plant(key, 0.5)) == []


def test_a_capacity_in_milliampere_hours_is_named():
    battery = CONFIG.battery.model_copy(update={"capacity_ah": 1000.0 * CONFIG.battery.capacity_ah})
    (said,) = unusual_numbers(CONFIG.model_copy(update={"battery": battery}))
    assert said.startswith("[battery] capacity_ah = 1500 ")


@pytest.mark.parametrize("read", [lambda path: config_for(None, path), named_config], ids=["one", "for a batch"])
def test_a_configuration_with_an_unusual_number_is_named_once_with_its_file(read, tmp_path, caplog):
    path = tmp_path / "bench_config.toml"
    text = (Path(__file__).parents[2] / "bench_config.toml").read_text(encoding="utf-8")
    path.write_text(text.replace("capacity_ah = 1.5", "capacity_ah = 1500"), encoding="utf-8")
    for _ in range(2):
        read(path)
    (said,) = caplog.messages
    assert said.startswith(f"{path}: [battery] capacity_ah = 1500 is unusual")


def test_a_thickness_in_metres_is_named_once_for_all_trials_and_none_in_air_is_not():
    trials = [Trial(trial_id=name, material="oak", thickness_mm=0.02, feed_mm_s=4.0) for name in "abcdef"]
    in_air = Trial(trial_id="air", material="none", thickness_mm=0.0, feed_mm_s=0.0)
    (said,) = unusual_settings([in_air, *trials])
    assert said.startswith("a, b, c and 3 more trials: thickness_mm = 0.02 ")
    assert unusual_settings([in_air, Trial(trial_id="g", thickness_mm=20.0, feed_mm_s=4.0)]) == []


@pytest.mark.parametrize("remedy", [None, "check the clocks"])
def test_a_refusal_names_what_is_unusual_first(remedy):
    with pytest.raises(InputError) as refused, naming(["a is unusual"]):
        raise InputError("no trial can be used", where="t1", remedy=remedy)
    assert str(refused.value) == "t1: no trial can be used\n  -> a is unusual" + (f"; {remedy}" if remedy else "")
    with pytest.raises(InputError) as plain, naming([]):
        raise InputError("no trial can be used", where="t1", remedy=remedy)
    assert plain.value.remedy == remedy


@pytest.mark.parametrize(("rate_hz", "is_named"), [(20.0, True), (150.0, True), (600.0, False)])
def test_a_channel_with_too_few_samples_for_a_stroke_is_named_with_its_rate(rate_hz, is_named):
    """Without load at duty 0.5 the saw of the package makes 20.8 strokes a second: 9 V over 0.0074 V s/rad and gear."""
    time_s = np.arange(0.0, 2.0, 1.0 / rate_hz)
    signals = {
        name: Signal(channel=name, unit=unit, time_s=time_s, values=np.sin(130.0 * time_s))
        for name, unit in (("displacement_mm", "mm"), ("motor_current_a", "A"))
    }
    trial = Recording(trial=Trial(trial_id="t1", material="oak", duty=0.5), signals=signals)
    said = slow_channels([trial], Baseline(plant=CONFIG.plant, battery=CONFIG.battery, cutting_sign=-1))
    assert len(said) == is_named
    if is_named:
        expected = f"t1: displacement_mm has {rate_hz:.3g} samples a second, too few for up to 21 strokes a second"
        assert said[0].startswith(expected)


def test_a_time_in_ms_is_named_as_that_and_not_as_a_slow_rate():
    """As seen: a thousand times too few samples a second came first, and the wrong unit after it."""
    time_s = np.arange(0.0, 4.0, 1e-3)
    angle = 2.0 * np.pi * 15.0 * time_s
    tracks = {"displacement_mm": 10.0 * (1.0 - np.cos(angle)), "motor_current_a": 7.0 + 0.0 * angle}
    trial, saw = Trial(trial_id="t", material="oak", duty=0.4375), Baseline(
        plant=CONFIG.plant, battery=CONFIG.battery, cutting_sign=-1
    )  # fmt: skip
    in_s = explain_faults(saw, trial, {name: (time_s, values) for name, values in tracks.items()})
    in_ms = explain_faults(saw, trial, {name: (1e3 * time_s, values) for name, values in tracks.items()})
    assert in_s is None
    assert in_ms.mistake == "time_s is probably in ms"
    assert "samples a second" not in in_ms.remedy
    slow = {name: (time_s[::50], values[::50]) for name, values in tracks.items()}
    assert "displacement_mm has 20 samples a second" in explain_faults(saw, trial, slow).remedy


@pytest.mark.parametrize(("rel_std", "is_named"), [(0.05, False), (1.0, False), (5.0, True)])
def test_percent_in_the_place_of_a_share_is_named(rel_std, is_named):
    stated = Uncertain(nominal=CONFIG.plant.resistance_ohm.nominal, rel_std=rel_std)
    plant = CONFIG.plant.model_copy(update={"resistance_ohm": stated})
    said = unusual_numbers(CONFIG.model_copy(update={"plant": plant}))
    assert any("resistance_ohm has rel_std = 5, which is 500 %" in text for text in said) == is_named
