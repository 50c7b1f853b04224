"""What a mistuned number leaves on an independently simulated machine is what its nuisance says, and no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.campaign import _motor_voltage
from sawbench.diagnosis.inference.nuisances import further_batteries, nuisances_of, still_to_warm_up
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.modeling.residuals import Baseline, residuals
from sawbench.modeling.state import angle_derivative
from sawbench.modeling.stroke import mean_stroke
from scipy.interpolate import CubicSpline

from tests.rigs.jigsaw_in_time import BASELINE, Machine, compare

pytestmark = pytest.mark.contract


SHARE = 0.01
PLANT = (
    "resistance_ohm", "inductance_h", "back_emf_constant_v_s_per_rad", "torque_constant_n_m_per_a",
    "motor_damping_n_m_s_per_rad", "rotor_inertia_kg_m2", "yoke_inertia_kg_m2", "reciprocating_mass_kg",
    "crank_radius_m",
)  # fmt: skip
# The channel that each equation is solved for, and how a misfit of a size in the equation's unit enters it.
SOLVED_FOR = {
    "electrical": lambda s, wave: {"motor_voltage_v": s.motor_voltage_v + 5.0 * wave},
    "mechanical": lambda s, wave: {"current_a": s.current_a + 20.0 * wave},
    "cutting": lambda s, wave: {"force_n": s.force_n + 500.0 * wave},
    "supply": lambda s, wave: {"battery_voltage_v": s.battery_voltage_v + 5.0 * wave},
    "converter": lambda s, wave: {"battery_current_a": s.battery_current_a + 10.0 * wave},
}  # fmt: skip


@pytest.fixture(scope="module")
def true():
    return Machine().run()


def nuisance(name, baseline=BASELINE):
    return {n.name: n for n in nuisances_of(baseline)}[name]


def gap(baseline, state):
    found = residuals(baseline, state)
    return {**found, "cutting": found["cutting"] - baseline.expected_force(state)}


def mistuned(name, amount):
    """Baseline that believes a number of the plant to be smaller than it is."""
    known = getattr(BASELINE.plant, name)
    less = known.model_copy(update={"nominal": known.nominal - amount})
    return Baseline(
        plant=BASELINE.plant.model_copy(update={name: less}),
        battery=BASELINE.battery,
        cutting_sign=BASELINE.cutting_sign,
    )


@pytest.mark.parametrize("name", PLANT)
def test_a_mistuned_number_of_the_plant(true, name):
    # Some numbers matter little: large steps where the residual is linear in them, small ones for the others.
    share = {
        "motor_damping_n_m_s_per_rad": 1.0,
        "inductance_h": 0.3,
        "yoke_inertia_kg_m2": 3.0,
        "reciprocating_mass_kg": 0.3,
    }.get(name, 3 * SHARE)
    share = SHARE if name in {"torque_constant_n_m_per_a", "crank_radius_m"} else share
    amount = share * getattr(BASELINE.plant, name).nominal
    believed = mistuned(name, amount)
    seen = gap(believed, true)
    if name == "crank_radius_m":
        del seen["cutting"]  # k_Fc takes it up: is unknown it beforehand
    claimed = nuisance(name, believed).signature(believed, true)
    compare(seen, {key: amount * wave for key, wave in claimed.items()}, 0.03)


def test_battery_numbers(true):
    battery = BASELINE.battery
    for name, amount in (("internal_resistance_ohm", 0.01), ("nominal_voltage_v", 0.1), ("capacity_ah", 0.02)):
        state = replace(true, charge_used_as=true.charge_used_as + 2000.0)
        # The machine runs on a full battery; what it would show at this charge is shifted to it.
        shift = BASELINE.open_circuit_voltage(state.charge_used_as) - BASELINE.open_circuit_voltage(true.charge_used_as)
        state = replace(state, battery_voltage_v=state.battery_voltage_v + shift)
        less = battery.model_copy(update={name: getattr(battery, name) - amount})
        believed = Baseline(plant=BASELINE.plant, battery=less, cutting_sign=-1)
        claimed = nuisance(name, believed).signature(believed, state)
        seen = {"supply": residuals(believed, state)["supply"]}
        compare(seen, {"supply": amount * claimed["supply"]}, 0.05)


def scaled(state, factor, *names):
    return {name: factor * getattr(state, name) for name in names}


READINGS = {
    "motor_current_gain": lambda s, g: scaled(s, 1 + g, "current_a", "current_rate_a_s"),
    "motor_current_offset_a": lambda s, g: {"current_a": s.current_a + g},
    "force_gain": lambda s, g: scaled(s, 1 + g, "force_n"),
    "force_offset_n": lambda s, g: {"force_n": s.force_n + g},
    "battery_current_gain": lambda s, g: scaled(s, 1 + g, "battery_current_a"),
    "battery_current_offset_a": lambda s, g: {"battery_current_a": s.battery_current_a + g},
    "battery_voltage_gain": lambda s, g: scaled(s, 1 + g, "battery_voltage_v", "motor_voltage_v"),
    "battery_voltage_offset_v": lambda s, g: {
        "battery_voltage_v": s.battery_voltage_v + g,
        "motor_voltage_v": s.motor_voltage_v + s.setting.duty * g,
    },
    "angle_zero_rad": lambda s, g: {"angle_rad": s.angle_rad + g},
}
SIZES = {
    "force_offset_n": 2.0,
    "motor_current_offset_a": 0.2,
    "battery_current_offset_a": 0.1,
    "battery_voltage_offset_v": 0.1,
    "angle_zero_rad": 0.005,
}


@pytest.mark.parametrize("name", READINGS)
def test_a_wrong_reading(true, name):
    size = SIZES.get(name, SHARE)
    read = replace(true, **READINGS[name](true, size))
    claimed = nuisance(name).signature(BASELINE, read)
    compare(gap(BASELINE, read), {key: size * wave for key, wave in claimed.items()}, 0.03)


def misread(true, bent):
    """The state as a displacement with a bent characteristic shows it: x -> x + bent(x), both over the radius."""
    (angle,) = true.angle_rad
    cosine = 1.0 - ((1.0 - np.cos(angle)) + bent(1.0 - np.cos(angle)))
    read = np.where(angle < np.pi, np.arccos(cosine), 2 * np.pi - np.arccos(cosine))

    def periodic(x, wave):
        return CubicSpline(np.r_[x, x[0] + 2 * np.pi], np.r_[wave, wave[0]], bc_type="periodic")

    later = periodic(angle, read - angle)
    at = angle - later(angle)
    for _ in range(5):
        at = angle - later(at)
    waves = {
        name: periodic(angle, getattr(true, name)[0])(at)[None]
        for name in (
            "speed_rad_s", "current_a", "current_rate_a_s", "force_n", "battery_voltage_v", "battery_current_a",
            "motor_voltage_v",
        )
    }  # fmt: skip
    waves["speed_rad_s"] = waves["speed_rad_s"] * (1.0 + later(at, 1))
    return replace(true, **waves, acceleration_rad_s2=waves["speed_rad_s"] * angle_derivative(waves["speed_rad_s"]))


# What is added to a displacement, both over the radius, and the sine of the read angle that it makes.
BEND = 2e-3
BENT = {
    "displacement_bend_1_rad": (lambda x: BEND * x * (1 - x / 2), 0.5 * BEND),
    "displacement_bend_2_rad": (lambda x: BEND * (x - 1) * (1 - (x - 1) ** 2), -0.5 * 4 * BEND),
}


def test_the_zero_of_a_current_sensor_goes_with_the_currents_of_the_machine():
    """A sensor of 100 A whose zero is off by 0.2 A is no converter loss: it was called one on three benches."""
    heavy = replace(BASELINE, load=replace(BASELINE.load, torque_n_m=4.0 * BASELINE.load.torque_n_m))
    for name in ("motor_current_offset_a", "battery_current_offset_a"):
        usual, large = (next(n.std for n in nuisances_of(b) if n.name == name) for b in (BASELINE, heavy))
        assert usual == pytest.approx(0.01 * BASELINE.usual_current_a)
        assert large == pytest.approx(4.0 * usual)
    weak = replace(BASELINE, load=replace(BASELINE.load, torque_n_m=1e-3 * BASELINE.load.torque_n_m))
    assert next(n.std for n in nuisances_of(weak) if n.name == "motor_current_offset_a") == 0.03


@pytest.mark.parametrize("entry", nuisances_of(BASELINE), ids=lambda entry: entry.name)
def test_every_nuisance_is_a_number_where_the_crank_angle_is_not_known(true, entry):
    blind = replace(true, angle_rad=np.full_like(true.angle_rad, np.nan))
    compared, found = residuals(BASELINE, blind), entry.signature(BASELINE, blind)
    assert compared
    assert all(np.all(np.isfinite(wave)) for equation, wave in found.items() if equation in compared)


@pytest.mark.parametrize("name", BENT)
def test_a_displacement_that_is_not_linear(true, name):
    stroke, (bent, coefficient) = mean_stroke(true), BENT[name]
    claimed = nuisance(name).signature(BASELINE, stroke)
    before, after = gap(BASELINE, stroke), gap(BASELINE, misread(stroke, bent))
    for equation in ("electrical", "mechanical"):
        seen = np.fft.rfft(after[equation] - before[equation], axis=1)[:, :9]
        said = coefficient * np.fft.rfft(claimed[equation], axis=1)[:, :9]
        assert np.linalg.norm(seen - said) < 0.05 * np.linalg.norm(said)


@pytest.mark.parametrize("name", BENT)
def test_a_sensor_may_be_bent_to_one_side_or_as_an_s(name):
    """By an eighth of a per cent of its range: one standard deviation, or little more."""
    bent, coefficient = BENT[name]
    largest = np.abs(bent(np.linspace(0.0, 2.0, 1001))).max()
    deviations = abs(coefficient) * 0.0025 / largest / nuisance(name).std
    assert 0.7 < deviations < 1.4


DRIFTING = {
    "force_gain": SHARE, "motor_current_gain": SHARE, "battery_current_gain": SHARE, "battery_voltage_gain": SHARE,
    "motor_current_offset_a": 0.1, "battery_current_offset_a": 0.1,
}  # fmt: skip


@pytest.mark.parametrize("name", DRIFTING)
def test_a_reading_that_changes_while_the_amplifier_warms_up(true, name):
    late = replace(true, setting=replace(true.setting, session_s=450.0))
    # Of a campaign of an hour, which is the baseline's: to what it is at the end.
    left = (np.exp(-(450.0 + late.time_s) / 600.0) - np.exp(-6.0)) / (1.0 - np.exp(-6.0))
    read = replace(late, **READINGS[name](late, DRIFTING[name] * left))
    claimed = nuisance(f"{name}, warm-up over 600 s").signature(BASELINE, read)
    compare(gap(BASELINE, read), {key: DRIFTING[name] * wave for key, wave in claimed.items()}, 0.03)


@pytest.mark.parametrize("minutes", [5.0, 25.0, 180.0])
@pytest.mark.parametrize("time_s", [600, 3600])
def test_a_gain_drifts_over_a_campaign_by_as_much_as_it_is_uncertain(minutes, time_s):
    """However long it lasts: 0.6 % of a voltage in 25 minutes was a weakening of the magnets."""
    bench = replace(BASELINE, session_s=60.0 * minutes)
    entry = nuisance(f"battery_voltage_gain, warm-up over {time_s} s", bench)
    assert entry.std == nuisance("battery_voltage_gain", bench).std
    assert still_to_warm_up(bench, np.array([0.0, bench.session_s]), time_s) == pytest.approx([1.0, 0.0])
    # An exponential: straight where the campaign is short, early where it is long.
    half = still_to_warm_up(bench, np.array([0.5 * bench.session_s]), time_s)[0]
    assert half == pytest.approx(1.0 / (1.0 + np.exp(0.5 * bench.session_s / time_s)))


@pytest.mark.parametrize("place", ["start", "end"])
def test_a_cut_that_begins_a_little_late_or_ends_a_little_early(true, place):
    """The blade has travelled less than a thousandth of its stroke; every harmonic that is compared shows it."""
    late_rad, n_fine, n_points = 0.05, 1 << 14, true.angle_rad.shape[1]
    # The cutting half of this machine is the second one; cells are averaged, as measured strokes are.
    since = (np.arange(n_fine) + 0.5) * 2 * np.pi / n_fine - np.pi
    away = since if place == "start" else np.pi - since
    missing = np.where((since > 0) & (away < late_rad), -np.sin(away), 0.0)
    spectrum = np.fft.rfft(missing.reshape(n_points, -1).mean(axis=1))[1:33]
    claimed = np.fft.rfft(nuisance(f"force at the {place} of the cut").signature(BASELINE, true)["cutting"][0])[1:33]
    size = np.vdot(claimed, spectrum) / np.vdot(claimed, claimed)
    assert np.linalg.norm(spectrum - size * claimed) ** 2 < 0.05 * np.linalg.norm(spectrum) ** 2


def test_a_cut_is_not_missing_where_nothing_is_cut(true):
    idle = replace(true, setting=replace(true.setting, is_idle=True))
    assert nuisance("force at the start of the cut").signature(BASELINE, idle) == {}


def test_an_offset_of_the_battery_current(true):
    read = replace(true, battery_current_a=true.battery_current_a + 0.1)
    claimed = nuisance("battery_current_offset_a").signature(BASELINE, read)
    # In the supply equation it is 2 mV: not worth an entry.
    compare({"converter": gap(BASELINE, read)["converter"]}, {"converter": 0.1 * claimed["converter"]}, 0.01)


@pytest.mark.parametrize("equation", SOLVED_FOR)
def test_no_number_scales_a_misfit_away(true, equation):
    """However large a misfit of an equation is, no nuisance grows with it there: none can shrink it in proportion."""
    wave = np.cos(3 * true.angle_rad) + 0.4 * np.sin(5 * true.angle_rad)
    wrong = replace(true, **SOLVED_FOR[equation](true, wave))
    assert np.max(np.abs(residuals(BASELINE, wrong)[equation] - residuals(BASELINE, true)[equation])) > 0.05
    for entry in nuisances_of(BASELINE):
        clean, misled = (entry.signature(BASELINE, state).get(equation) for state in (true, wrong))
        assert (clean is None) == (misled is None)
        if clean is not None and misled is not None:
            size = np.max(np.abs(clean))
            assert np.allclose(misled, clean, atol=1e-6 * size + 1e-12), entry.name


def spread_std(states):
    spreads = [n for n in Jigsaw(baseline=BASELINE).trial_nuisances(states) if "spread" in n.name]
    assert {n.name for n in spreads} == {f"k_fc spread of {s.setting.label}" for s in states if not s.setting.is_idle}
    (std,) = {n.std for n in spreads}
    return std


def pieces(true, hardness, points):
    """One trial for each piece of wood, its force in proportion to its hardness."""
    return [
        replace(
            true,
            force_n=factor * true.force_n,
            setting=replace(true.setting, label=f"t{k}", operating_point=point),
        )
        for k, (factor, point) in enumerate(zip(hardness, points, strict=True))
    ]


def test_without_repeats_pieces_differ_as_woods_usually_do(true):
    """The hardness of different operating points is no scatter of one."""
    assert spread_std(pieces(true, (1.0, 1.4, 0.7), ("a", "b", "c"))) == pytest.approx(SETTINGS.workpieces.piece_std)


def test_equal_repeats_narrow_the_spread_and_unequal_ones_widen_it(true):
    points = ("a", "a", "a", "b", "b", "b")
    equal = spread_std(pieces(true, np.ones(6), points))
    usual = spread_std(pieces(true, np.ones(6), "abcdef"))
    unequal = spread_std(pieces(true, np.exp([-0.1, 0.0, 0.1, 0.1, -0.1, 0.0]), points))
    assert equal < usual < unequal
    assert equal > 0.0


def test_many_repeats_tell_their_own_spread(true):
    rng = np.random.default_rng(2)
    hardness = np.exp(0.07 * rng.standard_normal(60))
    found = spread_std(pieces(true, hardness, ["abc"[k % 3] for k in range(60)]))
    own = np.sqrt(np.mean([np.var(np.log(hardness[k::3]), ddof=1) for k in range(3)]))
    assert found == pytest.approx(own, rel=0.05)


def test_idle_trials_have_no_wood(true):
    idle = replace(true, force_n=0.0 * true.force_n, setting=replace(true.setting, label="air", is_idle=True))
    assert spread_std([*pieces(true, (1.0, 1.0), "ab"), idle]) == pytest.approx(SETTINGS.workpieces.piece_std)


def test_a_number_whose_error_is_an_effect_is_not_re_tuned_as_well(true):
    """Two answers for one wave share its probability: which one is the name would be chance."""
    plant = Jigsaw(baseline=BASELINE)
    effect = next(e for e in plant.effects if e.name == "battery_internal_resistance")
    (shown,), of_number = effect.signatures_of(BASELINE, true, [{}])[0], nuisance("internal_resistance_ohm")
    assert np.array_equal(shown["supply"], of_number.signature(BASELINE, true)["supply"])
    assert [n.name for n in plant.nuisances() if n.is_effect] == [of_number.name]


def with_battery(state, number):
    return replace(state, setting=replace(state.setting, battery=number, label=f"b{number}"))


@pytest.mark.parametrize(("name", "share"), [("internal_resistance_ohm", 0.1), ("nominal_voltage_v", 0.01)])
def test_a_further_battery_may_differ_from_the_first_in_its_own_trials_only(true, name, share):
    first, second = with_battery(true, 0), with_battery(true, 1)
    more = share * getattr(BASELINE.battery, name)
    claimed = {n.name: n for n in Jigsaw(baseline=BASELINE).trial_nuisances([first, second])}[f"{name} of battery 2"]
    battery = BASELINE.battery.model_copy(update={name: getattr(BASELINE.battery, name) - more})
    believed = Baseline(plant=BASELINE.plant, battery=battery, cutting_sign=BASELINE.cutting_sign)
    seen = {"supply": gap(believed, second)["supply"]}
    compare(seen, {key: more * wave for key, wave in claimed.signature(believed, second).items()}, 0.03)
    assert claimed.signature(believed, first) == {}


@pytest.mark.parametrize("current_is_read", [True, False])
@pytest.mark.parametrize(("name", "share"), [("internal_resistance_ohm", 0.8), ("nominal_voltage_v", 0.03)])
def test_without_a_measured_voltage_numbers_of_the_battery_stand_in_that_of_the_motor(
    true, name, share, current_is_read
):  # fmt: skip
    more = share * getattr(BASELINE.battery, name)
    battery = BASELINE.battery.model_copy(update={name: getattr(BASELINE.battery, name) - more})
    believed = Baseline(plant=BASELINE.plant, battery=battery, cutting_sign=BASELINE.cutting_sign)
    unread = replace(true, battery_voltage_v=None)
    if not current_is_read:
        unread = replace(unread, battery_current_a=None)
    right, wrong = (
        replace(unread, motor_voltage_v=_motor_voltage(b, unread, unread.charge_used_as)) for b in (BASELINE, believed)
    )
    seen = residuals(believed, wrong)["electrical"] - residuals(BASELINE, right)["electrical"]
    claimed = nuisance(name, believed).signature(believed, wrong)
    assert set(claimed) == {"electrical"}
    compare({"electrical": seen}, {"electrical": more * claimed["electrical"]}, 0.03)


def test_one_battery_has_no_numbers_beside_those_of_the_configuration(true):
    assert further_batteries(BASELINE, [true.setting, true.setting]) == []
