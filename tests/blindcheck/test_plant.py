"""The blind check's plant against energy balance, closed-form limits and the paper's figure."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.blindcheck.dynamics import CHARGE, CRANK, SPEED
from sawbench.blindcheck.plant import (
    MATERIALS,
    Plant,
    PlantSettings,
    brute_force_runtime,
    column,
    stroke_factors,
    texture,
    wander_noise,
)
from sawbench.blindcheck.streaming import StreamingPlant
from scipy.integrate import solve_ivp

pytestmark = pytest.mark.unit

STIFF = {"beta": 0.0, "capacity_ah": 1e6, "internal_resistance_ohm": 0.0, "stroke_rel_std": 0.0}
U_M = 18.0 * 18.41 / 42.08


def test_start_up_peak_is_the_paper_s():
    rows = Plant(PlantSettings(held_voltage_v=U_M, **STIFF)).advance(0.5)
    assert column(rows, "current_a").max() == pytest.approx(34.73, abs=0.01)


def test_cutting_on_the_other_half_gives_the_other_reading_s_peak():
    rows = Plant(PlantSettings(held_voltage_v=U_M, cutting_half="zero_to_pi", **STIFF)).advance(0.5)
    assert column(rows, "current_a").max() == pytest.approx(34.754, abs=0.01)


def test_runtime_is_the_paper_s_with_a_held_voltage():
    settings = PlantSettings(held_voltage_v=U_M, stroke_rel_std=0.0)
    assert brute_force_runtime(settings) == pytest.approx(927.0, rel=0.005)


def test_no_load_speed_and_current_without_the_plunger():
    settings = PlantSettings(k_fc_n_s_per_m=0.0, reciprocating_mass_kg=0.0, **STIFF)
    rows = Plant(settings).advance(3.0)
    voltage = 0.4375 * 18.0
    k_m, k_e, r, b = 5.632e-3, 7.383e-3, 0.176, 3.4274e-6
    speed = voltage / (k_e + r * b / k_m)
    assert column(rows, "speed_rad_s")[-1] == pytest.approx(speed, rel=1e-5)
    assert column(rows, "current_a")[-1] == pytest.approx(b * speed / k_m, rel=1e-4)


def test_blocked_rotor_draws_voltage_over_resistance():
    settings = PlantSettings(rotor_inertia_kg_m2=1e9, k_fc_n_s_per_m=0.0, **STIFF)
    rows = Plant(settings).advance(0.2)
    time_s = 5e-5 * np.arange(len(rows))
    stall_a = 0.4375 * 18.0 / 0.176
    expected = stall_a * (1.0 - np.exp(-time_s * 0.176 / 3.21e-3))
    np.testing.assert_allclose(column(rows, "current_a"), expected, atol=stall_a * 1e-5)


@pytest.mark.parametrize("rod_length_m", [None, 0.05, 0.0222])
def test_energy_is_conserved_over_a_second_of_cutting(rod_length_m):
    s = PlantSettings(rod_length_m=rod_length_m, **STIFF)
    plant = Plant(s, rtol=1e-9)
    rows = plant.advance(1.0)
    dt = 5e-5
    i, w, force, x = (column(rows, name) for name in ("current_a", "speed_rad_s", "force_n", "plunger_m"))
    # The work on the workpiece from force and displacement as sensors see them; the lever of the mechanism stays out.
    work = np.sum(0.5 * (force[1:] + force[:-1]) * -np.diff(x))
    given = np.trapezoid(s.duty * 18.0 * i, dx=dt)
    lost = work + np.trapezoid(
        s.resistance_ohm * i**2
        + (s.back_emf_constant_v_s_per_rad - s.torque_constant_n_m_per_a) * w * i
        + s.motor_damping_n_m_s_per_rad * w**2,
        dx=dt,
    )
    inertia = s.rotor_inertia_kg_m2 + s.yoke_inertia_kg_m2 / s.gear_ratio**2
    last_m_s = np.polyval(np.polyder(np.polyfit(dt * np.arange(-6, 1), x[-7:], 4)), 0.0)
    stored = (
        0.5 * s.inductance_h * i[-1] ** 2 + 0.5 * inertia * w[-1] ** 2 + 0.5 * s.reciprocating_mass_kg * last_m_s**2
    )
    assert given == pytest.approx(lost + stored, rel=1e-5)


def loop_closure_m(angle, radius, rod):
    """Where a circle of the rod's length around the crank pin meets the stroke line, from the lower dead centre."""
    pin = -radius * np.exp(1j * angle)
    return pin.real - np.sqrt(rod**2 - pin.imag**2) + radius + rod


@pytest.mark.parametrize("ratio", [0.2, 0.45])
def test_a_slider_crank_moves_as_an_integration_of_its_loop_closure(ratio):
    """Energy as the only law of motion, the lever by finite differences, scipy as the integrator."""
    s = PlantSettings(rod_length_m=0.01 / ratio, duty=0.5, **STIFF)
    r, rod, gear = s.crank_radius_m, s.rod_length_m, s.gear_ratio

    def slopes(angle, h=1e-4):
        near = [loop_closure_m(angle + k * h, r, rod) for k in (-1, 0, 1)]
        return (near[2] - near[0]) / (2 * h), (near[2] - 2 * near[1] + near[0]) / h**2

    def rates(_, state):
        current, speed, angle = state
        lever, bend = slopes(angle)
        v = lever * speed / gear
        push = s.k_fc_n_s_per_m * v if v < 0.0 else 0.0
        inertia = s.rotor_inertia_kg_m2 + (s.yoke_inertia_kg_m2 + s.reciprocating_mass_kg * lever**2) / gear**2
        half_slope = s.reciprocating_mass_kg * lever * bend / gear**3
        torque = s.torque_constant_n_m_per_a * current - s.motor_damping_n_m_s_per_rad * speed
        back_emf = s.back_emf_constant_v_s_per_rad * speed
        return (
            (s.duty * 18.0 - s.resistance_ohm * current - back_emf) / s.inductance_h,
            (torque - push * lever / gear - half_slope * speed**2) / inertia,
            speed / gear,
        )

    rows = Plant(s, rtol=1e-8).advance(0.3)
    time_s = 5e-5 * np.arange(len(rows))
    other = solve_ivp(rates, (0.0, time_s[-1]), (0.0, 0.0, 0.0), t_eval=time_s, max_step=1e-4, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(column(rows, "current_a"), other.y[0], atol=1e-3)
    np.testing.assert_allclose(column(rows, "crank_rad"), other.y[2], atol=1e-3)
    np.testing.assert_allclose(column(rows, "plunger_m"), loop_closure_m(other.y[2], r, rod), atol=1e-5)


def test_a_play_in_a_slider_crank_lets_the_plunger_follow_its_own_pin():
    settings = {"rod_length_m": 0.025, "k_fc_n_s_per_m": 0.0, **STIFF}
    gap_m = 2.5e-4
    plant = Plant(PlantSettings(extras={"gap_m": gap_m}, **settings))
    rows = plant.advance(0.5)[4000:]
    lost = column(rows, "plunger_m") - loop_closure_m(column(rows, "crank_rad"), 0.01, 0.025)
    # Beyond half of the play lies what the contact gives way to a plunger that the pin's largest acceleration,
    # r w^2 (1 + r / l), has thrown across it: v sqrt(m / k), v^2 = 2 a gap.
    crank_rad_s = column(rows, "speed_rad_s").max() / plant.settings.gear_ratio
    thrown_m_s = np.sqrt(2.0 * 0.01 * crank_rad_s**2 * (1.0 + 0.01 / 0.025) * gap_m)
    give_m = thrown_m_s * np.sqrt(plant.settings.reciprocating_mass_kg / float(plant.record["contact_n_m"][0]))
    assert 0.5 * gap_m < np.abs(lost).max() < 0.5 * gap_m + give_m


def test_force_lies_in_the_cutting_half_only():
    rows = Plant(PlantSettings(**STIFF)).advance(0.5)
    angle = np.mod(column(rows, "crank_rad"), 2 * np.pi)
    force = column(rows, "force_n")
    assert np.abs(force[(angle > 1e-6) & (angle < np.pi)]).max() == 0.0
    assert force[(angle > np.pi + 0.1) & (angle < 2 * np.pi - 0.1)].min() > 0.0


def test_charge_is_the_integral_of_the_battery_current():
    plant = Plant(PlantSettings())
    rows = plant.advance(2.0)
    drawn = np.trapezoid(column(rows, "battery_a"), dx=5e-5)
    assert plant.state[CHARGE] == pytest.approx(drawn, rel=1e-6)


def test_tolerance_governs_the_error():
    reference = Plant(PlantSettings(**STIFF), rtol=1e-11)
    reference.advance(1.0)
    errors = []
    for rtol in (1e-4, 1e-6, 1e-8):
        plant = Plant(PlantSettings(**STIFF), rtol=rtol)
        plant.advance(1.0)
        errors.append(abs(plant.state[SPEED] - reference.state[SPEED]))
    assert errors[1] < 1e-2
    assert errors[2] < 1e-4


@pytest.mark.parametrize("duty", [0.3, 0.4375, 0.6, 0.8])
def test_cogging_takes_no_mean_torque(duty):
    """Its torque is periodic in the angle and conservative, so the mean current is that without it (to 2nd order)."""
    mean_a = []
    for torque in (0.0, 0.002):
        shape = {"cogging_torque": torque, "cogging_slots": 12.0, "cogging_phase": 1.0, "cogging_second": 0.25}
        plant = Plant(PlantSettings(duty=duty, stroke_rel_std=0.0, extras=shape))
        plant.advance(1.0)
        mean_a.append(column(plant.advance(3.0), "current_a").mean())
    assert mean_a[1] == pytest.approx(mean_a[0], rel=5e-4)


def test_materials_reach_the_paper_s_peaks():
    peaks = {}
    for material in ("nylon", "black_locust", "oak"):
        rows = Plant(PlantSettings.for_material(material, seed=3)).advance(3.0)
        peaks[material] = np.percentile(column(rows, "force_n")[10000:], 99.5)
    assert peaks["nylon"] == pytest.approx(60.0, abs=6.0)
    assert 225.0 < peaks["black_locust"] < 290.0
    assert 225.0 < peaks["oak"] < 300.0


def test_tables_have_the_statistics_they_state():
    settings = PlantSettings(stroke_rel_std=0.05, stroke_correlation=0.3, seed=8)
    factors = stroke_factors(settings)
    assert factors.mean() == pytest.approx(1.0, abs=0.003)
    assert factors.std() == pytest.approx(0.05, rel=0.03)
    assert np.corrcoef(factors[1:], factors[:-1])[0, 1] == pytest.approx(0.3, abs=0.03)
    uneven = stroke_factors(replace(settings, stroke_rel_std=0.0, uneven_rel_std=0.04, uneven_mm=12.0))
    assert uneven.std() == pytest.approx(0.04, rel=0.2)
    # 4 mm/s at 20 strokes/s: after 60 strokes the wood is another one.
    assert np.corrcoef(uneven[60:], uneven[:-60])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.15)
    for table in (texture(8), wander_noise(8)):
        assert table.std() == pytest.approx(1.0, abs=1e-9)
        assert table.mean() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "settings",
    [
        {"duty": 43.75},
        {"initial_soc": 0.0},
        {"extras": {"no_such": 1.0}},
        {"resistance_ohm": float("nan")},
        {"rod_length_m": 0.01},
    ],
)
def test_impossible_settings_are_refused(settings):
    with pytest.raises(InputError):
        PlantSettings(**settings)


def test_unknown_material_and_impossible_cutoff_are_refused():
    with pytest.raises(InputError, match="oak"):
        PlantSettings.for_material("teak")
    with pytest.raises(InputError, match="cutoff_soc"):
        brute_force_runtime(PlantSettings(initial_soc=0.5), 0.6)
    assert set(MATERIALS) >= {"none", "nylon", "oak", "black_locust"}


def _read_all(stream: StreamingPlant, edges: list[float]) -> dict[str, np.ndarray]:
    channels = ("force_n", "displacement_mm", "motor_current_a", "battery_voltage_v", "battery_current_a")
    times = np.arange(0.0, 1.2, 2.1e-4)
    parts: dict[str, list[np.ndarray]] = {name: [] for name in channels}
    for start, end in itertools.pairwise(edges):
        for name in channels:
            parts[name].append(stream.read(name, times[(times >= start) & (times < end)]))
    return {name: np.concatenate(part) for name, part in parts.items()}


def test_stream_does_not_depend_on_how_it_is_read():
    many = StreamingPlant(PlantSettings(seed=5))
    many.trigger(0.1)
    few = StreamingPlant(PlantSettings(seed=5))
    few.trigger(0.1)
    a = _read_all(many, [0.0, 0.013, 0.1, 0.3501, 0.36, 0.9, 1.2])
    b = _read_all(few, [0.0, 1.2])
    for name, values in a.items():
        np.testing.assert_array_equal(values, b[name])
    other = StreamingPlant(PlantSettings(seed=6))
    other.trigger(0.1)
    assert np.abs(_read_all(other, [0.0, 1.2])["force_n"] - a["force_n"]).max() > 1.0


def test_stream_rests_starts_and_stops():
    stream = StreamingPlant(PlantSettings(seed=1, k_fc_n_s_per_m=0.0, current_noise_a=0.0))
    assert np.all(stream.read("motor_current_a", np.array([0.0, 0.2])) == 0.0)
    assert stream.trigger(0.1) == 0.2
    assert stream.read("motor_current_a", np.array([0.25]))[0] > 5.0
    stream.read("motor_current_a", np.array([0.61]))
    assert stream.release(0.5) == 0.61
    assert abs(stream.read("motor_current_a", np.array([2.0]))[0]) < 1e-3
    with pytest.raises(InputError):
        stream.release(2.5)
    with pytest.raises(InputError):
        stream.trigger(2.5)
    with pytest.raises(InputError, match="backwards"):
        stream.read("motor_current_a", np.array([1.0]))
    with pytest.raises(InputError, match="force_n"):
        stream.read("torque", np.array([3.0]))


def test_stream_is_the_plant_itself():
    settings = PlantSettings(seed=2, force_noise_n=0.0, initial_crank_rad=2.0)
    stream = StreamingPlant(settings)
    stream.trigger(0.0)
    times = np.arange(0.0, 0.7, 5e-5)
    plant = Plant(settings)
    rows = plant.advance(0.7)
    np.testing.assert_allclose(stream.read("force_n", times), column(rows, "force_n")[: len(times)], atol=2e-3 * 250)
    assert plant.state[CRANK] > 2.0 + 2 * np.pi
