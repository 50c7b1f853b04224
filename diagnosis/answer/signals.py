"""Faults of sensors that are no gap of the model: named, measured, and handled as nuisances or as noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from sawbench.bench.units import BATTERY_CURRENT, BATTERY_VOLTAGE, CHANNEL_BY_NAME, FORCE, MOTOR_CURRENT
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.asynchronous import (
    Line,
    fastest_compared_hz,
    fixed_lines,
    hum_lines,
    is_mains,
)
from sawbench.diagnosis.inference.gain_drift import GainDrift
from sawbench.diagnosis.inference.off_stroke import OffStroke
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.strikes import foreign_bursts
from sawbench.diagnosis.inference.vibration_read import Vibration
from sawbench.diagnosis.inference.wandering_line import wandering_lines
from sawbench.diagnosis.inference.zero_wander import ZeroWander
from sawbench.diagnosis.signal_health import ChannelHealth

_LEAST: Final = SETTINGS.report.least_fault

_CHANNEL_OF_GAIN: Final = {
    "force_gain": FORCE.name, "motor_current_gain": MOTOR_CURRENT.name, "battery_current_gain": BATTERY_CURRENT.name,
    "battery_voltage_gain": BATTERY_VOLTAGE.name,
}  # fmt: skip

Entry = dict[str, Any]


def signal_findings(
    campaign: Campaign,
    wander: ZeroWander | None,
    drifts: Mapping[str, GainDrift] = MappingProxyType({}),
    vibration: Vibration | None = None,
) -> list[Entry]:
    """Faults of the sensors of a campaign.

    Parameters
    ----------
    campaign : Campaign
    wander : ZeroWander or None
        Of the force's zero.
    drifts : mapping of str to GainDrift
        Of `gain_drifts`.
    vibration : Vibration, optional
        Of the force.

    Returns
    -------
    list of dict
        Entries of `signals` in the gap report: channel, finding, frequency_hz, magnitude, unit, words.
    """
    by_channel: dict[str, list[ChannelHealth]] = {}
    for one in campaign.health:
        by_channel.setdefault(one.channel, []).append(one)
    found = [
        *_lines(campaign.off_stroke, by_channel),
        *_bursts(campaign.off_stroke),
        *_resonances(campaign),
        *_wander(wander, by_channel),
        *_drifts(drifts),
        *_vibration(vibration),
    ]
    for channel, trials in by_channel.items():
        found += _faults(channel, trials)
    return found


def _entry(channel: str, finding: str, magnitude: float, unit: str, words: str, hz: float | None = None) -> Entry:
    return {
        "channel": channel, "finding": finding, "frequency_hz": hz, "magnitude": magnitude, "unit": unit,
        "words": words,
    }  # fmt: skip


def _lines(trials: Sequence[OffStroke], health: dict[str, list[ChannelHealth]]) -> Iterator[Entry]:
    for line in (*fixed_lines(trials), *_largest_hidden(trials)):
        noise = float(np.median([h.noise for h in health.get(line.channel, ())] or [0.0]))
        if line.amplitude < noise:
            continue
        unit, place = CHANNEL_BY_NAME[line.channel].unit, f"{line.amplitude:.2g} {{}} at {line.frequency_hz:.1f} Hz"
        if is_mains(line.frequency_hz):
            place = f"up to {place}, beside a harmonic of the stroke" if line.hides else place
            words = f"hum of {place.format(unit)}: mains pickup; check shield and ground of the cable"
            yield _entry(line.channel, "hum", line.amplitude, unit, words, line.frequency_hz)
        else:
            is_fast = line.frequency_hz > fastest_compared_hz(trials)
            which = "faster than what is compared with the model" if is_fast else "in this channel only"
            words = f"line of {place.format(unit)}, {which}, at any stroke rate: find its source"
            yield _entry(line.channel, "line", line.amplitude, unit, words, line.frequency_hz)
    for one in wandering_lines(trials):
        unit = CHANNEL_BY_NAME[one.channel].unit
        words = (
            f"line of {one.amplitude:.2g} {unit} at {one.lowest_hz:.1f} to {one.highest_hz:.1f} Hz, another frequency"
            " in each trial: a ripple above half the sample rate (aliasing) or pickup; filter before sampling"
        )
        yield _entry(one.channel, "line", one.amplitude, unit, words)


def _largest_hidden(trials: Sequence[OffStroke]) -> list[Line]:
    """Hum that may stand beside a harmonic of the stroke, where it would be the largest of its channel."""
    hum = hum_lines(trials)
    seen = {one.channel: max(o.amplitude for o in hum if o.channel == one.channel and not o.hides) for one in hum}
    return [one for one in hum if one.hides and one.amplitude > seen[one.channel]]


def _bursts(trials: Sequence[OffStroke]) -> Iterator[Entry]:
    for channel, strikes in foreign_bursts(trials).items():
        unit = CHANNEL_BY_NAME[channel].unit
        words = (
            f"bursts of {strikes.size:.2g} {unit}, at least {strikes.per_s:.1f} per second, also in idle runs,"
            " without a response of the"
            " motor: interference; check relays and drives nearby"
        )
        yield _entry(channel, "bursts", strikes.size, unit, words, strikes.per_s)


def _resonances(campaign: Campaign) -> Iterator[Entry]:
    """Of the sensors by themselves: in the model, be it as configured or as this campaign tells."""
    for known in campaign.plant.known:
        if known.effect in campaign.plant.machine.sensor_properties and known.effect.words is not None:
            hz, damping = known.value, known.form["damping"]
            words = (
                f"{known.effect.words.happens} at {hz:.0f} Hz, damping ratio {damping:.2g}, in the model and no gap:"
                f" {known.effect.words.mend} where what happens above {0.3 * hz:.0f} Hz matters"
            )
            yield _entry(FORCE.name, "resonance", 0.5 / damping, "1", words, hz)


def _wander(wander: ZeroWander | None, health: dict[str, list[ChannelHealth]]) -> Iterator[Entry]:
    if wander is None or FORCE.name not in health:
        return
    seconds = float(np.median([h.seconds for h in health[FORCE.name]]))
    walked_n = float(np.sqrt(wander.density_n2_s * seconds))
    if walked_n > _LEAST["wander_n"] and wander.density_n2_s > SETTINGS.report.wander_stds * wander.density_std_n2_s:
        words = f"the zero drifts by {walked_n:.2g} N within a trial: let the load cell warm up, tare before each"
        yield _entry(FORCE.name, "zero_wander", walked_n, "N", words)
    if wander.restart_n > _LEAST["restart_n"]:
        words = f"the zero differs by {wander.restart_n:.2g} N from trial to trial: tare before each trial"
        yield _entry(FORCE.name, "zero_steps", wander.restart_n, "N", words)
    if abs(wander.level_n) > max(_LEAST["level_n"], SETTINGS.report.wander_stds * wander.restart_n):
        words = (
            f"the load cell reads {wander.level_n:.2g} N in air in all trials: tare it; every force is off by that, and"
            " what is worked out from mean forces is wrong"
        )
        yield _entry(FORCE.name, "zero_level", wander.level_n, "N", words)


def _drifts(drifts: Mapping[str, GainDrift]) -> Iterator[Entry]:
    for gain, drift in drifts.items():
        if abs(drift.change) > max(_LEAST["gain_drift"], SETTINGS.report.wander_stds * drift.std):
            words = (
                f"the gain changes by {100.0 * drift.change:+.2g} % over the session: let the amplifier warm up before"
                " the first trial"
            )
            yield _entry(_CHANNEL_OF_GAIN[gain], "gain_drift", abs(drift.change), "1", words)


def _vibration(found: Vibration | None) -> Iterator[Entry]:
    if found is not None and found.amplitude_n > max(_LEAST["vibration_n"], SETTINGS.report.wander_stds * found.std_n):
        words = (
            f"{found.amplitude_n:.2g} N of the machine's vibration at the stroke rate, in air too: use a stiffer or"
            " heavier base for the load cell"
        )
        yield _entry(FORCE.name, "vibration", found.amplitude_n, "N", words)


def _faults(channel: str, trials: Sequence[ChannelHealth]) -> Iterator[Entry]:
    """What the processing has found in the samples themselves."""
    unit = CHANNEL_BY_NAME[channel].unit
    step = float(np.median([h.step for h in trials]))
    if step > 0.0:
        words = f"steps of {step:.2g} {unit}, larger than the noise: use a smaller range of the A/D converter"
        yield _entry(channel, "quantisation", step, unit, words)
    seconds = sum(h.seconds for h in trials)
    spikes_hz = sum(h.spikes for h in trials) / seconds
    if spikes_hz > _LEAST["spikes_hz"]:
        words = f"{spikes_hz:.2g} spikes per second, left out: check cable and connector"
        yield _entry(channel, "spikes", spikes_hz, "1/s", words)
    impacts_hz = sum(h.impacts for h in trials) / seconds
    if impacts_hz > _LEAST["spikes_hz"]:
        words = f"{impacts_hz:.2g} spikes per second at the same crank angle, kept: look for a loose part that strikes"
        yield _entry(channel, "impacts", impacts_hz, "1/s", words)
    missing = float(np.average([h.missing_share for h in trials], weights=[h.seconds for h in trials]))
    if missing > _LEAST["missing"]:
        words = f"{100.0 * missing:.2g} % of the samples are missing: check the load of computer and link"
        yield _entry(channel, "missing_samples", missing, "1", words)
    jitter = float(np.median([h.jitter_share for h in trials]))
    if jitter > _LEAST["jitter"]:
        jitter_s = jitter / float(np.median([h.rate_hz for h in trials]))
        words = f"sample times scatter by {100.0 * jitter:.0f} % of the sample period: use the clock of the instrument"
        yield _entry(channel, "jitter", jitter_s, "s", words)
