"""One recording in, everything the processing finds in it out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from sawbench.bench.config import BenchConfig
from sawbench.bench.folded import FoldedCycle
from sawbench.bench.processed import (
    ChannelQuality,
    CrankAngle,
    Cut,
    PeriodEstimate,
    Phase,
    ProcessedTrial,
    RemovedForce,
    SteadyPart,
    TrackedTrial,
    TrialStatus,
)
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.bench.true_values import with_true_values
from sawbench.bench.units import DISPLACEMENT
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.processing.averages import cycle_averages
from sawbench.processing.crank_angle import track_crank_angle
from sawbench.processing.demodulation import angle_from_line
from sawbench.processing.folding import Cycles, find_cycles, fold_signals
from sawbench.processing.frozen import frozen_words
from sawbench.processing.in_cut import find_cut, with_air
from sawbench.processing.noise import robust_range
from sawbench.processing.peak_force import PeakForce, estimate_peak_force
from sawbench.processing.period import StrokeLine, find_stroke_line, from_displacement, from_line, line_noise_power
from sawbench.processing.phases import find_phases, stalled_from_start
from sawbench.processing.quality import (
    CleanChannel,
    clean_channels,
    plausibility_problems,
    with_impacts,
    without_spikes,
)
from sawbench.processing.return_stroke import stands_at_a_level, zero_return_stroke
from sawbench.processing.settled import find_steady_part
from sawbench.processing.stretches import Stretches, without_holes
from sawbench.processing.stroke_clock import Slip, find_slips
from sawbench.processing.stroke_offsets import stroke_offsets
from sawbench.processing.stroke_ripple import restore_ripple
from sawbench.processing.stroke_spectrum import longest_spectrum

_FORCE, _DISPLACEMENT, _CURRENT = "force_n", "displacement_mm", "motor_current_a"
_LINE_CHANNELS = (_FORCE, _CURRENT, "battery_current_a", "battery_voltage_v")
_WINDOW_CYCLES = 4.0
_CLIPPED_SHARE = 0.02
# Share of the range that the displacement moves from sample to sample (median) where a stroke has fewer than seven;
# white noise at rest moves by 0.19 of its own.
_COARSE_SHARE = 0.3
_LOADED, _UNLOADED = 0.55, 1.05  # of the rate without load; less than twice apart, so one of two multiples is meant
_TWO_THREADS_FROM = 4_000_000

Channels = dict[str, CleanChannel]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Motion:
    """What is known about the strokes of a trial."""

    angle: CrankAngle | None
    phases: tuple[Phase, ...]
    cycles: Cycles | None
    period: PeriodEstimate | None
    warnings: tuple[str, ...]
    steady: SteadyPart | None = None


def process_recording(recording: Recording, config: BenchConfig, *, source_sha256: str = "") -> ProcessedTrial:
    """Find stroke period, crank angle, phases, folded cycles, cutting force and quality of one trial.

    Parameters
    ----------
    recording : Recording
        Any subset of the bench's channels, at any rates.
    config : BenchConfig
        `plant` (if present) gives radius and rod length, `cutting` the half that cuts, `analysis` the bins
        and the allowed stroke rates, `sensors` what the sensors read of the true values.
    source_sha256 : str
        Of the file, kept in the result.

    Returns
    -------
    ProcessedTrial
        What could not be found is None, and `warnings` says why.

    Examples
    --------
    >>> from sawbench.bench.recording import Signal
    >>> t = np.arange(0, 2, 1e-3)
    >>> y = 10 * (1 - np.cos(2 * np.pi * 15 * t))
    >>> stroke = Signal(channel="displacement_mm", unit="mm", time_s=t, values=y)
    >>> trial = process_recording(
    ...     Recording(trial=Trial(trial_id="t1"), signals={"displacement_mm": stroke}), BenchConfig())
    >>> print(f"{trial.period.rate_hz:.3f} Hz, {trial.period.confidence}")
    15.000 Hz, high
    """
    recording = with_true_values(recording, config)
    channels = clean_channels(recording)
    motion = _find_motion(channels, config, recording.trial)
    channels = with_impacts(channels, recording, motion.angle)
    quality = _judged(channels, config, recording.trial, motion)
    status = _status_without_cutting(channels, config, recording.trial, motion)
    base = ProcessedTrial(
        trial=recording.trial,
        status=status,
        period=motion.period,
        angle=motion.angle,
        phases=motion.phases,
        steady=motion.steady,
        channels=without_spikes(recording, channels),
        folded={},
        cutting_force=None,
        removed=None,
        peak_force_n=None,
        peak_force_std_n=None,
        quality=quality,
        warnings=(*recording.interruptions, *motion.warnings, *_quality_warnings(quality)),
        source_path=recording.path,
        source_sha256=source_sha256,
        frame=config.frame,
    )
    if motion.angle is None or motion.cycles is None or not len(motion.cycles.index):
        return base
    return _with_cycles(base, recording.signals, channels, config, motion.angle, motion.cycles)


def _judged(channels: Channels, config: BenchConfig, trial: Trial, motion: _Motion) -> tuple[ChannelQuality, ...]:
    """Health of every channel, and whether its values can be those of this bench while it runs."""
    suspicions = plausibility_problems(channels, config, trial.duty)
    running = tuple((phase.start_s, phase.end_s) for phase in motion.phases if phase.kind in ("in_air", "running"))
    found = []
    for name, channel in channels.items():
        frozen = frozen_words(channel.time_s, channel.values, channel.unit, motion.angle, running)
        wrong = suspicions.get(name, ()) + frozen
        quality = channel.quality
        found.append(replace(quality, problems=quality.problems + wrong, doubts=quality.doubts + wrong))
    return tuple(found)


def track_strokes(recording: Recording, config: BenchConfig) -> TrackedTrial:
    """Clean the channels and track the crank angle by the displacement: the first part of `process_recording`.

    Parameters
    ----------
    recording : Recording
    config : BenchConfig

    Returns
    -------
    TrackedTrial
        Without an angle where the displacement has no complete stroke; of the quality, what a channel says by itself.
    """
    recording = with_true_values(recording, config)
    channels = clean_channels(recording)
    displacement = _alive_displacement(channels)
    tracked = None if displacement is None else _track(displacement, channels, config, recording.trial)
    angle, steady = (None, None) if tracked is None else tracked
    channels = with_impacts(channels, recording, angle)
    return TrackedTrial(
        trial=recording.trial,
        angle=angle,
        steady=steady,
        channels=without_spikes(recording, channels),
        quality=tuple(channel.quality for channel in channels.values()),
    )


def _alive_displacement(channels: Channels) -> CleanChannel | None:
    displacement = channels.get(_DISPLACEMENT)
    return displacement if displacement is not None and float(np.ptp(displacement.values)) > 0 else None


def _track(
    displacement: CleanChannel, channels: Channels, config: BenchConfig, trial: Trial
) -> tuple[CrankAngle, SteadyPart] | None:
    """Crank angle by the displacement, and its steady part; None without a complete stroke."""
    time_s, position_m = displacement.time_s, DISPLACEMENT.si_factor * displacement.values
    angle = track_crank_angle(
        time_s, position_m, mechanism=None if config.plant is None else Mechanism.of(config.plant)
    )  # fmt: skip
    if angle is None:
        return None
    force = None if trial.is_idle or config.linear_axis is not None else channels.get(_FORCE)
    cut = None if force is None else find_cut(angle, force.time_s, force.values)
    current = channels.get(_CURRENT)
    steady = find_steady_part(angle, cut, None if current is None else (current.time_s, current.values))
    return restore_ripple(angle, steady, time_s, position_m), steady


def _find_motion(channels: Channels, config: BenchConfig, trial: Trial) -> _Motion:
    """Angle from the displacement where it has any, else from the strongest line of another channel."""
    displacement = _alive_displacement(channels)
    if displacement is not None:
        return _motion_from_displacement(displacement, channels, config, trial)
    warnings = ("the displacement is constant; it is not used",) if _DISPLACEMENT in channels else ()
    band = config.stroke_rates_hz
    lines = {
        name: line
        for name in _LINE_CHANNELS
        if name in channels and (line := _stroke_line(channels[name], (), band)) is not None
    }
    if not lines:
        warnings += ("no channel has a significant periodic component",)
        return _Motion(angle=None, phases=(), cycles=None, period=None, warnings=warnings)
    chosen, *others = lines.values()
    channel = channels[chosen.channel]
    angle = angle_from_line(
        channel.time_s,
        channel.values,
        chosen.rate_hz * chosen.order,
        order=chosen.order,
        peak_at_rad=_fastest_cut_rad(config) * chosen.order,
        noise_power=line_noise_power(chosen, _WINDOW_CYCLES, channel.values),
        source=chosen.channel,
    )
    warnings += (
        f"no displacement: the crank angle comes from the phase of {chosen.channel}, its zero assumed so "
        "that this channel peaks where the blade cuts fastest",
    )
    phases, stretches, cycles, more = _phases_and_cycles(angle, channels, channel.holes)
    period = from_line(angle, stretches, cycles, chosen, others, band, _nominal_rates_hz(channels, config, trial))
    return _Motion(
        angle=angle, phases=phases, cycles=cycles, period=period, warnings=warnings + more,
        steady=find_steady_part(angle),
    )  # fmt: skip


def _nominal_rates_hz(channels: Channels, config: BenchConfig, trial: Trial) -> tuple[float, float] | None:
    """Between which stroke rates a saw runs at its supply: 55 to 105 % of the rate without load; None if not known."""
    plant, converter = config.plant, config.converter
    voltage = channels.get("battery_voltage_v")
    if converter.mode == "held_voltage":
        motor_v = converter.voltage_v
    elif trial.duty is not None and voltage is not None and len(voltage.values):
        motor_v = trial.duty * float(np.median(voltage.values))
    elif trial.duty is not None and config.battery is not None:
        motor_v = trial.duty * config.battery.nominal_voltage_v
    else:
        motor_v = None
    if plant is None or not motor_v:
        return None
    unloaded_hz = motor_v / (plant.back_emf_constant_v_s_per_rad.nominal * plant.gear_ratio) / (2 * np.pi)
    return _LOADED * unloaded_hz, _UNLOADED * unloaded_hz


def _fastest_cut_rad(config: BenchConfig) -> float:
    """Crank angle on the cutting half at which the blade is fastest for the crank's speed; of a yoke its middle."""
    within_rad = 0.5 * np.pi
    if config.plant is not None:
        half_turn = np.linspace(0.0, np.pi, 1801)
        within_rad = float(half_turn[np.argmax(Mechanism.of(config.plant).lever(half_turn))])
    return 2.0 * np.pi - within_rad if config.cutting.cutting_half == "pi_to_2pi" else within_rad


def _why_no_stroke(displacement: CleanChannel) -> str:
    low, high = robust_range(displacement.values)
    step = float(np.median(np.abs(np.diff(displacement.values)))) if len(displacement.values) > 1 else 0.0
    if step <= _COARSE_SHARE * (high - low):
        return "the displacement has no complete stroke"
    return (
        f"the displacement jumps by {step:.3g} {displacement.unit} of {high - low:.3g} from one sample to the next: "
        f"{displacement.quality.rate_hz:.4g} Hz are too few samples a stroke; record faster"
    )


def _motion_from_displacement(
    displacement: CleanChannel, channels: Channels, config: BenchConfig, trial: Trial
) -> _Motion:
    plant, time = config.plant, displacement.time_s
    tracked = _track(displacement, channels, config, trial)
    if tracked is None:
        rest = Phase(kind="rest", start_s=float(time[0]), end_s=float(time[-1]))
        warning = _why_no_stroke(displacement)
        return _Motion(angle=None, phases=(rest,), cycles=None, period=None, warnings=(warning,))
    angle, steady = tracked
    phases, stretches, cycles, warnings = _phases_and_cycles(angle, channels, displacement.holes, steady.cut)
    band = config.stroke_rates_hz
    line = _stroke_line(displacement, stretches, band) if stretches else None
    is_clipped = displacement.quality.n_clipped > _CLIPPED_SHARE * displacement.quality.n_samples
    doubt = "the displacement is clipped" if is_clipped else (warnings[0] if warnings else "")
    period = from_displacement(angle, stretches, cycles, line, band, doubt)
    if steady.cut is not None:
        warnings += (steady.cut.words,)
    if plant is None and config.linear_axis is None:
        warnings += ("the configuration has no [plant]: the mechanism is taken as a Scotch yoke",)
    elif plant is not None:
        nominal = plant.crank_radius_m
        if abs(angle.radius_m - nominal.nominal) > max(5 * nominal.std, 0.01 * nominal.nominal):
            warnings += (
                f"the stroke measures a crank radius of {1e3 * angle.radius_m:.4g} mm, configured are "
                f"{1e3 * nominal.nominal:.4g} mm; the measured one is used for the angle",
            )
    return _Motion(angle=angle, phases=phases, cycles=cycles, period=period, warnings=warnings, steady=steady)


def _stroke_line(channel: CleanChannel, stretches: Stretches, band: tuple[float, float]) -> StrokeLine | None:
    """Ask the longest stretch of a channel without holes for the stroke rate."""
    spectrum = longest_spectrum(channel.time_s, channel.values, stretches, channel.holes, band)
    return None if spectrum is None else find_stroke_line(spectrum, channel.channel, *band)


def _phases_and_cycles(
    angle: CrankAngle, channels: Channels, holes: Stretches, cut: Cut | None = None
) -> tuple[tuple[Phase, ...], Stretches, Cycles, tuple[str, ...]]:
    """Phases, the stretches whose strokes count, and the strokes in them from dead centre to dead centre."""
    current = channels.get(_CURRENT)
    phases = find_phases(
        angle,
        current_time_s=None if current is None else current.time_s,
        current_a=None if current is None else current.values,
    )
    phases = with_air(phases, cut)
    running = without_holes(tuple((p.start_s, p.end_s) for p in phases if p.kind == "running"), holes)
    cycles = find_cycles(angle.time_s, angle.angle_rad, running)
    if len(cycles.index):
        return phases, running, cycles, ()
    moving = [(p.start_s, p.end_s) for p in phases if p.kind in ("spin_up", "running", "spin_down")]
    whole = without_holes(((moving[0][0], moving[-1][1]),), holes) if moving else ()
    cycles = find_cycles(angle.time_s, angle.angle_rad, whole)
    turned = max((float(np.ptp(np.interp(part, angle.time_s, angle.angle_rad))) for part in running), default=0.0)
    stretches = running if turned > 2 * np.pi else whole
    if len(cycles.index):
        return phases, stretches, cycles, ("no steady speed: strokes at changing speed are used",)
    warning = "no complete stroke from dead centre to dead centre without a gap: no folded cycle"
    return phases, stretches, cycles, (warning,)


def _status_without_cutting(channels: Channels, config: BenchConfig, trial: Trial, motion: _Motion) -> TrialStatus:
    """Status as far as the motion decides it ("cutting" where a saw moves)."""
    if config.linear_axis is not None and motion.period is not None:
        return "moving"
    if any(phase.kind == "stall" for phase in motion.phases):
        return "stalled"
    if motion.period is not None:
        return "cutting"
    current, displacement = channels.get(_CURRENT), channels.get(_DISPLACEMENT)
    if current is None:
        return "no_stroke"
    if displacement is not None and float(np.ptp(displacement.values)) > 12 * displacement.noise_std > 0:
        return "no_stroke"  # it moved, but not for a whole stroke
    expected = None
    if config.plant is not None and config.battery is not None:
        duty = trial.duty if trial.duty is not None else config.converter.default_duty
        expected = duty * config.battery.nominal_voltage_v / config.plant.resistance_ohm.nominal
    is_stalled = stalled_from_start(current.time_s, current.values, current.noise_std, expected)
    return "stalled" if is_stalled else "no_stroke"


def _with_cycles(
    base: ProcessedTrial,
    signals: Mapping[str, Signal],
    channels: Channels,
    config: BenchConfig,
    angle: CrankAngle,
    cycles: Cycles,
) -> ProcessedTrial:
    """Add everything that needs complete strokes."""
    per_channel = {name: _covered(cycles, channel) for name, channel in channels.items()}
    n_samples = sum(len(channel.values) for channel in channels.values())
    folded = fold_signals(
        angle.time_s,
        angle.angle_rad,
        {name: (c.unit, c.time_s, c.values) for name, c in channels.items()},
        per_channel,
        n_bins=config.analysis.n_bins,
        n_threads=2 if n_samples > _TWO_THREADS_FROM else 1,
    )
    values = {name: (c.time_s, c.values) for name, c in channels.items()}
    slips = find_slips(angle, values, per_channel) if angle.is_absolute else ()
    offsets = stroke_offsets(signals, values, folded, per_channel, angle, config)
    averages = {
        name: cycle_averages(channels[name].time_s, channels[name].values, per_channel[name]) for name in folded
    }
    status, cutting, removed, peak, warnings = _cutting(base, channels, config, angle, per_channel, folded)
    return replace(
        base,
        status=status,
        folded=folded,
        cutting_force=cutting,
        removed=removed,
        peak_force_n=None if peak is None else peak.mean_n,
        peak_force_std_n=None if peak is None else peak.mean_std_n,
        mean_values={name: value[0] for name, value in averages.items()},
        rms_values={name: value[1] for name, value in averages.items()},
        quality=_with_slips(base.quality, slips),
        offsets=offsets,
        warnings=(
            *base.warnings,
            *warnings,
            *(f"{slip.channel}: {slip.words()}" for slip in slips),
            *(offset.problem for offset in offsets if offset.problem),
        ),
    )


def _with_slips(quality: tuple[ChannelQuality, ...], slips: tuple[Slip, ...]) -> tuple[ChannelQuality, ...]:
    """Add to the health of each channel where it moves in time against the strokes."""
    said = {q.channel: tuple(slip.words() for slip in slips if slip.channel == q.channel) for q in quality}
    return tuple(replace(q, problems=q.problems + said[q.channel], doubts=q.doubts + said[q.channel]) for q in quality)


def _covered(cycles: Cycles, channel: CleanChannel) -> Cycles:
    """Keep the cycles that lie inside the channel's samples and touch none of its gaps."""
    keep = (cycles.start_s >= channel.time_s[0]) & (cycles.end_s <= channel.time_s[-1])
    for start, end in channel.holes:
        keep &= (cycles.end_s <= start) | (cycles.start_s >= end)
    return Cycles(index=cycles.index[keep], start_s=cycles.start_s[keep], end_s=cycles.end_s[keep])


def _cutting(
    base: ProcessedTrial,
    channels: Channels,
    config: BenchConfig,
    angle: CrankAngle,
    cycles: dict[str, Cycles],
    folded: dict[str, FoldedCycle],
) -> tuple[TrialStatus, FoldedCycle | None, RemovedForce | None, PeakForce | None, tuple[str, ...]]:
    """Whether it cut, and the cutting force."""
    status = base.status
    if status == "moving":
        return status, None, None, None, ()
    force = folded.get(_FORCE)
    if force is None:
        if base.trial.is_idle and status == "cutting":
            status = "no_cutting"
        return status, None, None, None, ("no usable force: it is unknown whether the saw cut",)
    cuts = has_locked_force(force, channels[_FORCE].noise_std)
    warnings: tuple[str, ...] = ()
    if base.trial.is_idle:
        if cuts:
            warnings += ("an idle run is stated, but the force is synchronous with the stroke",)
        cuts = False
    if not cuts:
        return ("no_cutting" if status == "cutting" else status), None, None, None, warnings
    cutting, removed = zero_return_stroke(force, config.cutting.cutting_half)
    if removed.looks_swapped:
        warnings += (
            f"the zeroed half {removed.half} has {100 * removed.share_of_impulse:.0f} % of the force: "
            "cutting_half in the configuration is probably wrong",
        )
    channel = channels[_FORCE]
    peak = estimate_peak_force(
        cutting, angle.time_s, angle.angle_rad, channel.time_s, channel.values, cycles[_FORCE].index
    )
    if peak is not None and not removed.looks_swapped and stands_at_a_level(removed, peak.mean_n):
        warnings += (
            f"the force stands at {removed.mean_n:.3g} N while the blade returns: is the load cell tared? If not, every"
            " force is off by that, the peak too: tare it, or state it as offset in [sensors.force_n]",
        )
    return status, cutting, removed, peak, warnings


def has_locked_force(force: FoldedCycle, noise_std_n: float) -> bool:
    """Whether the force follows the stroke beyond what noise leaves in the mean cycle.

    Parameters
    ----------
    force : FoldedCycle
    noise_std_n : float
        White noise of a single sample, N.

    Returns
    -------
    bool
        True where the variance of the mean cycle exceeds four times what the scatter from cycle to cycle
        explains, and its rms half the noise of a sample and 0.1 N.
    """
    varies = float(np.var(force.mean))
    by_chance = float(np.mean(force.std**2)) / force.n_cycles if force.n_cycles > 1 else noise_std_n**2
    return varies > 4 * by_chance and np.sqrt(varies) > max(0.5 * noise_std_n, 0.1)


def _quality_warnings(quality: tuple[ChannelQuality, ...]) -> tuple[str, ...]:
    return tuple(f"{q.channel}: {problem}" for q in quality for problem in q.problems)
