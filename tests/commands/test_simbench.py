"""The simulated bench is the machine that the configuration says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.config import parse_config
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.blindcheck.streaming import StreamingPlant
from sawbench.commands.simbench import true_settings
from sawbench.commands.simulated_battery import drawn_ah
from sawbench.modeling.configured_battery import open_circuit_voltage
from sawbench.storage.reader import write_recording

pytestmark = pytest.mark.unit

SHIPPED = (Path(__file__).parents[2] / "bench_config.toml").read_text(encoding="utf-8")
CRANK = SHIPPED.replace("[plant]", '[plant]\nmechanism = "slider_crank"\nrod_length_m = 0.025', 1)


def midway_share(config_text: str) -> float:
    """Share of a stroke's time that the plunger spends below the middle of its stroke, running idle."""
    settings = true_settings(parse_config(config_text), material="none", duty=0.4, seed=1)
    stream = StreamingPlant(settings)
    stream.trigger(0.0)
    displacement_mm = stream.read("displacement_mm", np.arange(0.5, 2.5, 2e-4))
    return float(np.mean(displacement_mm < settings.crank_radius_m * 1e3))


def test_a_slider_crank_is_served_as_one():
    assert midway_share(SHIPPED) == pytest.approx(0.5, abs=0.02)
    # Of x = r (1 - cos) + l - sqrt(l^2 - r^2 sin^2): half of the stroke is passed where r^2 - 2 r l cos = 0.
    assert midway_share(CRANK) == pytest.approx(np.arccos(0.01 / (2 * 0.025)) / np.pi, abs=0.02)


def test_a_rod_in_the_configuration_of_a_scotch_yoke_is_left_aside():
    rod = SHIPPED.replace("[plant]", "[plant]\nrod_length_m = 0.025", 1)
    assert true_settings(parse_config(rod), material="none", duty=None, seed=0).rod_length_m is None


def recorded(path: Path, *, battery: str | None, current_a: float, seconds: float = 36.0) -> None:
    time_s = np.linspace(0.0, seconds, 361)
    signal = Signal(channel="battery_current_a", unit="A", time_s=time_s, values=np.full(len(time_s), current_a))
    path.parent.mkdir(exist_ok=True)
    write_recording(Recording(trial=Trial(trial_id=path.stem, battery=battery), signals={signal.channel: signal}), path)


def test_what_the_recordings_of_a_folder_drew_is_gone_from_the_battery_of_that_name(tmp_path):
    recorded(tmp_path / "a.mcap", battery="P1", current_a=10.0)
    recorded(tmp_path / "b.mcap", battery="P2", current_a=20.0)
    recorded(tmp_path / "c.mcap", battery=None, current_a=5.0)
    # A rejected trial is not judged; its charge is gone all the same.
    recorded(tmp_path / "rejected" / "a-1.mcap", battery="P1", current_a=4.0)
    (tmp_path / "other.mcap").write_bytes(b"of another program")
    assert drawn_ah(tmp_path, "P1") == pytest.approx(0.14)
    assert drawn_ah(tmp_path, None) == pytest.approx(0.05)
    assert drawn_ah(tmp_path, "P3") == drawn_ah(tmp_path / "new", "P1") == 0.0


TABLE = "open_circuit = { soc = [0.0, 0.1, 0.7, 1.0], share = [0.75, 0.86, 0.92, 1.0] }"


@pytest.mark.parametrize("curve", ["beta = 0.99", "beta = 0.9\nshape_ratio = 1.2", TABLE])
def test_a_used_battery_gives_less_voltage_along_its_configured_curve(curve):
    loaded = parse_config(SHIPPED.replace("beta = 0.99", curve))
    resting_v = []
    for drawn in (0.0, 0.6):
        stream = StreamingPlant(true_settings(loaded, material="none", duty=0.4, seed=1, drawn_ah=drawn))
        resting_v.append(float(stream.read("battery_voltage_v", np.linspace(0.0, 0.5, 4000)).mean()))
    full, used = open_circuit_voltage(loaded.battery(), np.array([1.0, 1.0 - 0.6 / 1.5]))
    assert resting_v == pytest.approx([full, used], abs=0.01)
    assert full - used > 0.1


def test_an_empty_battery_is_refused():
    with pytest.raises(InputError, match=r"empty: 1\.45 Ah drawn of 1\.5 Ah"):
        true_settings(parse_config(SHIPPED), material="none", duty=None, seed=0, drawn_ah=1.45)
