"""Every plant keeps the promises of `diagnosis.plants.plant`, and the axis's own pieces do what they say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.config import load_config, parse_config
from sawbench.bench.errors import ConfigError
from sawbench.bench.recording import Signal
from sawbench.diagnosis.inference.features import layout_of
from sawbench.diagnosis.plants.axis_motion import axis_state, derivative, find_cycles, fourier, has_several_speeds
from sawbench.diagnosis.plants.axis_windows import find_windows, window_states
from sawbench.diagnosis.plants.choice import reduce_recordings
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.diagnosis.plants.linear_axis import LinearAxis
from sawbench.modeling.effects.catalogue import EFFECTS
from sawbench.modeling.effects.friction import direction, through_play
from sawbench.modeling.load import OAK
from sawbench.modeling.machines.linear_axis import AxisBaseline
from sawbench.modeling.machines.table import LINEAR_AXIS, MACHINES, machine_of
from sawbench.modeling.residuals import UNITS, Baseline
from sawbench.modeling.state import TWO_PI, TrialSetting

from tests.rigs import drawn_states

pytestmark = pytest.mark.contract

TEXT = """[linear_axis]
moving_mass_kg = {{ nominal = 2.0, rel_std = 0.1 }}
viscous_damping_n_s_per_m = {{ nominal = 30.0, rel_std = 0.1 }}
{drive}
{load}
"""
CURRENT = "force_constant_n_per_a = { nominal = 20.0, rel_std = 0.02 }"
FORCE = 'drive_channel = "drive_force_n"'
LOAD = 'load_channel = "force_n"'


def axis(drive=CURRENT, load=LOAD):
    config = parse_config(TEXT.format(drive=drive, load=load)).config.linear_axis
    assert config is not None
    return LinearAxis(model=AxisBaseline(config=config, force_scale_n=40.0, stroke_m=0.1, top_speed_m_s=0.32))


def signal(values, time_s, unit=""):
    return Signal(channel="x", unit=unit, time_s=time_s, values=values)


def state(*, load=True, seed=1):
    """Four units of a sine of 100 mm stroke at 1 Hz, jittered samples."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, 4.0, 1e-3) + rng.uniform(0, 4e-4, 4000)
    x = signal(100.0 + 50.0 * np.sin(TWO_PI * time), time, "mm")
    cycles, _ = find_cycles(x)
    assert cycles is not None
    setting = TrialSetting(
        label="a", index=0, duty=1.0, is_idle=False, stock="brake", feed_m_s=np.nan, thickness_m=np.nan,
        operating_point="brake, 1 Hz", session_s=100.0,
    )  # fmt: skip
    force = signal(5.0 + np.cos(TWO_PI * time), time, "N") if load else None
    return axis_state(cycles, setting, x, signal(np.sign(np.cos(TWO_PI * time)), time, "A"), force, 20.0)


PLANTS = {
    "current, load": (axis(), state()),
    "force, load": (axis(drive=FORCE), state()),
    "current alone": (axis(load=""), state(load=False)),
}


@pytest.fixture(params=PLANTS.values(), ids=PLANTS)
def plant_and_state(request):
    return request.param


def test_residuals_are_of_the_stated_equations(plant_and_state):
    plant, measured = plant_and_state
    found = plant.residuals(measured)
    assert set(found) == set(plant.equations) == plant.model.evaluable_equations(measured)
    for wave in found.values():
        assert wave.shape == measured.angle_rad.shape
        assert np.isfinite(wave).all()


def test_nuisances_and_effects_change_stated_equations_only(plant_and_state):
    plant, measured = plant_and_state
    smooth = plant.smooth(measured, np.full((2, 4), 0.25))
    for nuisance in (*plant.nuisances(), *plant.trial_nuisances([measured])):
        assert nuisance.std > 0
        found = nuisance.signature(plant.model, smooth)
        assert set(found) <= set(plant.equations)
        assert any(np.abs(wave).max() > 0 for wave in found.values()), nuisance.name
    for effect in plant.effects:
        for shape in effect.shapes:
            for part in effect.signatures(plant.model, smooth, shape):
                assert set(part) <= set(plant.equations)
                for wave in part.values():
                    assert wave.shape == (2, 128)
                    assert np.isfinite(wave).all(), (effect.name, shape)


def test_model_error_is_a_covariance_of_the_layout(plant_and_state):
    plant, measured = plant_and_state
    layout = layout_of(measured, plant.residuals(measured), {e: f.n_harmonics for e, f in plant.equations.items()})
    error = plant.model_error(layout, measured)
    assert error.shape == (layout.size, layout.size)
    assert np.allclose(error, error.T)
    assert np.linalg.eigvalsh(error).min() > 0


@pytest.mark.parametrize("state", [drawn_states.running(), drawn_states.start_up()], ids=lambda state: state.kind)
def test_what_an_intact_saw_leaves_goes_with_its_load(state):
    """A saw of three times the voltage, force, torque and current leaves three times as much; sensors are left out."""
    larger = replace(
        OAK, force_n=3.0 * OAK.force_n, torque_n_m=3.0 * OAK.torque_n_m, battery_v=3.0 * OAK.battery_v
    )  # fmt: skip
    # No wave of angle, current, force or voltage, whose uncertain readings have a part of their own.
    level = {name: np.zeros_like(state.angle_rad) for name in ("current_a", "force_n", "battery_current_a")}
    quiet = replace(state, **level, battery_voltage_v=np.full_like(state.angle_rad, 18.0))
    found = []
    for load in (OAK, larger):
        plant = Jigsaw(baseline=replace(drawn_states.BASELINE, load=load))
        layout = layout_of(quiet, plant.residuals(quiet), {e: f.n_harmonics for e, f in plant.equations.items()})
        found.append((layout, np.sqrt(np.diag(plant.model_error(layout, quiet)))))
    (layout, small), (_, large) = found
    for equation in {"supply", "converter", "cutting"} & set(layout.slices):
        part = layout.slices[equation]
        assert large[part] == pytest.approx(3.0 * small[part], rel=1e-2), equation


def test_the_mean_voltage_of_a_battery_comes_back_to_a_thousandth():
    state, plant = drawn_states.running(), Jigsaw(baseline=drawn_states.BASELINE)
    layout = layout_of(state, plant.residuals(state), {e: f.n_harmonics for e, f in plant.equations.items()})
    std_v = np.sqrt(np.diag(plant.model_error(layout, state)))[layout.slices["supply"]]
    assert std_v[0] == pytest.approx(0.018, rel=0.1)
    assert std_v[1:].max() < 0.1 * std_v[0]


def saw(mechanism="scotch_yoke", *, without=()):
    text = (Path(__file__).parents[2] / "bench_config.toml").read_text()
    config = parse_config(text).config
    plant = config.plant.model_copy(update={"mechanism": mechanism, "rod_length_m": 0.025})
    return config.model_copy(update={"plant": plant, **dict.fromkeys(without)})


def axis_config(load=LOAD):
    return parse_config(TEXT.format(drive=CURRENT, load=load)).config


COMPOSED = {
    "jigsaw": machine_of(saw()),
    "slider_crank_saw": machine_of(saw("slider_crank")),
    "linear_axis": machine_of(axis_config()),
}


def test_every_machine_of_the_table_comes_from_a_configuration():
    assert {machine.name for machine in MACHINES} == set(COMPOSED)
    for name, machine in COMPOSED.items():
        assert machine.name == name
        assert machine.parts == next(m.parts for m in MACHINES if m.name == name)


def test_a_configuration_without_a_machine_says_so(tmp_path):
    path = tmp_path / "empty.toml"
    path.write_text("")
    with pytest.raises(ConfigError, match="does not describe a machine") as refused:
        reduce_recordings([], load_config(path))
    assert str(path) in str(refused.value)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_a_machine_offers_an_effect_where_it_has_its_parts(effect):
    assert effect.parts, "an effect states the parts it needs"
    models = {LINEAR_AXIS.frame: axis().model}
    offering = {m.name for m in MACHINES if effect.name in {e.name for e in m.effects(models.get(m.frame))}}
    assert offering == {m.name for m in MACHINES if set(effect.parts) <= m.parts}
    assert offering, "some machine shows it"
    # Equations other than a saw's need a statement of their own.
    assert (LINEAR_AXIS.name in offering) == (LINEAR_AXIS.frame in effect.variants)


def test_a_lacking_part_takes_its_effects_along():
    on_mains = {e.name for e in machine_of(saw(without=("battery",))).effects(None)}
    known = {e.name for e in COMPOSED["jigsaw"].effects(None)}
    assert known - on_mains == {e.name for e in EFFECTS if "battery" in e.parts} != set()
    alone = axis(load="")
    lost = {e.name for e in axis().effects} - {e.name for e in alone.effects}
    assert lost == {e.name for e in EFFECTS if LINEAR_AXIS.frame in e.variants and {"load", "load_cell"} & {*e.parts}}


def crank_saw(config):
    return Jigsaw(baseline=Baseline(plant=config.plant, battery=config.battery, cutting_sign=-1))


@pytest.mark.parametrize(
    ("machine", "plant"),
    [
        (machine_of(saw()), crank_saw(saw())),
        (machine_of(saw("slider_crank")), crank_saw(saw("slider_crank"))),
        (machine_of(axis_config()), axis()),
        (machine_of(axis_config(load="")), axis(load="")),
    ],
    ids=lambda value: value.name if isinstance(value, type(LINEAR_AXIS)) else "",
)
def test_what_is_diagnosed_is_the_machine(machine, plant):
    assert plant.machine == machine
    assert tuple(plant.equations) == machine.equations
    assert {n.name for n in plant.nuisances() if n.is_plant} == set(machine.parameters)
    assert [e.name for e in plant.effects] == [e.name for e in EFFECTS if set(e.parts) <= machine.parts]


def test_the_equations_of_a_saw_have_units():
    plant = crank_saw(saw())
    assert {name: form.unit for name, form in plant.equations.items()} == dict(UNITS)
    assert plant.equations["mechanical"].to_channel == pytest.approx(1 / 0.005632)


def test_motion_of_a_sine_is_that_of_a_sine():
    measured = state()
    velocity = 0.05 * TWO_PI * np.sin(measured.angle_rad)
    assert np.allclose(measured.position_m, 0.1 - 0.05 * np.cos(measured.angle_rad), atol=2e-6)
    assert np.allclose(measured.velocity_m_s, velocity, atol=1e-4)
    assert np.allclose(measured.acceleration_m_s2, 0.05 * TWO_PI**2 * np.cos(measured.angle_rad), atol=5e-3)
    assert measured.force_rate_n_s is not None
    force_rate = TWO_PI * np.cos(measured.angle_rad)  # the load is cos(2 pi t), a quarter of a cycle off
    assert np.allclose(measured.force_rate_n_s, force_rate, atol=1e-2)


def test_derivative_of_a_series():
    phase = np.linspace(0, TWO_PI, 50)
    series = np.array([3.0, 1.0, 0.0, 2.0, -1.0])  # 3 + cos p + 2 sin p - sin 2p
    wanted = -np.sin(phase) + 2 * np.cos(phase) - 2 * np.cos(2 * phase)
    assert np.allclose(fourier(phase, 2) @ derivative(series), wanted)


def test_a_start_at_rest_is_left_out():
    time = np.arange(0, 12.0, 1e-3)
    values = np.where(time < 2.0, 0.0, 10.0 * np.sin(TWO_PI * (time - 2.0)))
    cycles, said = find_cycles(signal(values, time, "mm"))
    assert cycles is not None
    assert cycles.rate_hz == pytest.approx(1.0, abs=2e-3)
    assert cycles.starts_s[0] > 1.9
    assert "2.0 cycles at the beginning differ" in said


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.zeros(4000), "does not move"),
        (np.random.default_rng(1).normal(size=4000), "not cyclic"),
        (np.sin(np.linspace(0, 0.8 * TWO_PI, 4000)), "no complete cycle"),
    ],
)
def test_a_trial_without_cycles_says_why(values, said):
    cycles, reason = find_cycles(signal(values, 1e-3 * np.arange(4000), "mm"))
    assert cycles is None
    assert said in reason


def test_friction_turns_round_over_the_presliding_distance():
    measured = state()
    sharp = direction(measured, 0.0)
    assert np.allclose(sharp[:, 40], 1.0)
    slow = direction(measured, 0.01)
    # Dahl: from -1 at the reversal, 1 - 2 exp(-s / s_0) after the distance s.
    distance = measured.position_m[0, :60] - measured.position_m[0].min()
    assert np.allclose(slow[0, 5:60], 1 - 2 * np.exp(-distance[5:60] / 0.01), atol=0.05)


def test_a_move_of_constant_acceleration_has_as_many_harmonics_as_its_samples_show():
    time = np.arange(0, 20.0, 1e-3)
    phase = (time / 5.0) % 1.0
    sine = -np.cos(TWO_PI * phase)
    # Triangles with rounded tops: speed of one sign for 0.45 of the cycle, ramps of 0.05.
    speed = np.clip(np.sin(TWO_PI * phase) / np.sin(TWO_PI * 0.025), -1.0, 1.0)
    moves = np.cumsum(speed) * 1e-3
    noise = np.random.default_rng(2).normal(0.0, 1e-4, len(time))
    few, _ = find_cycles(signal(100.0 * sine + noise, time, "mm"))
    many, _ = find_cycles(signal(100.0 * moves + noise, time, "mm"))
    assert few is not None
    assert many is not None
    assert few.n_motion < 10
    assert many.n_motion > 40


def test_ramps_at_both_ends_are_left_out():
    time = np.arange(0, 10.0, 1e-3)
    swing = np.clip(np.minimum(time, 10.0 - time) / 2.0, 0.0, 1.0)
    cycles, said = find_cycles(signal(10.0 * swing * np.sin(TWO_PI * time), time, "mm"))
    assert cycles is not None
    assert cycles.rate_hz == pytest.approx(1.0, abs=3e-3)
    assert cycles.starts_s[0] > 1.2
    assert cycles.starts_s[-1] + 1.0 < 8.8
    assert "at the beginning and" in said


def test_force_through_play_stands_still_across_the_gap():
    felt = through_play(state(), 0.02, 0.01)[0]  # 100 mm of travel, 20 mm of play, a spring of 10 mm
    since = state().position_m[0] - state().position_m[0].min()
    rising = slice(0, 64)
    loose = (since[rising] > 0.0105) & (since[rising] < 0.0295)
    assert np.allclose(felt[rising][loose], 0.0)
    assert np.allclose(felt[rising][since[rising] > 0.041], 1.0)
    wound = (since[rising] > 0.031) & (since[rising] < 0.039)
    assert np.allclose(felt[rising][wound], (since[rising][wound] - 0.03) / 0.01, atol=0.06)


def test_motion_without_a_period_is_a_balance_over_time():
    time = np.arange(0, 6.0, 1e-3)
    turn = TWO_PI * (0.3 * time + 0.1 * time**2)
    x = signal(20.0 * np.sin(turn), time, "mm")
    drive = signal(np.cos(turn), time, "N")
    windows, why = find_windows(x, drive, 32)
    assert windows is not None, why
    (one,) = window_states(windows, state().setting, {"displacement": x, "drive": drive, "load": None}, 1.0)
    # Without the ends, which the filter cannot know.
    assert 0.0 < windows.edges_s[0] < windows.edges_s[-1] < time[-1]
    parts = (np.arange(one.position_m.shape[1]) + 0.5) / one.position_m.shape[1]
    at_s = windows.edges_s[0] + parts * (windows.edges_s[-1] - windows.edges_s[0])
    rate = TWO_PI * (0.3 + 0.2 * at_s)
    inner = slice(40, -40)
    velocity = 0.02 * rate * np.cos(TWO_PI * (0.3 * at_s + 0.1 * at_s**2))
    assert np.allclose(one.velocity_m_s[0][inner], velocity[inner], atol=2e-3)
    noise = signal(np.random.default_rng(1).normal(size=4000), 1e-3 * np.arange(4000), "mm")
    assert find_windows(noise, noise, 32)[0] is None


@pytest.mark.parametrize(
    ("speeds", "is_cyclic", "several"),
    [
        ([[3.0, 3.0, -3.0, -3.0]], True, False),
        ([[3.0, 3.0, -3.0, -3.0, 1.0, 1.0, -3.0]], True, True),
        ([[3.0, 3.0, -3.0, -3.0], [1.0, 1.0, -1.0, -1.0]], True, True),
        # Creep about standstill is no move.
        ([[3.0, 3.0, -0.1, 0.1, -3.0, -3.0]], True, False),
        # Cut moves at the ends of a window say nothing.
        ([[1.0, -3.0, -3.0, 3.0, 3.0, -1.0]], False, False),
        ([[3.0, 3.0]], False, False),
    ],
)
def test_the_speeds_of_a_campaign_are_those_of_its_moves(speeds, is_cyclic, several):
    states = [replace(state(), velocity_m_s=np.array([one]), is_cyclic=is_cyclic) for one in speeds]
    assert has_several_speeds(states) is several


def test_a_sine_at_one_rate_lacks_another_speed_and_without_a_gap_no_repeat():
    slow = state()
    fast = replace(slow, velocity_m_s=2.0 * slow.velocity_m_s)
    bare = axis(load="")
    assert "the same motion at another speed" in bare.next_trial([slow], has_gap=False)
    assert bare.next_trial([slow, fast], has_gap=False) is None
    other = replace(fast, setting=replace(slow.setting, operating_point="brake, 2 Hz"))
    assert "a repeat" in bare.next_trial([slow, other], has_gap=True)
