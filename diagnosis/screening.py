"""What of a campaign may be used: every trial is checked before it is reduced, and what is wrong is said once."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.plausible import CONVERTER_A, Bounds, is_drawn_by_motor
from sawbench.bench.recording import Floats, Recording, Trial
from sawbench.bench.units import BATTERY_CURRENT, BATTERY_VOLTAGE, CHANNEL_BY_NAME, DISPLACEMENT, FORCE
from sawbench.diagnosis.channel_defects import without_defects
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.trial_settings import Screening
from sawbench.diagnosis.late_clock import keep_what_a_late_clock_does
from sawbench.diagnosis.plausibility import (
    Suspicion,
    check,
    cutting_power_w,
    explain_faults,
    idle_current_between,
    settled_current_a,
)
from sawbench.diagnosis.trial_names import some
from sawbench.diagnosis.trial_reading import Readings, tracks_of
from sawbench.modeling.residuals import Baseline

_NUMBERS = SETTINGS.screening
NOT_A_SAW: Final = (
    "correct what is missing with `sawbench amend`, or in campaign.toml and import again; the configuration describes a"
    " saw: for a linear axis give --config a file with a [linear_axis] table"
)


def screen(recordings: Sequence[Recording], baseline: Baseline) -> tuple[list[Recording], list[str]]:
    """Leave out what cannot be what it says.

    Parameters
    ----------
    recordings : sequence of Recording
        In the order of the campaign.
    baseline : Baseline

    Returns
    -------
    recordings : list of Recording
        Trials that may be used, without the channels that may not.
    warnings : list of str
        One for each trial or channel that was left out, and for what the order of the trials leaves open.

    Raises
    ------
    InputError
        If the same mistake is in most trials, or nothing is left.
    """
    warnings = _notes_on_order(recordings)
    kept = _with_unique_ids(recordings, warnings)
    kept = _driven(kept, warnings)
    readings = Readings(kept)
    _note_stalls(kept, readings, baseline, warnings)
    kept = without_defects(kept, warnings)
    kept = _without_copies(kept, warnings)
    kept = _without_suspects(kept, readings, baseline, warnings)
    kept = _without_wrong_duty(kept, readings, baseline, warnings)
    kept = _without_wrong_labels(kept, readings, baseline, warnings)
    if not kept:
        raise InputError(f"no trial can be diagnosed: {summary(warnings)}", remedy=NOT_A_SAW)
    return kept, warnings


def summary(warnings: Sequence[str]) -> str:
    """Return the first warnings in one line, and how many there are."""
    more = f"; and {len(warnings) - 3} more" if len(warnings) > 3 else ""
    return "; ".join(warnings[:3]) + more


def _notes_on_order(recordings: Sequence[Recording]) -> list[str]:
    notes = []
    starts = [r.trial.started_at for r in recordings]
    without = [r.trial.trial_id for r, start in zip(recordings, starts, strict=True) if start is None]
    if without and len(recordings) > 1:
        notes.append(
            f"started_at is not stated for {some(without)}: the order given is used, without rest between"
            " trials, so heat, wear and charge carried over are uncertain"
        )
    known = [start for start in starts if start is not None]
    if len(set(known)) < len(known):
        notes.append(
            "some trials state the same started_at: their order, and thus the carried-over state, is uncertain"
        )
    for name in ("battery", "blade"):
        stated = [getattr(r.trial, name) for r in recordings]
        if len(recordings) > 1 and None in stated and any(stated):
            nameless = [r.trial.trial_id for r, s in zip(recordings, stated, strict=True) if s is None]
            notes.append(f"{name} is not stated for {some(nameless)}: treated as a separate, new {name}")
    if len({r.config_toml for r in recordings if r.config_toml}) > 1:
        notes.append("the recordings were made with different configurations; all are compared with a single one")
    vague = [r.trial.trial_id for r in recordings if not is_stock_stated(r.trial)]
    if vague:
        notes.append(
            f"workpiece, thickness or feed is not stated for {some(vague)}: each gets its own cutting coefficient,"
            ' so it has less information on the cutting law (an idle run is workpiece = "none")'
        )
    return notes


def is_stock_stated(trial: Trial) -> bool:
    """Whether it is known what was cut, and how: trials of the same statement then share a cutting coefficient."""
    return trial.is_idle or None not in (trial.material, trial.thickness_mm, trial.feed_mm_s)


def _with_unique_ids(recordings: Sequence[Recording], warnings: list[str]) -> list[Recording]:
    seen: Counter[str] = Counter()
    out = []
    for recording in recordings:
        name = recording.trial.trial_id
        seen[name] += 1
        if seen[name] > 1:
            new = f"{name} ({seen[name]})"
            warnings.append(f"two recordings have the name {name}: the later one is renamed {new} here")
            out.append(replace(recording, trial=replace(recording.trial, trial_id=new)))
        else:
            out.append(recording)
    return out


def _driven(recordings: Sequence[Recording], warnings: list[str]) -> list[Recording]:
    out = []
    for recording in recordings:
        if recording.trial.duty is None:
            warnings.append(f"{recording.trial.trial_id} left out: its duty is not stated; state it in campaign.toml")
        elif recording.trial.duty == 0.0:
            warnings.append(f"{recording.trial.trial_id} left out: its duty is stated as 0: no voltage at the motor")
        else:
            out.append(recording)
    return out


def _note_stalls(
    recordings: Sequence[Recording], readings: Readings, baseline: Baseline, warnings: list[str]
) -> None:  # fmt: skip
    """Say where the motor draws current and the blade makes no strokes; such a trial gives no angle later."""
    for recording in recordings:
        reading = readings.of(recording)
        drive_v = (recording.trial.duty or 0.0) * (reading.battery_voltage_v or 0.0)
        if DISPLACEMENT.name not in recording.signals or reading.n_strokes >= _NUMBERS.least_strokes or drive_v <= 0:
            continue
        current = reading.motor_current_a or 0.0
        if baseline.plant.resistance_ohm.nominal * current > _NUMBERS.stalled_share * drive_v:
            warnings.append(
                f"{recording.trial.trial_id}: no strokes while the motor draws {current:.3g} A:"
                " it is stalled, or the displacement sensor is dead"
            )


def _without_copies(recordings: Sequence[Recording], warnings: list[str]) -> list[Recording]:
    """Leave out trials that hold a channel of an earlier one: a copy is no repeat, it hides the scatter."""
    owner: dict[str, str] = {}
    out = []
    for recording in recordings:
        prints = {
            hashlib.sha256(signal.values.tobytes()).hexdigest(): name
            for name, signal in recording.signals.items()
            if name in CHANNEL_BY_NAME
        }
        shared = [(name, owner[key]) for key, name in prints.items() if key in owner]
        if shared:
            names = ", ".join(name for name, _ in shared)
            warnings.append(
                f"{recording.trial.trial_id} left out: its {names} is a copy of that in {shared[0][1]}, not a repeat"
            )
            continue
        owner |= dict.fromkeys(prints, recording.trial.trial_id)
        out.append(recording)
    return out


def _idle_currents(recordings: Sequence[Recording], readings: Readings, baseline: Baseline) -> dict[float, Bounds]:
    """Least and largest motor current of plausible idle trials by duty, up to speed, A: cold grease is not warm."""
    found: dict[float, Bounds] = {}
    for recording in recordings:
        if recording.trial.is_idle:
            reading = readings.of(recording)
            settled_a = settled_current_a(baseline, reading)
            if settled_a is not None and not check(baseline, recording.trial, reading).faults:
                duty = recording.trial.duty or 0.0
                least, most = found.get(duty, (settled_a, settled_a))
                found[duty] = (min(least, settled_a), max(most, settled_a))
    return found


def _without_suspects(
    recordings: list[Recording], readings: Readings, baseline: Baseline, warnings: list[str]
) -> list[Recording]:
    idle = _idle_currents(recordings, readings, baseline)
    found: dict[str, Suspicion] = {}
    for recording in recordings:
        trial = recording.trial
        in_air = idle_current_between(idle, trial.duty or 0.0)
        if not check(baseline, trial, readings.of(recording), in_air).faults:
            continue
        suspicion = explain_faults(baseline, trial, tracks_of(recording), in_air)
        if suspicion is not None:
            found[trial.trial_id] = suspicion
    _keep_what_all_draw(recordings, readings, found, warnings)
    keep_what_a_late_clock_does(recordings, readings, baseline, idle, found, warnings)
    _keep_what_may_be_a_gap(recordings, found, warnings)
    _refuse_common(recordings, found)
    out = []
    said: dict[str, list[str]] = {}
    texts: dict[str, str] = {}
    for recording in recordings:
        suspicion = found.get(recording.trial.trial_id)
        if suspicion is None:
            out.append(recording)
            continue
        rest = {n: s for n, s in recording.signals.items() if n not in suspicion.channels}
        whole = "time_s" in suspicion.channels or DISPLACEMENT.name not in rest or _is_about_the_cut(suspicion)
        what = "" if whole else f": {' and '.join(suspicion.channels)}"
        key = f"{what}|{suspicion.mistake}|{[fault.kind for fault in suspicion.faults]}"
        said.setdefault(key, []).append(recording.trial.trial_id)
        texts.setdefault(key, f"{what} left out: {suspicion.text}; {suspicion.remedy}")
        if not whole:
            out.append(replace(recording, signals=rest))
    warnings += [f"{some(names)}{texts[key]}" for key, names in said.items()]
    for name in (BATTERY_CURRENT.name, BATTERY_VOLTAGE.name):
        n_wrong = sum(suspicion.channels == (name,) for suspicion in found.values())
        if 2 * n_wrong > len(recordings):
            # Trials that pass by a small current's tolerance have the same sensor.
            out = [replace(r, signals={n: s for n, s in r.signals.items() if n != name}) for r in out]
            warnings.append(f"{name} is wrong in most trials and left out in all")
    return out


def _keep_what_may_be_a_gap(recordings: Sequence[Recording], found: dict[str, Suspicion], warnings: list[str]) -> None:
    """Believe most trials where they contradict the model, but not by much: that may be the gap that is looked for."""
    names = [name for name, suspicion in found.items() if suspicion.may_be_a_gap]
    if 2 * len(names) <= len(_able(recordings, [found[name] for name in names])):
        return
    first = found[names[0]]
    warnings.append(f"{some(names)}: {first.text}: a large gap, or the same mistake in all trials: {first.remedy}")
    for name in names:
        del found[name]


def _keep_what_all_draw(
    recordings: Sequence[Recording], readings: Readings, found: dict[str, Suspicion], warnings: list[str]
) -> None:
    """Believe battery currents that are off by the same in most trials, in air as in a cut: no mistake does that.

    A consumer beside the motor does, or a zero that is off: a gap, for the diagnosis to name.
    """
    read = {r.trial.trial_id: (readings.of(r), r.trial.duty or 0.0) for r in recordings}
    currents_a = {
        name: (reading.battery_current_a, duty * reading.motor_current_a)
        for name, (reading, duty) in read.items()
        if reading.battery_current_a is not None and reading.motor_current_a is not None
    }
    off_a = {name: drawn_a - expected_a for name, (drawn_a, expected_a) in currents_a.items()}
    middle_a = float(np.median(list(off_a.values()))) if off_a else 0.0
    alike_a = [expected_a for name, (_, expected_a) in currents_a.items() if abs(off_a[name] - middle_a) <= CONVERTER_A]
    is_common = len(alike_a) >= (1.0 - _NUMBERS.at_odds) * len(off_a)
    # Of currents that are swapped, or in another unit, the difference grows with the load.
    if not is_common or len(alike_a) < 2 or max(alike_a) < 2.0 * min(alike_a):
        return
    kept = [
        name
        for name, suspicion in found.items()
        if {fault.kind for fault in suspicion.faults} == {"converter"}
        and is_drawn_by_motor(currents_a[name][0] - middle_a, currents_a[name][1])
    ]
    for name in kept:
        del found[name]
    if kept:
        warnings.append(
            f"battery_current_a is {middle_a:.2g} A more than duty times motor_current_a, in air as in a cut: something"
            " besides the motor draws it, or its zero is off"
        )


def _is_about_the_cut(suspicion: Suspicion) -> bool:
    """Whether force and displacement contradict each other, and it is open which of them is wrong."""
    return FORCE.name in suspicion.channels and not suspicion.is_unit


def _able(recordings: Sequence[Recording], suspicions: Sequence[Suspicion]) -> list[Recording]:
    """Trials that could show the same faults: those in wood, where only the power of the cut is in doubt."""
    only_cuts = {fault.kind for suspicion in suspicions for fault in suspicion.faults} == {"blade power"}
    return [r for r in recordings if not (only_cuts and r.trial.is_idle)]


def _refuse_common(recordings: Sequence[Recording], found: dict[str, Suspicion]) -> None:
    """Raise where one mistake is in most of the trials that could show it."""
    spared = ((BATTERY_CURRENT.name,), (BATTERY_VOLTAGE.name,))
    groups: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for name, suspicion in found.items():
        if suspicion.mistake or suspicion.channels not in spared:
            groups.setdefault((suspicion.mistake, suspicion.channels if suspicion.mistake else ()), []).append(name)
    for (_, channels), names in sorted(groups.items(), key=lambda group: -len(group[1])):
        first = found[names[0]]
        able = [
            r for r in _able(recordings, [found[name] for name in names])
            if all(c in r.signals or c == "time_s" for c in channels)
        ]  # fmt: skip
        if 2 * len(names) > len(able):
            raise InputError(
                f"{len(names)} of {len(able)} trials are implausible: {first.text}", where=names[0], remedy=first.remedy
            )
    cuts = [r.trial.trial_id for r in recordings if not r.trial.is_idle and FORCE.name in r.signals]
    at_odds = [
        name for name in cuts if name in found and {fault.kind for fault in found[name].faults} == {"blade power"}
    ]
    at_odds = [name for name in at_odds if not found[name].is_unit]
    if len(cuts) >= 3 and len(at_odds) > _NUMBERS.at_odds * len(cuts):
        raise InputError(
            f"in {len(at_odds)} of {len(cuts)} cutting trials force and displacement contradict each other in different"
            f" ways: {found[at_odds[0]].text}",
            where=at_odds[0],
            remedy="check that every displacement belongs to its trial, and check the clocks of the devices",
        )


def _without_wrong_duty(
    recordings: list[Recording], readings: Readings, baseline: Baseline, warnings: list[str]
) -> list[Recording]:
    """Leave out trials whose stated duty does not fit what current, speed and battery voltage ask for."""
    plant = baseline.plant
    names, rows = [], []
    for recording in recordings:
        reading = readings.of(recording)
        current_a, rate_hz, voltage_v = reading.motor_current_a, reading.rate_hz, reading.battery_voltage_v
        if current_a is None or rate_hz is None or voltage_v is None:
            continue
        speed = 2.0 * np.pi * rate_hz * baseline.gear
        asked_v = plant.resistance_ohm.nominal * current_a + plant.back_emf_constant_v_s_per_rad.nominal * speed
        names.append(recording.trial.trial_id)
        rows.append((recording.trial.duty or 0.0, asked_v / voltage_v, current_a, reading.top_current_a or 0.0))
    if len(rows) < _NUMBERS.duty_least_trials:
        return recordings
    fitted = doubted_duties(*np.array(rows).T)
    doubted = {name: value for name, value in zip(names, fitted.tolist(), strict=True) if np.isfinite(value)}
    for recording in recordings:
        name = recording.trial.trial_id
        if name in doubted:
            warnings.append(
                f"{name} left out: its duty is stated as {recording.trial.duty:g}, but current, speed and voltage fit"
                f" {doubted[name]:.2f} according to the other trials; correct the duty, or the scale of current"
                " or voltage"
            )
    return [recording for recording in recordings if recording.trial.trial_id not in doubted]


def doubted_duties(
    stated: Floats, asked: Floats, current_a: Floats, top_a: Floats, numbers: Screening = _NUMBERS
) -> Floats:
    """Compare what trials say of their duty with what current and speed ask for.

    Parameters
    ----------
    stated : ndarray, shape (n_trials,)
    asked : ndarray, shape (n_trials,)
        Voltage that current and speed ask for over that of the battery.
    current_a, top_a : ndarray, shape (n_trials,)
        Mean motor current, and its peak.
    numbers : Screening

    Returns
    -------
    ndarray, shape (n_trials,)
        Duty that fits the other trials where the stated one does not, NaN elsewhere.
    """
    design = np.column_stack([np.ones_like(asked), asked, current_a])
    weight, line = np.ones_like(asked), np.zeros(3)
    for _ in range(50):  # least absolute deviations: a wrong duty must not bend the line it is judged by
        line = np.linalg.lstsq(design * weight[:, None], stated * weight, rcond=None)[0]
        weight = 1.0 / np.sqrt(np.maximum(np.abs(stated - design @ line), 1e-4))
    fitted = design @ line
    # The peak of the start-up grows with the duty, too. Where it sides with the stated one, the voltage is missing
    # for another reason: a current limit pulls the duty back under load only.
    by_peak = top_a / np.median(top_a / stated)
    wrong = (np.abs(stated - fitted) > numbers.duty_deviation) & (np.abs(by_peak - fitted) < np.abs(by_peak - stated))
    # So is what the repeats of a trial do as well: a slip of the pen is not made twice.
    for k in np.flatnonzero(wrong):
        alike = (stated == stated[k]) & (np.abs(current_a - current_a[k]) < numbers.alike_current * current_a[k])
        alike[k] = False
        if alike.any() and abs(float(np.median(asked[alike])) - asked[k]) < 0.5 * numbers.duty_deviation:
            wrong[k] = False
    if 3 * wrong.sum() > len(stated):
        wrong[:] = False
    return np.where(wrong, fitted, np.nan)


def _without_wrong_labels(
    recordings: list[Recording], readings: Readings, baseline: Baseline, warnings: list[str]
) -> list[Recording]:
    """Leave out trials that state a workpiece but take far less power than the others: nothing was cut."""
    idle = _idle_currents(recordings, readings, baseline)
    power = {}
    for recording in recordings:
        if recording.trial.is_idle or recording.trial.duty not in idle:
            continue
        found = cutting_power_w(baseline, readings.of(recording), idle[recording.trial.duty][0])
        if found is not None:
            # By the linear cutting law it grows with the square of the speed.
            power[recording.trial.trial_id] = found / recording.trial.duty**2
    usual = float(np.median(list(power.values()))) if len(power) >= 3 else 0.0
    nothing = {name for name, value in power.items() if value < _NUMBERS.cuts_nothing * usual}
    for name in sorted(nothing):
        warnings.append(
            f"{name} left out: it states a workpiece, but the motor current is that of an idle run; state"
            ' workpiece = "none" if the blade did not cut'
        )
    return [recording for recording in recordings if recording.trial.trial_id not in nothing]
