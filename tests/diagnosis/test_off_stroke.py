"""Lines and bursts that do not follow the stroke are found, scatter and what the wood does are not."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Signal, Trial
from sawbench.bench.units import (
    BATTERY_CURRENT,
    BATTERY_VOLTAGE,
    CHANNEL_BY_NAME,
    DISPLACEMENT,
    FORCE,
    MOTOR_CURRENT,
)
from sawbench.diagnosis.answer.signals import signal_findings
from sawbench.diagnosis.inference.asynchronous import fixed_lines, hum_lines, off_stroke_findings
from sawbench.diagnosis.inference.off_stroke import off_stroke
from sawbench.diagnosis.inference.slow_wave import slow_wave
from sawbench.diagnosis.inference.strikes import foreign_bursts, strikes
from sawbench.diagnosis.inference.wandering_line import wandering_lines

from tests.rigs.processed import processed_trial

pytestmark = pytest.mark.unit

DURATION_S, RATE_HZ = 6.0, 2500.0
# Strokes a second and feed of each trial; without feed in air.
TRIALS = ((14.3, None), (19.1, None), (11.2, 3.0), (11.4, 6.0), (16.7, 3.0), (16.4, 6.0))
NOISE = {FORCE.name: 1.0, MOTOR_CURRENT.name: 0.2, BATTERY_VOLTAGE.name: 0.01, BATTERY_CURRENT.name: 0.1}


def signal(name, time_s, values):
    return Signal(channel=CHANNEL_BY_NAME[name], unit=CHANNEL_BY_NAME[name].unit, time_s=time_s, values=values)


def rounded(exact, resolution):
    """The same with one value that is a single step of the converter off."""
    values = resolution * np.round(exact.values / resolution)
    values[0] += resolution
    return signal(exact.channel.name, exact.time_s, values)


def trials(
    disturb, seed=3, noise=NOISE, resolution=0.0, plan=TRIALS, rate_hz=RATE_HZ, wander=0.003, duration_s=DURATION_S,
    slower=0.0,
):  # fmt: skip
    """Trials whose channels are a stroke's wave, noise and `disturb(rng, time_s, turns, feed) -> {channel: values}`.

    They begin `slower` by a share that is gone within seconds.
    """
    rng = np.random.default_rng(seed)
    found = []
    for number, (strokes_hz, feed_mm_s) in enumerate(plan):
        time_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
        turns = strokes_hz * (time_s + slower * np.expm1(-time_s)) + wander * np.cumsum(
            rng.standard_normal(len(time_s))
        ) / np.sqrt(rate_hz)
        added = disturb(rng, time_s, turns, feed_mm_s)
        wave = np.sin(2.0 * np.pi * turns) + 0.3 * np.cos(6.0 * np.pi * turns)
        signals = {
            name: signal(
                name, time_s, 10.0 * std * wave + std * rng.standard_normal(len(time_s)) + added.get(name, 0.0)
            )
            for name, std in noise.items()
        }
        if resolution:
            signals = {name: rounded(s, resolution) for name, s in signals.items()}
        angle = CrankAngle(
            time_s=time_s,
            angle_rad=2.0 * np.pi * turns,
            speed_rad_s=np.full(len(time_s), 2.0 * np.pi * strokes_hz),
            angle_std_rad=np.zeros(len(time_s)),
            radius_m=0.01,
            source="displacement_mm",
            is_absolute=True,
        )
        trial = Trial(
            trial_id=f"t{number}", duty=0.5, material="none" if feed_mm_s is None else "oak", feed_mm_s=feed_mm_s
        )
        found.append(off_stroke(processed_trial(trial, signals, angle, 0.0, duration_s)))
    assert all(f is not None for f in found)
    return found


def test_pickup_of_one_sensor_is_its_own_in_trials_of_one_speed_too():
    """There it stands at one order of the stroke as well, as far as the speed is the same."""

    def picked_up(rng, time_s, turns, feed_mm_s):
        return {FORCE.name: 1.5 * np.sin(2.0 * np.pi * 37.3 * time_s + rng.uniform(0.0, 6.0))}

    in_air = ((14.3, None), (14.32, None), (14.28, None))
    at_one_speed = trials(picked_up, plan=(*in_air, *((strokes_hz, 3.0) for strokes_hz, _ in in_air)))
    (line,) = fixed_lines(at_one_speed)
    assert line.frequency_hz == pytest.approx(37.3, abs=0.1)
    assert off_stroke_findings(at_one_speed) == []


@pytest.mark.parametrize("seconds", [1.2, 6.0])
def test_hum_of_one_sensor_is_found_in_trials_of_a_second_too(seconds):
    def hum(rng, time_s, turns, feed_mm_s):
        return {FORCE.name: 3.0 * np.sin(2.0 * np.pi * 50.0 * time_s + rng.uniform(0.0, 6.0))}

    (line,) = fixed_lines(trials(hum, duration_s=seconds))
    assert line.channel == FORCE.name
    assert line.frequency_hz == pytest.approx(50.0, abs=0.25)
    assert line.amplitude == pytest.approx(3.0, rel=0.25)
    quiet = trials(lambda *_: {}, duration_s=seconds)
    assert fixed_lines(quiet) == off_stroke_findings(quiet) == []


def campaign(disturb, **numbers):
    return max(off_stroke_findings(trials(disturb, **numbers)), key=lambda f: f.log_evidence, default=None)


def numbers(text):
    return [float(n) for n in re.findall(r"\d+\.?\d*(?:e[-+]\d+)?", text)]


def at_order(rng, time_s, turns, feed):
    return {FORCE.name: 2.0 * np.cos(2.0 * np.pi * 9.37 * turns + rng.uniform(0.0, 6.0))}


def ripple(rng, time_s, turns, feed):
    wave = np.cos(2.0 * np.pi * 83.0 * time_s + rng.uniform(0.0, 6.0))
    return {BATTERY_VOLTAGE.name: 0.03 * wave, BATTERY_CURRENT.name: 0.1 * wave}


def hum(rng, time_s, turns, feed):
    return {FORCE.name: 2.0 * np.cos(2.0 * np.pi * 50.0 * time_s + rng.uniform(0.0, 6.0))}


def grain(rng, time_s, turns, feed):
    """The wood's hardness waves every 3 mm of the feed."""
    if feed is None:
        return {}
    hardness = 0.5 * np.cos(2.0 * np.pi * feed * time_s / 3.0 + rng.uniform(0.0, 6.0))
    return {FORCE.name: 10.0 * hardness * np.maximum(np.sin(2.0 * np.pi * turns), 0.0)}


def bursts(rng, time_s, turns, feed, felt_a=0.0):
    """Blows of 4 ms; the motor's current follows them for 30 ms where it feels them."""
    wave, current_a = np.zeros(len(time_s)), np.zeros(len(time_s))
    for start_s in rng.uniform(0.2, DURATION_S - 0.2, 12):
        inside = (time_s >= start_s) & (time_s < start_s + 0.004)
        sign = rng.choice([-1.0, 1.0])
        wave[inside] = 40.0 * sign
        since_s = np.maximum(time_s - start_s - 0.004, 0.0)
        current_a += sign * felt_a * (since_s > 0.0) * np.exp(-since_s / 0.03)
    return {FORCE.name: wave, MOTOR_CURRENT.name: current_a}


def blows(rng, time_s, turns, feed):
    return bursts(rng, time_s, turns, feed, felt_a=0.5)


def stray_values(rng, time_s, turns, feed):
    wave = np.zeros(len(time_s))
    wave[rng.integers(0, len(time_s), 12)] = 60.0
    return {FORCE.name: wave}


def nothing(rng, time_s, turns, feed):
    return {}


def test_a_line_at_one_order_is_found_with_its_place_and_amplitude():
    finding = campaign(at_order)
    assert finding is not None
    amplitude, order = numbers(finding.text)[:2]
    assert finding.text.startswith("force_n")
    assert order == pytest.approx(9.37, abs=0.02)
    assert amplitude == pytest.approx(2.0, rel=0.15)
    assert finding.channel == FORCE.name
    assert finding.lines_hz == pytest.approx(sorted(9.37 * rate_hz for rate_hz, _ in TRIALS), abs=0.3)
    assert finding.log_evidence > 100.0


@pytest.mark.parametrize("order", [40.73, 96.4])
def test_a_commutator_is_found_at_its_order_whatever_the_sample_rate(order):
    """60 to 107 samples a stroke: the line lies above half of them in some trials or in all."""

    def commutation(rng, time_s, turns, feed):
        return {MOTOR_CURRENT.name: 0.3 * np.cos(2.0 * np.pi * order * turns + rng.uniform(0.0, 6.0))}

    finding = campaign(commutation, rate_hz=1200.0)
    assert finding is not None
    amplitude, found = numbers(finding.text)[:2]
    assert (finding.channel, found) == (MOTOR_CURRENT.name, pytest.approx(order, abs=0.02))
    assert amplitude == pytest.approx(0.3, rel=0.2)


@pytest.mark.parametrize("wander", [0.0, 0.003])
def test_the_image_of_a_wave_of_the_wood_is_no_line(wander):
    """One stroke rate and one feed: in every trial it stands as far from the samples a stroke as the wave from 0."""
    plan = ((16.7, None), *[(16.7, 3.0)] * 6)
    assert campaign(grain, plan=plan, wander=wander) is None


def test_a_ripple_of_the_supply_is_found_at_its_frequency():
    finding = campaign(ripple)
    assert finding is not None
    amplitude, frequency_hz = numbers(finding.text)[:2]
    assert finding.text.startswith("battery_")
    assert frequency_hz == pytest.approx(83.0, abs=0.5)
    assert finding.lines_hz == pytest.approx([83.0], abs=0.5)
    assert amplitude == pytest.approx(0.03 if "voltage" in finding.text else 0.1, rel=0.15)


ONE_FEED = tuple((strokes_hz, 3.0) for strokes_hz, _ in TRIALS)


def test_a_ripple_of_the_supply_is_no_wave_of_the_wood_where_all_trials_cut_at_one_feed():
    """As seen: 0.28 V at 69 Hz in every trial, 0.05 mm of the feed, and no idle run."""
    finding = campaign(ripple, plan=ONE_FEED)
    assert finding is not None
    assert finding.lines_hz == pytest.approx([83.0], abs=0.5)


@pytest.mark.parametrize("plan", [ONE_FEED, tuple((14.3, 3.0) for _ in TRIALS)])
@pytest.mark.parametrize("seed", [1, 2])
def test_grain_is_the_woods_where_all_trials_cut_at_one_feed(plan, seed):
    """At one stroke rate too, where the lines beside the harmonics stand at one frequency."""
    assert campaign(grain, plan=plan, seed=seed) is None


def test_blows_in_air_too_that_the_motor_feels_are_found():
    finding = campaign(blows)
    assert finding is not None
    assert "bursts in force_n" in finding.text


@pytest.mark.parametrize("disturb", [nothing, hum, grain, stray_values, bursts])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_scatter_hum_of_one_sensor_and_the_wood_are_left_alone(disturb, seed):
    assert campaign(disturb, seed=seed) is None


def test_bursts_under_load_only_may_be_knots():
    def knots(rng, time_s, turns, feed):
        return bursts(rng, time_s, turns, feed) if feed else {}

    assert campaign(knots) is None


def test_a_step_of_the_converter_is_no_strike():
    """In a force of nearly no noise, the last bit that flips for a few milliseconds is far off all other strokes."""

    def flips(rng, time_s, turns, feed):
        felt = blows(rng, time_s, turns, feed)
        return {**felt, FORCE.name: np.round(felt[FORCE.name] / 40.0)}

    still = {FORCE.name: 1e-12, MOTOR_CURRENT.name: 0.2}
    assert campaign(flips, noise=still, resolution=1.0) is None
    assert campaign(flips, noise=still, resolution=0.01) is not None


def mains(rng, time_s, turns, feed):
    """50 Hz in force and current, as their cables pick it up."""
    wave = np.cos(2.0 * np.pi * 50.0 * time_s + rng.uniform(0.0, 6.0))
    return {FORCE.name: 4.0 * wave, MOTOR_CURRENT.name: 0.4 * wave}


@pytest.mark.parametrize("seed", [1, 2])
def test_hum_of_single_sensors_is_measured(seed):
    found = {line.channel: line for line in fixed_lines(trials(mains, seed=seed))}
    assert set(found) == {FORCE.name, MOTOR_CURRENT.name}
    for channel, amplitude in ((FORCE.name, 4.0), (MOTOR_CURRENT.name, 0.4)):
        assert found[channel].frequency_hz == pytest.approx(50.0, abs=0.2)
        assert found[channel].amplitude == pytest.approx(amplitude, rel=0.1)


def test_hum_that_hides_beside_a_harmonic_is_as_large_as_what_stands_there():
    """Four strokes of 12.4 Hz take 49.6: no line there is told from the wood's, and in step it is no line at all."""

    def with_overtones(rng, time_s, turns, feed_mm_s):
        phase = 2.0 * np.pi * 50.1 * time_s + rng.uniform(0.0, 6.0)
        return {MOTOR_CURRENT.name: 0.4 * np.cos(phase) + 0.1 * np.cos(2.0 * phase) + 0.1 * np.cos(3.0 * phase)}

    nearly_in_step = [(12.4 + 0.01 * k, feed) for k, feed in enumerate((None, 2.0, 3.0, 3.0, 4.0))]
    found = trials(with_overtones, plan=[*nearly_in_step, (12.525, 3.0)])
    seen = {round(line.frequency_hz / 50.1): line.amplitude for line in fixed_lines(found)}
    assert set(seen) == {2, 3}
    lines = {round(line.frequency_hz / 50.1): line for line in hum_lines(found)}
    assert {n: lines[n].amplitude for n in seen} == seen
    assert lines[1].frequency_hz == pytest.approx(50.1, abs=0.1)
    assert lines[1].amplitude == pytest.approx(0.4, rel=0.1)
    assert max(line.amplitude for n, line in lines.items() if n > 3) < 0.02
    assert {n for n, line in lines.items() if not line.hides} == set(seen)
    campaign = SimpleNamespace(plant=SimpleNamespace(known=()), health=(), off_stroke=found)
    said = [one["words"] for one in signal_findings(campaign, None)]
    assert len(said) == 3
    assert re.match(r"hum of up to 0\.\d+ A at 50\.\d Hz, beside a harmonic of the stroke: mains pickup", said[-1])
    assert hum_lines(trials(lambda *_: {})) == []


def test_hum_in_several_cables_is_hum():
    """Four campaigns with 1 N and 0.01 A at 50 Hz were an unknown cause, whatever they held."""

    def in_all(rng, time_s, turns, feed):
        found = mains(rng, time_s, turns, feed)
        return found | {BATTERY_CURRENT.name: 0.02 * found[FORCE.name], BATTERY_VOLTAGE.name: 0.01 * found[FORCE.name]}

    assert campaign(in_all) is None
    found = {line.channel for line in fixed_lines(trials(in_all))}
    assert {FORCE.name, MOTOR_CURRENT.name, BATTERY_CURRENT.name} <= found


@pytest.mark.parametrize(("line_hz", "is_gap"), [(333.0, True), (1011.0, False)])
def test_the_switching_of_a_converter_is_no_gap(line_hz, is_gap):
    """Or its alias, in current and voltage: the model has means over it. A supply that ripples slower is a gap."""

    def switched(rng, time_s, turns, feed):
        wave = np.cos(2.0 * np.pi * line_hz * time_s + rng.uniform(0.0, 6.0))
        return {BATTERY_VOLTAGE.name: 0.03 * wave, MOTOR_CURRENT.name: 0.5 * wave}

    assert (campaign(switched) is not None) == is_gap
    picked_up = {line.channel for line in fixed_lines(trials(switched))}
    assert picked_up == (set() if is_gap else {BATTERY_VOLTAGE.name, MOTOR_CURRENT.name})


@pytest.mark.parametrize(("share", "is_gap"), [(0.003, False), (0.03, True)])
def test_less_than_a_hundredth_of_the_mean_at_a_fixed_frequency_is_switching_that_sampling_placed_there(share, is_gap):
    """As seen: 4 mV of 18 V at 781 Hz made the cause of every gap of a bench "unknown", with more than 99 %."""

    def switched(rng, time_s, turns, feed):
        wave = 1.0 + share * np.cos(2.0 * np.pi * 333.0 * time_s + rng.uniform(0.0, 6.0))
        return {BATTERY_VOLTAGE.name: 18.0 * wave, MOTOR_CURRENT.name: 10.0 * wave}

    noise = {**QUIET, BATTERY_VOLTAGE.name: 0.003}
    assert (campaign(switched, noise=noise) is not None) == is_gap
    listed = {line.channel for line in fixed_lines(trials(switched, noise=noise))}
    assert listed == (set() if is_gap else {BATTERY_VOLTAGE.name, MOTOR_CURRENT.name})


@pytest.mark.parametrize(("share", "is_gap"), [(0.003, False), (0.03, True)])
def test_what_shakes_the_table_is_no_gap_as_long_as_the_currents_hardly_show_it(share, is_gap):
    """An extractor beside the bench: a newton of the force at 43 Hz, and what the cut makes of it."""

    def shaken(rng, time_s, turns, feed):
        wave = np.cos(2.0 * np.pi * 43.0 * time_s + rng.uniform(0.0, 6.0))
        currents = 1.0 + share * wave
        return {FORCE.name: wave, MOTOR_CURRENT.name: 10.0 * currents, BATTERY_CURRENT.name: 8.0 * currents}

    noise = dict.fromkeys(NOISE, 0.01)
    assert (campaign(shaken, noise=noise) is not None) == is_gap
    listed = {line.channel for line in fixed_lines(trials(shaken, noise=noise))}
    assert listed == (set() if is_gap else {FORCE.name, MOTOR_CURRENT.name, BATTERY_CURRENT.name})


@pytest.mark.parametrize(("of_motor", "is_current"), [(0.5, True), (1.0, False), (0.3, False)])
def test_a_charger_that_stays_connected_is_no_hum(of_motor, is_current):
    """Both currents at twice the mains' frequency: the battery's is duty times that of the motor, or any."""

    def charged(rng, time_s, turns, feed):
        wave = np.cos(2.0 * np.pi * 100.0 * time_s + rng.uniform(0.0, 6.0))
        return {BATTERY_VOLTAGE.name: 0.03 * wave, MOTOR_CURRENT.name: wave, BATTERY_CURRENT.name: of_motor * wave}

    found = campaign(charged)
    assert (found is not None) == is_current
    picked_up = {line.channel for line in fixed_lines(trials(charged))}
    assert picked_up == (set() if is_current else {BATTERY_VOLTAGE.name, MOTOR_CURRENT.name, BATTERY_CURRENT.name})
    if is_current:
        # Seven strokes of 14.3 Hz and six of 16.7 Hz take nearly as long.
        assert re.search(r"at 100\.\d Hz at any stroke rate, in 4 of 6 trials", found.text)


def test_hum_is_no_order_of_the_stroke_where_all_trials_run_at_one_speed():
    one_speed = tuple((13.7 + 0.02 * k, None) for k in range(6))
    assert campaign(mains, plan=one_speed) is None
    assert campaign(at_order, plan=one_speed) is not None


def test_hum_is_no_order_of_the_stroke_where_the_speed_settles():
    """As seen: 50 Hz beside 43 to 46 strokes a second in three idle runs, 1.09 cycles a stroke of the last of them."""
    plan = (*((45.9, None) for _ in range(3)), (19.1, 3.0), (24.3, 6.0), (31.2, 6.0))
    assert campaign(mains, plan=plan, slower=0.06) is None
    found = campaign(at_order, plan=plan, slower=0.06)
    assert found is not None
    assert "cycles per stroke" in found.text


@pytest.mark.parametrize("disturb", [nothing, at_order, ripple, grain])
def test_what_the_machine_or_the_wood_does_is_no_hum(disturb):
    assert fixed_lines(trials(disturb)) == []


def aliased(rng, time_s, turns, feed):
    """A ripple above half the sample rate: wherever the sample clock puts it in this trial, in air as well."""
    return {MOTOR_CURRENT.name: 0.8 * np.cos(2.0 * np.pi * rng.uniform(5.0, 13.0) * time_s)}


def test_a_line_at_another_frequency_in_every_trial_is_named_with_its_range():
    (line,) = wandering_lines(trials(aliased))
    assert (line.channel, line.amplitude) == (MOTOR_CURRENT.name, pytest.approx(0.8, rel=0.1))
    assert 5.0 <= line.lowest_hz < line.highest_hz <= 13.0
    assert campaign(aliased) is None


@pytest.mark.parametrize("disturb", [nothing, at_order, ripple, grain, hum, mains, bursts, blows])
def test_what_has_a_place_or_is_in_the_wood_is_no_wandering_line(disturb):
    assert wandering_lines(trials(disturb)) == []


def bursts_in_hum(rng, time_s, turns, feed):
    return {FORCE.name: bursts(rng, time_s, turns, feed)[FORCE.name] + mains(rng, time_s, turns, feed)[FORCE.name]}


@pytest.mark.parametrize("disturb", [bursts, bursts_in_hum])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bursts_of_one_sensor_are_measured(seed, disturb):
    found = foreign_bursts(trials(disturb, seed=seed))
    assert set(found) == {FORCE.name}
    assert found[FORCE.name].size == pytest.approx(40.0, rel=0.15)
    assert found[FORCE.name].per_s == pytest.approx(12.0 / DURATION_S, rel=0.3)


@pytest.mark.parametrize("disturb", [blows, nothing, grain, stray_values])
def test_blows_that_the_motor_feels_are_no_fault_of_a_sensor(disturb):
    assert foreign_bursts(trials(disturb)) == {}


def test_what_stands_in_a_gap_of_the_samples_is_no_burst():
    """All channels lose 20 ms now and then, and the angle that is read across a gap is off by a fifth of a turn."""
    rng = np.random.default_rng(8)
    found = []
    for number, (strokes_hz, feed_mm_s) in enumerate(TRIALS):
        whole_s = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
        away = np.zeros(len(whole_s))
        for start_s in rng.uniform(0.2, DURATION_S - 0.2, 4):
            away = np.maximum(away, np.exp(-0.5 * ((whole_s - start_s) / 0.01) ** 2))
        is_kept = away < np.exp(-0.5)
        turns = strokes_hz * whole_s
        wave = np.sin(2.0 * np.pi * turns) + 0.3 * np.cos(6.0 * np.pi * turns)
        names = {DISPLACEMENT.name: 0.01, **NOISE}
        signals = {
            name: signal(name, whole_s[is_kept], (10.0 * std * wave + std * rng.standard_normal(len(wave)))[is_kept])
            for name, std in names.items()
        }
        angle = CrankAngle(
            time_s=whole_s, angle_rad=2.0 * np.pi * (turns + 0.2 * away),
            speed_rad_s=np.full(len(whole_s), 2.0 * np.pi * strokes_hz), angle_std_rad=np.zeros(len(whole_s)),
            radius_m=0.01, source=DISPLACEMENT.name, is_absolute=True,
        )  # fmt: skip
        material = "none" if feed_mm_s is None else "oak"
        trial = Trial(trial_id=f"t{number}", duty=0.5, material=material, feed_mm_s=feed_mm_s)
        found.append(off_stroke(processed_trial(trial, signals, angle, 0.0, DURATION_S)))
    assert off_stroke_findings(found) == []
    assert foreign_bursts(found) == {}


def test_where_most_strokes_lack_samples_the_others_are_no_bursts():
    rng = np.random.default_rng(4)
    left = rng.standard_normal((80, 64))
    left[rng.random(80) < 0.7] = 0.0
    found = strikes(left, 1e-3, 12.0)
    assert (found.size, found.per_s, found.share) == (0.0, 0.0, 0.0)
    struck = left.copy()
    measured = np.flatnonzero(left.any(axis=1))
    struck[measured[3], 20:24] = 40.0
    assert strikes(struck, 1e-3, 12.0).size == pytest.approx(40.0)
    assert strikes(struck, 1e-3, 12.0).per_s == pytest.approx(12.0 / len(measured))
    assert strikes(np.zeros((80, 64)), 1e-3, 12.0).size == 0.0


def test_what_the_start_leaves_in_the_first_strokes_is_no_strike():
    rng = np.random.default_rng(4)
    left = rng.standard_normal((60, 64))
    start = 30.0 * np.exp(-np.arange(left.size).reshape(left.shape) / 70.0)
    assert strikes(left + start, 1e-3, 12.0).per_s == 0.0
    blow = np.zeros_like(left)
    blow[30, 10:14] = 40.0
    found = strikes(left + start + blow, 1e-3, 12.0)
    assert found.per_s == pytest.approx(12.0 / len(left))
    assert found.size == pytest.approx(40.0, abs=3.0)


def test_a_few_samples_a_cell_of_a_steep_stroke_make_no_line():
    """4 kHz and up to 6.3 samples a cell: their means beat with 3 % of the stroke's height."""

    def stroke(rng, time_s, turns, feed):
        return {DISPLACEMENT.name: 10.0 * (1.0 - np.cos(2.0 * np.pi * strokes_hz * time_s))}

    for strokes_hz in (17.645, 14.3, 11.9):
        (found,) = trials(
            stroke, noise={DISPLACEMENT.name: 0.003}, plan=((strokes_hz, None),), rate_hz=4000.0, wander=0.0
        )
        for over in ("stroke", "time"):
            assert all(p.amplitude < 0.003 for p in found.peaks[over, DISPLACEMENT.name])


def slips(rng, time_s, turns, feed):
    """A carriage that creeps and lets go 2.3 times a second, in air too."""
    phase = 2.3 * time_s + rng.uniform() + 0.08 * np.sin(2.0 * np.pi * 0.3 * time_s)
    return {FORCE.name: 6.0 * (2.0 * np.mod(phase, 1.0) ** 1.5 - 0.8)}


def slips_under_load(rng, time_s, turns, feed):
    return {} if feed is None else slips(rng, time_s, turns, feed)


def walks(rng, time_s, turns, feed):
    return {FORCE.name: 3.0 * np.cumsum(rng.standard_normal(len(time_s))) / np.sqrt(RATE_HZ)}


def hum_beside_a_harmonic(rng, time_s, turns, feed):
    """Mains at 0.03 cycles a stroke off a harmonic, a slow wave to whoever reads one value a stroke."""
    strokes_hz = turns[-1] / time_s[-1]
    return {FORCE.name: 3.0 * np.cos(2.0 * np.pi * (round(50.0 / strokes_hz) + 0.03) * turns + rng.uniform(0.0, 6.0))}


@pytest.mark.parametrize("duration_s", [3.0, 6.0])
def test_a_carriage_that_sticks_and_slips_is_found(duration_s):
    finding = campaign(slips, duration_s=duration_s)
    assert finding is not None
    assert "sticks and slips" in finding.text
    assert finding.lines_hz == pytest.approx([2.3], abs=0.1)
    amplitude, at_hz = numbers(finding.text)[:2]
    # The first harmonic of the creep; a taper over the half turn takes little of it.
    phase = np.arange(0.0, 1.0, 1e-4)
    first = 2.0 * abs(np.mean(12.0 * phase**1.5 * np.exp(2j * np.pi * phase)))
    assert amplitude == pytest.approx(first, rel=0.15)
    assert at_hz == pytest.approx(2.3, abs=0.1)


@pytest.mark.parametrize("disturb", [slips_under_load, walks, hum_beside_a_harmonic])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_zero_that_walks_and_what_is_not_in_air_is_no_slow_wave(disturb, seed):
    found = off_stroke_findings(trials(disturb, seed=seed))
    assert not [f for f in found if "sticks and slips" in f.text]


@pytest.mark.parametrize("mains_hz", [59.92, 60.0, 60.08])
def test_hum_between_two_places_of_the_spectrum_is_no_slow_wave(mains_hz):
    """Read once a stroke of 24.7 a second it would be one of 10.6 Hz."""

    def pickup(rng, time_s, turns, feed):
        return {FORCE.name: 3.0 * np.sin(2.0 * np.pi * mains_hz * time_s + rng.uniform(0.0, 6.0))}

    plan = ((24.71, None), (24.73, None), (24.7, None), (24.72, None))
    quiet = {**NOISE, FORCE.name: 0.3}
    assert campaign(pickup, plan=plan, noise=quiet, wander=0.0) is None


def test_a_force_that_stands_still_has_no_slow_wave():
    at_s = np.arange(40)[:, None] / 15.0 + np.arange(64) / 960.0
    assert slow_wave(at_s, np.zeros((40, 64))) is None
    assert slow_wave(at_s, 1e-15 * np.sin(at_s)) is None


@pytest.mark.parametrize("order", [13.15, 6.85])
def test_an_order_near_a_harmonic_is_no_wave_of_the_wood_where_the_feed_a_stroke_differs(order):
    """As seen: a rotor out of balance behind a gear of 13.15, no idle run, feeds a stroke that differ by half."""

    def unbalance(rng, time_s, turns, feed):
        return {FORCE.name: 4.0 * np.cos(2.0 * np.pi * order * turns + rng.uniform(0.0, 6.0))}

    plan = ((10.1, 3.0), (10.2, 3.0), (12.6, 3.0), (12.8, 3.0), (15.7, 3.0), (15.6, 3.0))
    finding = campaign(unbalance, plan=plan)
    assert finding is not None
    assert f"{order:.2f} cycles per stroke" in finding.text
    assert campaign(grain, plan=plan) is None


GEAR = 8.83
QUIET = {**NOISE, FORCE.name: 0.03, MOTOR_CURRENT.name: 0.03}


@pytest.mark.parametrize(
    ("channel", "times_a_turn", "share", "is_found"),
    [
        (MOTOR_CURRENT.name, 1.0, 0.005, False),
        (MOTOR_CURRENT.name, 7.0, 0.03, False),
        (MOTOR_CURRENT.name, 10.0, 0.005, False),
        (MOTOR_CURRENT.name, 2.0, 0.03, True),
        (MOTOR_CURRENT.name, 7.0, 0.08, True),
        (MOTOR_CURRENT.name, 6.5, 0.005, True),
        (FORCE.name, 7.0, 0.005, True),
    ],
    ids=["uneven armature", "bars", "fast bars", "shorted coil", "too much", "no whole multiple", "force"],
)
def test_a_commutator_ripples_at_whole_multiples_of_the_turns_of_the_motor(channel, times_a_turn, share, is_found):
    """Of a current of 10 A at most, 6 A in air."""

    def ripple(rng, time_s, turns, feed):
        wave = np.cos(2.0 * np.pi * times_a_turn * GEAR * turns + rng.uniform(0.0, 6.0))
        return {channel: (6.0 if feed is None else 10.0) + 10.0 * share * wave}

    found = trials(ripple, noise=QUIET)
    assert off_stroke_findings(found)
    assert bool(off_stroke_findings(found, GEAR)) == is_found


def test_a_shorted_coil_is_found_beside_a_ripple_of_the_bars_that_is_larger():
    def ripple(rng, time_s, turns, feed):
        bars, coil = (np.cos(2.0 * np.pi * times * GEAR * turns + rng.uniform(0.0, 6.0)) for times in (7.0, 2.0))
        return {MOTOR_CURRENT.name: 10.0 + 0.4 * bars + 0.3 * coil}

    (finding,) = off_stroke_findings(trials(ripple, noise=QUIET), GEAR)
    amplitude, order = numbers(finding.text)[:2]
    assert order == pytest.approx(2.0 * GEAR, abs=0.02)
    assert amplitude == pytest.approx(0.3, rel=0.1)


@pytest.mark.parametrize(("times_a_turn", "is_found"), [(7.0, False), (7.4, True)])
def test_at_one_speed_a_commutator_ripples_at_one_frequency(times_a_turn, is_found):
    """Two currents show it, as they show the ripple of a supply."""

    def ripple(rng, time_s, turns, feed):
        wave = np.cos(2.0 * np.pi * times_a_turn * GEAR * turns + rng.uniform(0.0, 6.0))
        return {MOTOR_CURRENT.name: 10.0 + 0.2 * wave, BATTERY_CURRENT.name: 8.0 + 0.15 * wave}

    found = trials(
        ripple, noise={**QUIET, BATTERY_CURRENT.name: 0.02}, plan=((14.3, None), (14.31, None), (14.29, 3.0))
    )
    assert off_stroke_findings(found)
    assert bool(off_stroke_findings(found, GEAR)) == is_found


@pytest.mark.parametrize(("n_in_air", "is_found"), [(1, True), (0, False)])
def test_in_air_a_line_is_compared_with_what_scatters_without_the_wood(n_in_air, is_found):
    """As seen: a rotor out of balance of 1.5 N, below a tenth of what the wood scatters by from stroke to stroke."""

    def unbalance_in_uneven_wood(rng, time_s, turns, feed):
        hardness = 0.0 if feed is None else 14.0 * rng.standard_normal(int(turns[-1]) + 2)[turns.astype(int)]
        cut = hardness * np.maximum(np.sin(2.0 * np.pi * turns), 0.0)
        return {FORCE.name: cut + 1.5 * np.cos(2.0 * np.pi * 8.215 * turns + rng.uniform(0.0, 6.0))}

    loaded = ((14.8, 3.0), (11.9, 3.0), (11.8, 6.0), (14.7, 6.0), (11.75, 3.0))
    found = trials(unbalance_in_uneven_wood, plan=(*[(23.1, None)] * n_in_air, *loaded))
    shares = [peak.share for t in found if not t.is_idle for peak in t.peaks["stroke", FORCE.name]]
    assert np.median(shares) < 0.1
    assert bool(off_stroke_findings(found)) == is_found


def test_a_channel_that_ends_before_the_strokes_does_not_count():
    time_s = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
    turns = 14.3 * time_s
    wave = np.sin(2.0 * np.pi * turns) + 0.1 * np.random.default_rng(5).standard_normal(len(time_s))
    early = time_s < 2.0
    signals = {
        FORCE.name: signal(FORCE.name, time_s[early], wave[early]),
        MOTOR_CURRENT.name: signal(MOTOR_CURRENT.name, time_s, wave),
    }
    angle = CrankAngle(
        time_s=time_s,
        angle_rad=2.0 * np.pi * turns,
        speed_rad_s=np.full(len(time_s), 2.0 * np.pi * 14.3),
        angle_std_rad=np.zeros(len(time_s)),
        radius_m=0.01,
        source="displacement_mm",
        is_absolute=True,
    )
    trial = Trial(trial_id="t", duty=0.5, material="none")
    found = off_stroke(processed_trial(trial, signals, angle, 3.0, DURATION_S))
    assert {name for _, name in found.peaks} == {MOTOR_CURRENT.name}
