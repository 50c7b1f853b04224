"""Mean strokes of channels that are sampled slowly, while the hardness changes from stroke to stroke."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.bench.processed import CrankAngle, Cut
from sawbench.bench.recording import Signal, Trial
from sawbench.diagnosis.campaign import used_in_part
from sawbench.diagnosis.hardness import with_guesses
from sawbench.diagnosis.inference.features import START_UP_EDGES_S, Layout, harmonics, time_bins, times_over_angles
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.diagnosis.reduction import between_samples, running_state, share_switched_on, start_up_state
from sawbench.diagnosis.stroke_means import stroke_means
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.state import TWO_PI, Motion, angle_derivative

from tests.rigs.drawn_states import BASELINE, setting_of
from tests.rigs.processed import processed_trial
from tests.rigs.scattered_strokes import strokes

pytestmark = pytest.mark.unit

STROKES_HZ, SECONDS, SETTLED_S = 13.7, 1.0, 0.2
STROKE_STD = 0.05


def wave(turn):
    """Current of one stroke, A: up to the fourth harmonic."""
    return 8.0 + 3.0 * np.cos(turn) + 1.5 * np.sin(2 * turn) + 0.6 * np.cos(3 * turn + 1.0) + 0.3 * np.sin(4 * turn)


def current(rate_hz, seed, *, phase_s=0.00025):
    """Samples of a current whose strokes differ in height, evenly turning."""
    time_s = phase_s + np.arange(int(SECONDS * rate_hz)) / rate_hz
    turned = TWO_PI * STROKES_HZ * time_s
    heights = 1.0 + STROKE_STD * np.random.default_rng(seed).standard_normal(int(turned[-1] / TWO_PI) + 3)
    # From one height to the next in the middle of the stroke: no jump.
    height = np.interp(turned / TWO_PI, np.arange(len(heights)), heights)
    return Signal(channel="motor_current_a", unit="A", time_s=time_s, values=height * wave(turned))


def state_of(signal):
    time_s = np.arange(0.0, SECONDS, 1e-3)
    turned = TWO_PI * STROKES_HZ * time_s
    angle = CrankAngle(
        time_s=time_s, angle_rad=turned, speed_rad_s=np.full(len(time_s), TWO_PI * STROKES_HZ),
        angle_std_rad=np.zeros(len(time_s)), radius_m=0.01, source="test", is_absolute=True,
    )  # fmt: skip
    trial = processed_trial(
        Trial(trial_id="t", duty=0.5, material="oak"), {signal.channel: signal}, angle, SETTLED_S, SECONDS - 0.01
    )
    state = running_state(trial, setting_of(is_idle=False))
    assert state is not None and state.current_a is not None
    return state


def mean_stroke(signal):
    state = state_of(signal)
    return harmonics(np.average(state.current_a, axis=0, weights=state.n_strokes)[None], 12)[0]


@pytest.mark.parametrize("seed", range(5))
def test_few_strokes_sampled_slowly_have_the_mean_stroke_of_many_samples(seed):
    # 30 kHz leaves no doubt: 2200 samples a stroke.
    exact = mean_stroke(current(30_000.0, seed))
    slow = mean_stroke(current(1000.0, seed))
    assert np.abs(slow - exact).max() < 0.006


def test_a_channel_with_samples_enough_stays_as_it_is():
    signal = current(5000.0, seed=1)
    assert between_samples(signal, 1.0 / STROKES_HZ) is signal


def test_nothing_is_put_where_samples_are_missing():
    whole = current(1000.0, seed=1)
    kept = (whole.time_s < 0.5) | (whole.time_s > 0.53)
    holed = Signal(channel=whole.channel, unit="A", time_s=whole.time_s[kept], values=whole.values[kept])
    dense = between_samples(holed, 1.0 / STROKES_HZ)
    assert len(dense.time_s) > 2 * len(holed.time_s)
    assert not np.any((dense.time_s > 0.5005) & (dense.time_s < 0.5295))
    assert np.interp(holed.time_s[5:-5], dense.time_s, dense.values) == pytest.approx(holed.values[5:-5], abs=1e-9)


def test_a_slow_channel_says_which_harmonics_its_samples_resolve():
    assert state_of(current(5000.0, 1)).resolved_orders == {}
    # 36.5 samples a stroke: no unit mixes strokes, and four samples a harmonic are 9.1 harmonics.
    assert state_of(current(500.0, 1)).resolved_orders == pytest.approx({"current_a": 500.0 / STROKES_HZ / 4.0})
    assert state_of(current(150.0, 1)).resolved_orders == pytest.approx({"current_a": 150.0 / STROKES_HZ / 4.0})


@pytest.mark.parametrize("rate_hz", [150.0, 70.0, 30.0])
def test_a_channel_of_few_samples_a_stroke_scatters_by_as_much_as_its_mean_is_off(rate_hz):
    found = [state_of(current(rate_hz, seed)).current_a.mean(axis=1) for seed in range(6)]
    exact = mean_stroke(current(30_000.0, 1))[0]
    assert min(map(len, found)) >= 8
    off = np.array([rows.mean() - exact for rows in found])
    said = np.sqrt([rows.var(ddof=1) / len(rows) for rows in found])
    assert np.abs(off / said).max() < 4.0


@pytest.mark.parametrize(("rate_hz", "n_orders"), [(500.0, 8), (300.0, 5), (150.0, 2), (100.0, 1)])
@pytest.mark.parametrize("seed", range(3))
def test_what_a_slow_channel_resolves_is_right_although_strokes_differ(seed, rate_hz, n_orders):
    exact, slow = mean_stroke(current(30_000.0, seed)), mean_stroke(current(rate_hz, seed))
    resolved = np.r_[: n_orders + 1, 13 : 13 + n_orders]
    assert np.abs(slow - exact)[resolved].max() < 0.006


@pytest.mark.parametrize("samples_a_stroke", [20, 24, 30])
def test_a_channel_whose_samples_lie_at_the_same_angles_in_every_stroke_is_there(samples_a_stroke):
    exact = mean_stroke(current(30_000.0, 1))
    slow = mean_stroke(current(samples_a_stroke * STROKES_HZ, 1))
    resolved = np.r_[:6, 13 : 13 + 5]
    assert np.abs(slow - exact)[resolved].max() < 0.006


@pytest.mark.parametrize("samples_a_stroke", [20, 24, 30])
def test_a_displacement_whose_samples_lie_at_the_same_angles_in_every_stroke_costs_no_trial(samples_a_stroke):
    """A fifth to a quarter of the cells, the same in every stroke; the speed of the crank swings twice a stroke."""
    time_s = np.arange(0.0, SECONDS, 1.0 / (samples_a_stroke * STROKES_HZ))
    # Evenly turning but for a little, so that times and angles lie at the same places in every stroke.
    turned = TWO_PI * STROKES_HZ * time_s
    speed = TWO_PI * STROKES_HZ * (1.0 + 0.02 * np.cos(2.0 * turned))
    angle = CrankAngle(
        time_s=time_s, angle_rad=turned + 0.01 * np.sin(2.0 * turned), speed_rad_s=speed,
        angle_std_rad=np.zeros(len(time_s)), radius_m=0.01, source="test", is_absolute=True,
    )  # fmt: skip
    signal = replace(current(samples_a_stroke * STROKES_HZ, 1), time_s=time_s, values=wave(turned))
    trial = processed_trial(
        Trial(trial_id="t", duty=0.5, material="oak"), {signal.channel: signal}, angle, SETTLED_S, SECONDS - 0.01
    )
    state = running_state(trial, setting_of(is_idle=False))
    assert state is not None
    assert state.n_strokes.sum() >= 8
    expected = TWO_PI * STROKES_HZ * (1.0 + 0.02 * np.cos(2.0 * state.angle_rad))
    assert np.abs(state.speed_rad_s / expected - 1.0).max() < 0.003


def test_a_machine_that_still_settles_accelerates():
    """Slow, as weak magnets make it: 4 % of the speed and 2 A are left when the strokes count as settled."""
    time_s, fading_s, rate = np.arange(0.0, 2.0, 2e-5), 0.25, TWO_PI * STROKES_HZ
    left = np.exp(-(time_s - SETTLED_S) / fading_s)
    turned = rate * (time_s + 0.04 * fading_s * left)
    angle_rad = turned + 0.01 * np.sin(2.0 * turned)
    speed = np.gradient(angle_rad, time_s)
    angle = CrankAngle(
        time_s=time_s, angle_rad=angle_rad, speed_rad_s=speed, angle_std_rad=np.zeros(len(time_s)), radius_m=0.01,
        source="test", is_absolute=True,
    )  # fmt: skip
    values = wave(angle_rad) + 2.0 * left
    signal = Signal(channel="motor_current_a", unit="A", time_s=time_s, values=values)
    trial = processed_trial(
        Trial(trial_id="t", duty=0.5, material="oak"), {signal.channel: signal}, angle, SETTLED_S, 1.95
    )
    state = running_state(trial, setting_of(is_idle=False))
    assert state is not None
    true = {"acceleration_rad_s2": np.gradient(speed, time_s), "current_rate_a_s": np.gradient(values, time_s)}
    first = state.n_strokes[0] * TWO_PI
    begins = TWO_PI * np.ceil(np.interp(SETTLED_S, time_s, angle_rad) / TWO_PI)
    inside = (angle_rad >= begins) & (angle_rad < begins + first)
    cell = np.floor(angle_rad[inside] % TWO_PI / TWO_PI * 128).astype(int)
    for name, rates in true.items():
        mean = np.bincount(cell, rates[inside], 128) / np.bincount(cell, minlength=128)
        exact, found = harmonics(mean[None], 8)[0], harmonics(getattr(state, name)[:1], 8)[0]
        assert abs(exact[0]) > 1.0
        assert np.abs(found - exact).max() < 0.2 * abs(exact[0])
    means = state.acceleration_rad_s2.mean(axis=1)
    assert abs(means[-1]) < 0.01 * means[0]


def spin_up(*, missing_s=(), of="motor_current_a", slow_hz=None):
    """A spin-up from rest within 50 ms at 1.3 kHz; samples missing from one time to another, or a slow current."""
    time_s = np.arange(0.0, SECONDS, 1.0 / 1300.0)
    speed = TWO_PI * STROKES_HZ * (1.0 - np.exp(-time_s / 0.05))
    kept = {
        name: np.ones(len(time_s), dtype=bool) for name in ("displacement_mm", "motor_current_a", "battery_voltage_v")
    }
    if missing_s:
        kept[of] = (time_s <= missing_s[0]) | (time_s >= missing_s[1])
    seen = kept["displacement_mm"]
    angle = CrankAngle(
        time_s=time_s[seen], angle_rad=(np.cumsum(speed) / 1300.0)[seen], speed_rad_s=speed[seen],
        angle_std_rad=np.zeros(int(seen.sum())), radius_m=0.01, source="test", is_absolute=True,
    )  # fmt: skip
    channels = {
        name: Signal(
            channel=name, unit=unit, time_s=time_s[kept[name]], values=level * np.exp(-time_s[kept[name]] / 0.1)
        )
        for name, unit, level in (("motor_current_a", "A", 40.0), ("battery_voltage_v", "V", 18.0))
    }
    if slow_hz is not None:
        at_s = np.arange(0.0, SECONDS, 1.0 / slow_hz)
        channels["motor_current_a"] = replace(
            channels["motor_current_a"], time_s=at_s, values=40.0 * np.exp(-at_s / 0.1)
        )
    trial = processed_trial(Trial(trial_id="t", duty=0.5, material="oak"), channels, angle, SETTLED_S, SECONDS - 0.01)
    return start_up_state(trial, setting_of(is_idle=False))


def test_a_start_up_is_not_made_up_where_samples_are_missing():
    """Of 37 ms without motion or current the balance was off by ninety times its noise."""
    assert spin_up().battery_voltage_v is not None
    assert spin_up(missing_s=(0.2, 0.2022)) is not None  # two samples: no gap
    assert spin_up(missing_s=(0.12, 0.157)) is None
    assert spin_up(missing_s=(0.12, 0.157), of="displacement_mm") is None
    without_voltage = spin_up(missing_s=(0.12, 0.157), of="battery_voltage_v")
    assert without_voltage.current_a is not None
    assert without_voltage.battery_voltage_v is None
    assert spin_up(missing_s=(0.5, 0.6)) is not None  # after the spin-up


@pytest.mark.parametrize("slow_hz", [100.0, 200.0, 400.0])
def test_a_slow_channel_of_a_start_up_says_how_long_the_means_are_that_it_resolves(slow_hz):
    exact, slow = spin_up(), spin_up(slow_hz=slow_hz)
    assert slow.resolved_s == pytest.approx({"current_a": 2.0 / slow_hz})
    assert exact.resolved_s == {}
    edges_s = np.array(START_UP_EDGES_S)
    # The first two samples of a current that jumps show no more than that it did.
    resolved = (np.diff(edges_s) >= 2.0 / slow_hz) & (edges_s[:-1] >= 2.0 / slow_hz)
    assert resolved.any()
    assert time_bins(slow.current_a)[0, resolved] == pytest.approx(time_bins(exact.current_a)[0, resolved], rel=0.02)
    assert np.array_equal(slow.battery_voltage_v, exact.battery_voltage_v)


def test_what_a_slow_channel_of_a_start_up_does_not_resolve_is_not_compared():
    plant, layout = Jigsaw(baseline=BASELINE), Layout(kind="start_up", equations=("electrical", "supply"))
    state = spin_up()
    slow = replace(state, resolved_s={"current_a": 0.02})
    by_slow, by_fast = (np.diag(plant.model_error(layout, s))[layout.slices["electrical"]] for s in (slow, state))
    is_long = np.diff(START_UP_EDGES_S) >= 0.02
    assert np.array_equal(by_slow[is_long], by_fast[is_long])
    assert np.all(by_slow[~is_long] > 1e6 * by_fast[~is_long])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [0.0, 3.0])
def test_a_channel_that_stands_still_has_no_stroke_rate(value):
    """A dead sensor, in a trial without displacement."""
    time_s = np.arange(0.0, 4.0, 1e-3)
    dead = Signal(channel="motor_current_a", unit="A", time_s=time_s, values=np.full(len(time_s), value))
    angle = CrankAngle(
        time_s=time_s, angle_rad=time_s, speed_rad_s=np.ones(len(time_s)), angle_std_rad=np.zeros(len(time_s)),
        radius_m=0.01, source="test", is_absolute=False,
    )  # fmt: skip
    trial = processed_trial(Trial(trial_id="t", duty=0.5, material="none"), {dead.channel: dead}, angle, 0.8, 4.0)
    assert stroke_means(trial, BASELINE) is None


def trials_cut_from(starts_s):
    time_s = np.arange(0.0, 3.0, 1e-3)
    angle = CrankAngle(
        time_s=time_s, angle_rad=TWO_PI * STROKES_HZ * time_s, speed_rad_s=np.full(len(time_s), TWO_PI * STROKES_HZ),
        angle_std_rad=np.zeros(len(time_s)), radius_m=0.01, source="test", is_absolute=True,
    )  # fmt: skip
    end_s = float(time_s[-1])
    for number, start_s in enumerate(starts_s):
        trial = processed_trial(Trial(trial_id=f"t{number}", duty=0.5), {}, angle, 0.8, end_s)
        yield replace(trial, steady=replace(trial.steady, cut=None if start_s is None else Cut(start_s=start_s)))


def test_trials_that_are_used_in_part_are_named_and_many_of_them_in_one_line():
    one = used_in_part([*trials_cut_from([None, 0.5, None])])
    assert one == ["t1: the blade cuts from 0.50 s on; the strokes in air before are left out"]
    (many,) = used_in_part([*trials_cut_from([None, 0.3, 0.4, 0.5, 0.6, 0.7])])
    assert "of 5 of the 6 trials only a part is used" in many
    assert "t1 0.30 to 3.00 s, t2 0.40 to 3.00 s, t3 0.50 to 3.00 s and 2 more" in many


@pytest.mark.parametrize(("onset", "share"), [(-2.3, [1.0] * 6), (2.3, [0.0, 0.0, 0.7, 1.0, 1.0, 1.0])])
def test_a_motor_has_voltage_from_where_its_current_rises(onset, share):
    """A current that rises evenly from its onset, in cells: means of the cells."""
    edges = np.arange(7.0)
    charge = 0.5 * np.maximum(edges - onset, 0.0) ** 2
    assert np.allclose(share_switched_on(np.diff(charge)), share, atol=0.05)


def test_a_swing_of_the_angle_read_changes_no_mean_of_speed_or_acceleration():
    """A crank that turns evenly at 90 rad/s, read off a plunger with play: the speed read swings by a fifth."""
    read_rad = (np.arange(256) + 0.5) * TWO_PI / 256
    crank_per_read = 1.0 - 0.2 * np.cos(3 * read_rad) - 0.1 * np.sin(5 * read_rad)
    speed = (90.0 / crank_per_read)[None]
    acceleration = speed * angle_derivative(speed)
    layout = Layout(
        kind="running", equations=("electrical", "mechanical"), n_harmonics={"electrical": 2, "mechanical": 2}
    )
    state = SimpleNamespace(kind="running", speed_rad_s=speed, motion=Motion(read_rad[None], speed))
    features = layout.place({"electrical": speed, "mechanical": acceleration}, times_over_angles(state))[0]
    assert speed.mean() > 91.5  # over the angle
    assert features[layout.slices["electrical"]][0] == pytest.approx(90.0, abs=1e-6)
    assert features[layout.slices["mechanical"]][0] == pytest.approx(0.0, abs=1e-6)


def test_the_largest_current_is_that_of_a_cut_where_no_start_up_was_recorded():
    """A current limit is a share of it: without one, the effect had no form at all."""
    running = strokes()
    found, _ = with_guesses(BASELINE, running)
    largest_a = max(float(s.current_a.mean(axis=0).max()) for s in running)
    assert {s.top_current_a for s in found} == {largest_a}
    limited = EFFECT_BY_NAME["current_limit"].signatures(BASELINE, found[0], {"share": 0.7, "soft": 1.0})
    assert np.abs(limited[0]["converter"]).max() > 0.0
