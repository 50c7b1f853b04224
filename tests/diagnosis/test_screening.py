"""Wrong input is named before anything is concluded from it; a good campaign passes unharmed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.bench.units import CHANNEL_BY_NAME
from sawbench.blindcheck.campaign import make_campaign
from sawbench.diagnosis import campaign as campaigns
from sawbench.diagnosis.campaign import reduce_campaign
from sawbench.diagnosis.late_clock import keep_what_a_late_clock_does
from sawbench.diagnosis.plausibility import Fault, Suspicion
from sawbench.diagnosis.reduction import running_state
from sawbench.diagnosis.trial_reading import Readings
from sawbench.processing.process import process_recording
from sawbench.storage.importers.campaign import load_campaign
from sawbench.storage.importers.dispatch import import_path
from sawbench.storage.reader import read_recording

from tests.rigs.jigsaw_in_time import BASELINE

pytestmark = pytest.mark.unit

FORCE, DISPLACEMENT, MOTOR = "force_n", "displacement_mm", "motor_current_a"
VOLTAGE, BATTERY = "battery_voltage_v", "battery_current_a"
CHANNELS = (FORCE, DISPLACEMENT, MOTOR, VOLTAGE, BATTERY)
VICTIM = 6
# Three idle and nine of the first battery: all that a check of a trial against the others needs.
N_TRIALS = 12


def campaign_of(folder, seed, effects=None):
    make_campaign(seed, folder / "tables", effects=effects or {}, length=0.3, rate_hz=2500.0)
    paths = import_path(folder / "tables" / "campaign.toml", folder / "mcap").paths
    return [read_recording(path) for path in paths], load_campaign(folder / "tables" / "campaign.toml")[1]


@pytest.fixture(scope="module", autouse=True)
def processed_once():
    """Most tests spoil one trial and reduce all twelve: the others are processed once for all of them."""
    known = {}

    def remembered(recording, config):
        signals = [
            (name, repr(s.gaps), hash(s.time_s.tobytes()), hash(s.values.tobytes()))
            for name, s in sorted(recording.signals.items())
        ]
        key = (repr(recording.trial), repr(config), *signals)
        if key not in known:
            known[key] = process_recording(recording, config)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sawbench.processing.process.process_recording", remembered)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return campaign_of(tmp_path_factory.mktemp("good"), 321)


@pytest.fixture(scope="module")
def good(whole):
    recordings, config = whole
    return recordings[:N_TRIALS], config


def with_values(recording, **values):
    signals = dict(recording.signals)
    for name, new in values.items():
        signals[name] = replace(signals[name], values=np.array(new))
    return replace(recording, signals=signals)


def values(recording, name):
    return recording.signals[name].values


def scaled(name, factor):
    return lambda r: with_values(r, **{name: factor * values(r, name)})


def swapped(one, other):
    return lambda r: with_values(r, **{one: values(r, other), other: values(r, one)})


def without(*names):
    return lambda r: replace(r, signals={n: s for n, s in r.signals.items() if n not in names})


def in_time(factor):
    return lambda r: replace(
        r, signals={n: replace(s, time_s=factor * s.time_s, gaps=()) for n, s in r.signals.items()}
    )


def stated(**changes):
    return lambda r: replace(r, trial=replace(r.trial, **changes))


def shifted(name, seconds):
    return lambda r: replace(
        r, signals={**r.signals, name: replace(r.signals[name], time_s=r.signals[name].time_s + seconds, gaps=())}
    )


def cut_out(name, first, last):
    def change(recording):
        signal = recording.signals[name]
        share = signal.time_s / signal.time_s[-1]
        keep = (share < first) | (share > last)
        kept = replace(signal, time_s=signal.time_s[keep], values=signal.values[keep], gaps=())
        return replace(recording, signals={**recording.signals, name: kept})

    return change


def blocked(first, last):
    """The blade stands still for a share of the trial, the motor draws its stall current; then it goes on."""

    def change(recording):
        rng = np.random.default_rng(1)
        new = {}
        for name, signal in recording.signals.items():
            n = len(signal.values)
            begin, end = int(first * n), int(last * n)
            held = {DISPLACEMENT: signal.values[begin], FORCE: 0.0, MOTOR: 30.0, VOLTAGE: 17.0}
            level = held.get(name, 30.0 * recording.trial.duty)
            pause = level + rng.normal(0.0, 0.01, end - begin)
            new[name] = np.concatenate([signal.values[:begin], pause, signal.values[begin : n - len(pause)]])
        return with_values(recording, **new)

    return change


def spoil(recordings, change, *, only=None):
    return [change(r) if only is None or k == only else r for k, r in enumerate(recordings)]


def labels(campaign):
    return {state.setting.label for state in campaign.states}


def running(campaign, label):
    return next(s for s in campaign.states if s.setting.label == label and s.kind == "running")


@pytest.mark.parametrize(
    ("seed", "effects"),
    [
        (401, {"current_limit": 2.0}),
        (402, {"brush_voltage_drop": 2.0, "converter_loss": 2.0}),
        (404, {"preload_lift_off": 2.0, "yoke_backlash": 2.0}),
        (406, {"clock_offset": 2.0, "return_stroke_rubbing": 2.0}),
    ],
)
def test_no_effect_of_the_catalogue_is_taken_for_a_wrong_input(tmp_path, seed, effects):
    recordings, config = campaign_of(tmp_path, seed, effects)
    campaign = reduce_campaign(recordings, config)
    assert campaign.warnings == ()
    assert len(labels(campaign)) == 18


COMMON_MISTAKES = {
    "currents swapped": (swapped(MOTOR, BATTERY), "battery_current_a and motor_current_a are probably swapped"),
    "force for travel": (swapped(FORCE, DISPLACEMENT), "displacement_mm and force_n are probably swapped"),
    "current for volts": (swapped(MOTOR, VOLTAGE), "battery_voltage_v and motor_current_a are probably swapped"),
    "force for current": (swapped(FORCE, MOTOR), "force_n and motor_current_a are probably swapped"),
    "battery swapped": (swapped(VOLTAGE, BATTERY), "battery_current_a and battery_voltage_v are probably swapped"),
    "travel in m": (scaled(DISPLACEMENT, 1e-3), "displacement_mm is probably in m "),
    "travel in um": (scaled(DISPLACEMENT, 1e3), "displacement_mm is probably in um"),
    "force in kN": (scaled(FORCE, 1e-3), "force_n is probably in kN"),
    "force in g": (scaled(FORCE, 102.0), "force_n is probably in gram-force"),
    "force in kgf": (scaled(FORCE, 0.102), "force_n is probably in kilogram-force"),
    "current in mA": (scaled(MOTOR, 1e3), "motor_current_a is probably in mA"),
    "voltage in mV": (scaled(VOLTAGE, 1e3), "battery_voltage_v is probably in mV"),
    "time in ms": (in_time(1e3), "time_s is probably in ms"),
    "force inverted": (scaled(FORCE, -1.0), "force_n has probably the wrong sign"),
    "current inverted": (scaled(MOTOR, -1.0), "motor_current_a has probably the wrong sign"),
}


@pytest.mark.parametrize("case", COMMON_MISTAKES)
def test_a_mistake_in_all_trials_is_an_error_that_names_it(good, case):
    recordings, config = good
    change, named = COMMON_MISTAKES[case]
    with pytest.raises(InputError, match=r"of \d+ trials are implausible") as caught:
        reduce_campaign(spoil(recordings, change), config)
    assert named in str(caught.value)
    assert caught.value.where in {r.trial.trial_id for r in recordings}
    assert caught.value.remedy


def test_a_force_that_most_trials_read_too_large_may_be_the_gap(good):
    """2.3 times the force is more than the current stands for, but no unit is off by that factor; 6 times is."""
    recordings, loaded = good
    campaign = reduce_campaign([scaled(FORCE, 2.3)(r) for r in recordings], loaded)
    assert len({state.setting.label for state in campaign.states}) == len(recordings)
    assert any("a large gap, or the same mistake in all trials" in warning for warning in campaign.warnings)
    with pytest.raises(InputError, match="are implausible"):
        reduce_campaign([scaled(FORCE, 6.0)(r) for r in recordings], loaded)


@pytest.mark.parametrize(("channel", "case"), [(FORCE, "force inverted"), (MOTOR, "current inverted")])
def test_the_remedy_for_a_wrong_sign_is_a_key_of_the_map(good, channel, case):
    recordings, config = good
    with pytest.raises(InputError) as caught:
        reduce_campaign(spoil(recordings, COMMON_MISTAKES[case][0]), config)
    assert f"write sign = -1 for {channel} into the map of the import" in caught.value.remedy


@pytest.mark.parametrize("case", COMMON_MISTAKES)
def test_a_mistake_in_one_trial_costs_that_trial_or_its_channels(good, case):
    recordings, config = good
    change, named = COMMON_MISTAKES[case]
    campaign = reduce_campaign(spoil(recordings, change, only=VICTIM), config)
    victim = recordings[VICTIM].trial.trial_id
    said = [text for text in campaign.warnings if text.startswith(victim) and named in text]
    assert len(said) == 1
    assert "left out" in said[0]
    assert labels(campaign) >= {r.trial.trial_id for r in recordings} - {victim}
    if victim in labels(campaign):
        state = running(campaign, victim)
        waves = (state.force_n, state.current_a, state.battery_voltage_v, state.battery_current_a)
        assert any(wave is None for wave in waves)


@pytest.mark.parametrize(("drawn_a", "is_common"), [([1.4], True), ([1.4, 0.2, 0.7], False)])
def test_a_consumer_beside_the_motor_is_a_gap_and_no_mistake(good, drawn_a, is_common):
    recordings, config = good
    changed = [
        with_values(r, **{BATTERY: values(r, BATTERY) + drawn_a[k % len(drawn_a)]}) for k, r in enumerate(recordings)
    ]
    campaign = reduce_campaign(changed, config)
    have = {s.setting.label for s in campaign.states if s.battery_current_a is not None}
    assert (have == {r.trial.trial_id for r in recordings}) == is_common
    assert any("something besides the motor draws it" in text for text in campaign.warnings) == is_common


def test_a_force_that_is_late_by_a_quarter_of_a_stroke_may_be_the_gap(good):
    """It seems to take no power; one clock makes all cuts so, and no clock makes one so."""
    recordings, config = good
    late_s = 0.018
    campaign = reduce_campaign(spoil(recordings, shifted(FORCE, late_s)), config)
    assert labels(campaign) == {r.trial.trial_id for r in recordings}
    assert any("clocks of the devices may differ" in text for text in campaign.warnings)
    one = reduce_campaign(spoil(recordings, shifted(FORCE, late_s), only=VICTIM), config)
    assert recordings[VICTIM].trial.trial_id not in labels(one)


@pytest.mark.parametrize("strokes_hz", [16.0, 36.0])
def test_a_force_of_the_wrong_sign_is_no_late_clock(strokes_hz):
    """Half of a stroke at 36 strokes a second is 14 ms: a delay within the catalogue turns the sign of the power."""
    load_n, moment = 100.0, np.arange(0.0, 4.0, 5e-4)
    plant = BASELINE.plant
    speed_rad_s = 2.0 * np.pi * strokes_hz
    radius_m = plant.crank_radius_m.nominal
    velocity_m_s = radius_m * speed_rad_s * np.sin(speed_rad_s * moment)
    force_n = load_n * np.maximum(BASELINE.cutting_sign * velocity_m_s, 0.0) / (radius_m * speed_rad_s)
    cutting_w = float(np.mean(BASELINE.cutting_sign * force_n * velocity_m_s))
    current_a = cutting_w / (plant.torque_constant_n_m_per_a.nominal * speed_rad_s * BASELINE.gear)
    channels = {
        FORCE: -force_n, DISPLACEMENT: 1e3 * radius_m * (1.0 - np.cos(speed_rad_s * moment)),
        MOTOR: np.full(len(moment), current_a),
    }  # fmt: skip
    recordings = [
        Recording(
            trial=Trial(trial_id=f"cut-{k}", duty=0.9, material="oak", thickness_mm=20.0, feed_mm_s=3.0),
            signals={
                name: Signal(channel=name, unit=CHANNEL_BY_NAME[name].unit, time_s=moment, values=series)
                for name, series in channels.items()
            },
        )
        for k in range(4)
    ]
    wrong = Suspicion(
        mistake="", channels=(FORCE,), faults=(Fault(kind="blade power", seen="too little", excess=np.inf),), remedy=""
    )
    found = {r.trial.trial_id: wrong for r in recordings}
    keep_what_a_late_clock_does(recordings, Readings(recordings), BASELINE, {0.9: (0.0, 0.0)}, found, [])
    assert len(found) == 4


def test_single_samples_without_voltage_cost_nothing(good):
    recordings, config = good

    def dropped(recording):
        new = np.array(values(recording, VOLTAGE))
        new[::150] = 0.0
        return with_values(recording, **{VOLTAGE: new})

    campaign = reduce_campaign(spoil(recordings, dropped), config)
    assert all(s.battery_voltage_v is not None for s in campaign.states)


def test_wrong_cutting_half_names_the_key_and_rubbing_does_not(good):
    recordings, config = good
    cutting = config.config.cutting.model_copy(update={"cutting_half": "zero_to_pi"})
    wrong = config.model_copy(update={"config": config.config.model_copy(update={"cutting": cutting})})
    with pytest.raises(InputError, match="cutting_half") as caught:
        reduce_campaign(recordings, wrong)
    assert 'set cutting_half = "pi_to_2pi"' in str(caught.value)


@pytest.mark.parametrize("name", CHANNELS)
def test_a_channel_missing_everywhere_weakens_the_answer(whole, name):
    recordings, config = whole
    campaign = reduce_campaign(spoil(recordings, without(name)), config)
    assert campaign.angle_is_assumed == (name == DISPLACEMENT)
    # Idle runs of 1.5 s are too short for a stroke rate from the ripple.
    assert len(labels(campaign)) >= (10 if name == DISPLACEMENT else 18)


@pytest.mark.parametrize("name", CHANNELS)
def test_a_dead_channel_counts_as_missing(good, name):
    recordings, config = good
    campaign = reduce_campaign(spoil(recordings, lambda r: with_values(r, **{name: 0.0 * values(r, name)})), config)
    assert any(f"{name} left out" in text and "constant at 0" in text for text in campaign.warnings)
    assert all(s.force_n is None for s in campaign.states) == (name in (FORCE, DISPLACEMENT))
    assert all(s.current_a is None for s in campaign.states) == (name == MOTOR)


def test_without_displacement_only_means_are_offered(good):
    from sawbench.modeling.residuals import residuals

    recordings, config = good
    whole = reduce_campaign(recordings, config)
    campaign = reduce_campaign(spoil(recordings, without(DISPLACEMENT)), config)
    for state in campaign.states:
        found = residuals(campaign.baseline, state)
        assert set(found) == {"electrical", "supply", "converter"}
        assert np.isnan(state.angle_rad).all()
        measured = running(whole, state.setting.label)
        rate = float(np.average(1.0 / np.mean(1.0 / measured.speed_rad_s, axis=1), weights=measured.n_strokes))
        assert state.speed_rad_s.mean() == pytest.approx(rate, rel=0.01)


def test_a_trial_whose_crank_turns_back_within_a_stroke_is_left_out(good, monkeypatch):
    """A cut ten times too hard nearly stalls a saw; probabilities were not a number, and the report said "no gap"."""
    recordings, config = good
    victim = recordings[VICTIM].trial.trial_id

    def stalling(trial, setting):
        state = running_state(trial, setting)
        turns_back = trial.trial.trial_id == victim
        return replace(state, speed_rad_s=state.speed_rad_s - turns_back * 1.01 * state.speed_rad_s.min())

    monkeypatch.setattr(campaigns, "running_state", stalling)
    campaign = reduce_campaign(recordings, config)
    assert f"{victim} left out: the crank stands still or turns back within its strokes" in campaign.warnings
    assert victim not in {state.setting.label for state in campaign.states}
    assert len(campaign.states) > 0


@pytest.mark.parametrize("name", CHANNELS)
def test_a_dropout_costs_its_strokes_only(good, name):
    recordings, config = good
    victim = recordings[VICTIM].trial.trial_id
    whole = running(reduce_campaign(recordings, config), victim)
    campaign = reduce_campaign(spoil(recordings, cut_out(name, 0.5, 0.8), only=VICTIM), config)
    state = running(campaign, victim)
    assert state.n_strokes.sum() < 0.85 * whole.n_strokes.sum()
    assert any(text.startswith(victim) and "dropouts leave" in text for text in campaign.warnings)
    # What is left is the same cut: mean current and speed within the trial's own drift.
    assert state.current_a.mean() == pytest.approx(whole.current_a.mean(), rel=0.05)
    assert state.speed_rad_s.mean() == pytest.approx(whole.speed_rad_s.mean(), rel=0.02)


def test_a_stalled_trial_is_left_out_and_all_stalled_is_an_error(good):
    recordings, config = good
    victim = recordings[VICTIM].trial.trial_id
    campaign = reduce_campaign(spoil(recordings, blocked(0.0, 1.0), only=VICTIM), config)
    assert victim not in labels(campaign)
    assert any(text.startswith(victim) and "stalled" in text for text in campaign.warnings)
    with pytest.raises(InputError, match="stalled"):
        reduce_campaign(spoil(recordings, blocked(0.0, 1.0)), config)


@pytest.mark.parametrize(("first", "last"), [(0.6, 0.75), (0.8, 1.0)])
def test_a_blade_that_stops_gives_its_running_part(good, first, last):
    recordings, config = good
    victim = recordings[VICTIM].trial.trial_id
    whole = running(reduce_campaign(recordings, config), victim)
    campaign = reduce_campaign(spoil(recordings, blocked(first, last), only=VICTIM), config)
    state = running(campaign, victim)
    assert any(text.startswith(victim) and "stops" in text for text in campaign.warnings)
    assert state.speed_rad_s.mean() == pytest.approx(whole.speed_rad_s.mean(), rel=0.02)
    assert state.current_a.max() < 29.0


def test_a_saturated_channel_is_left_out(good):
    recordings, config = good
    ceiling = 0.6 * max(values(r, FORCE).max() for r in recordings)
    campaign = reduce_campaign(
        spoil(recordings, lambda r: with_values(r, **{FORCE: np.minimum(values(r, FORCE), ceiling)})), config
    )
    clipped = {r.trial.trial_id for r in recordings if values(r, FORCE).max() > ceiling * 1.2}
    assert clipped
    assert all(running(campaign, name).force_n is None for name in clipped)
    assert any("range of the sensor exceeded" in text for text in campaign.warnings)


def test_two_trials_whose_current_is_not_synchronous_do_not_cost_the_campaign(good):
    """Without a force only their current can be judged: both are off, and sixteen other trials are not."""
    recordings, config = good
    victims = [k for k, r in enumerate(recordings) if not r.trial.is_idle][:2]

    def slipping(recording):
        signal = recording.signals[MOTOR]
        late = np.interp(0.9 * signal.time_s, signal.time_s, signal.values)
        return without(FORCE)(with_values(recording, **{MOTOR: late}))

    campaign = reduce_campaign([slipping(r) if k in victims else r for k, r in enumerate(recordings)], config)
    names = {recordings[k].trial.trial_id for k in victims}
    assert labels(campaign) == {r.trial.trial_id for r in recordings} - names
    assert sum("the current is not synchronous" in text for text in campaign.warnings) == 2


@pytest.mark.parametrize("change", [0.0875, -0.0875])
def test_a_wrong_duty_is_found_by_the_other_trials(whole, change):
    recordings, config = whole
    index = next(k for k, r in enumerate(recordings) if r.trial.duty == 0.4375 and not r.trial.is_idle)
    victim = recordings[index].trial
    campaign = reduce_campaign(spoil(recordings, stated(duty=victim.duty + change), only=index), config)
    assert victim.trial_id not in labels(campaign)
    assert len(labels(campaign)) == 17
    assert any(text.startswith(victim.trial_id) and "fit 0.4" in text for text in campaign.warnings)


@pytest.mark.parametrize("duty", [None, 0.0])
def test_a_trial_without_drive_is_left_out(good, duty):
    recordings, config = good
    campaign = reduce_campaign(spoil(recordings, stated(duty=duty), only=VICTIM), config)
    assert recordings[VICTIM].trial.trial_id not in labels(campaign)
    with pytest.raises(InputError, match="duty"):
        reduce_campaign(spoil(recordings, stated(duty=duty)), config)


def test_labels_of_idle_and_cut_are_held_against_the_force(whole):
    recordings, config = whole
    idle = next(k for k, r in enumerate(recordings) if r.trial.is_idle and r.trial.duty == 0.4375)
    called_oak = reduce_campaign(spoil(recordings, stated(material="oak", thickness_mm=20.0), only=idle), config)
    assert any("that of an idle run" in text for text in called_oak.warnings)
    called_air = reduce_campaign(spoil(recordings, stated(material="none"), only=VICTIM), config)
    assert any("an idle run is stated" in text for text in called_air.warnings)
    for campaign, index in ((called_oak, idle), (called_air, VICTIM)):
        assert recordings[index].trial.trial_id not in labels(campaign)


def test_what_was_cut_unsaid_gives_every_trial_its_own_coefficient(good):
    recordings, config = good
    campaign = reduce_campaign(spoil(recordings, stated(thickness_mm=None)), config)
    cuts = [s.setting for s in campaign.states if s.kind == "running" and not s.setting.is_idle]
    assert len({setting.stock for setting in cuts}) == len(cuts)
    assert any("its own cutting coefficient" in text for text in campaign.warnings)


def test_a_copied_trial_is_no_repeat(good):
    recordings, config = good
    copy = replace(recordings[VICTIM], signals=recordings[VICTIM - 1].signals)
    campaign = reduce_campaign([*recordings[:VICTIM], copy, *recordings[VICTIM + 1 :]], config)
    assert recordings[VICTIM].trial.trial_id not in labels(campaign)
    assert any("is a copy of that in" in text for text in campaign.warnings)


def test_ids_order_and_identities_are_noted(good):
    recordings, config = good
    twice = reduce_campaign([stated(trial_id="same")(r) for r in recordings[:5]], config)
    assert len(labels(twice)) == 5
    forwards, backwards = (reduce_campaign(rs, config) for rs in (recordings, recordings[::-1]))
    assert [s.setting.label for s in forwards.states] == [s.setting.label for s in backwards.states]
    assert backwards.warnings == ()
    unsaid = reduce_campaign(spoil(recordings, stated(started_at=None, battery=None), only=VICTIM), config)
    assert sum("started_at is not stated" in text for text in unsaid.warnings) == 1
    assert sum("battery is not stated" in text for text in unsaid.warnings) == 1


def of_other_trials(recordings):
    """The displacement of each trial is that of another."""
    turned = recordings[5:] + recordings[:5]
    return [
        replace(r, signals={**r.signals, DISPLACEMENT: other.signals[DISPLACEMENT]})
        for r, other in zip(recordings, turned, strict=True)
    ]


def of_repeats(recordings):
    """The displacement of each trial is that of another at the same duty."""
    out = list(recordings)
    for key in {(r.trial.duty, r.trial.is_idle) for r in recordings}:
        group = [k for k, r in enumerate(recordings) if (r.trial.duty, r.trial.is_idle) == key]
        for k, other in zip(group, group[1:] + group[:1], strict=True):
            out[k] = replace(
                recordings[k],
                signals={**recordings[k].signals, DISPLACEMENT: recordings[other].signals[DISPLACEMENT]},
            )
    return out


def late_by_chance(recordings):
    rng = np.random.default_rng(5)
    return [shifted(DISPLACEMENT, float(rng.uniform(0.008, 0.055)))(r) for r in recordings]


def permuted_samples(recordings):
    rng = np.random.default_rng(3)
    return [with_values(r, **{DISPLACEMENT: rng.permutation(values(r, DISPLACEMENT))}) for r in recordings]


@pytest.mark.parametrize("shuffle", [of_other_trials, of_repeats, late_by_chance, permuted_samples])
def test_a_shuffled_angle_is_refused(good, shuffle):
    recordings, config = good
    with pytest.raises(InputError) as caught:
        reduce_campaign(shuffle(recordings), config)
    assert "displacement" in str(caught.value) or "are implausible" in str(caught.value)


SELECTIONS = {
    "one operating point": lambda r: r.trial.duty == 0.4375 and not r.trial.is_idle and r.trial.thickness_mm == 20.0,
    "no idle run": lambda r: not r.trial.is_idle,
    "idle runs only": lambda r: r.trial.is_idle,
}


@pytest.mark.parametrize("case", SELECTIONS)
def test_small_campaigns_reduce_without_complaint(good, case):
    recordings, config = good
    chosen = [r for r in recordings if SELECTIONS[case](r)]
    campaign = reduce_campaign(chosen, config)
    assert labels(campaign) == {r.trial.trial_id for r in chosen}
    assert campaign.warnings == ()


def test_a_single_trial_reduces(good):
    recordings, config = good
    assert len(labels(reduce_campaign(recordings[VICTIM : VICTIM + 1], config))) == 1
