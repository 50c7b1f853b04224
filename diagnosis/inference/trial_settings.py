"""Settings of the diagnosis, part one: what of a trial is used, and what it holds beside its strokes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sawbench.diagnosis.inference.marked_number import marked


@dataclass(frozen=True, kw_only=True, slots=True)
class Screening:
    """When a trial or a channel is left out; the bounds of `bench.plausible` hold beside them.

    Attributes
    ----------
    saturated_share : float
        Share of the samples at a limit from which a channel is left out.
    stalled_share : float
        Of the driving voltage: resistive drop from which a motor without strokes is stalled.
    duty_deviation : float
        A duty that lies this far from what current and speed ask for, against the other trials, is doubted.
    duty_least_trials : int
        From which that is asked.
    alike_current : float
        Relative difference of the motor currents of trials that repeat each other.
    cuts_nothing : float
        Share of the usual cutting power below which a trial cut nothing.
    another_machine : float
        Factor between a stated number and the one that the recordings ask for from which they are of another machine,
        or in another unit.
    at_odds : float
        Share of cutting trials whose force and displacement contradict each other from which the rest is doubted too.
    most_excess : float
        Factor beyond a bound up to which most trials may contradict the model and be a gap of it.
    least_strokes : int
        With fewer a blade makes no strokes.
    clear_cut_w : float
        Shaft power below which a cut says nothing of the force.
    other_half : float
        Mean force on the weaker half of the turn, over that on the other, below which one half has the cut.
    locked : float
        Agreement of the phases of a trial's strokes with the crank angle, 0 to 1, that a trial needs.
    phase_spread_rad : mapping of str to float
        How far a trial's phase may lie from that of the others.
    foreign_share : float
        Of the trials: from it on, not the trials are foreign but something else is wrong.
    lost_strokes : float
        Share of the strokes from which dropouts are said.
    """

    saturated_share: float = marked(0.005, "convention", "less costs nothing")
    stalled_share: float = marked(0.3, "convention", "of a running motor the back-EMF holds most of the voltage")
    duty_deviation: float = marked(0.055, "fitted", "no effect at twice its size passes it; a step of 1/16 does")
    duty_least_trials: int = marked(6, "convention", "twice the numbers of the line that they are compared with")
    alike_current: float = marked(0.15, "convention", "three times the scatter of repeats in wood")
    cuts_nothing: float = marked(0.05, "convention", "a twentieth of the usual: no wood is that soft")
    another_machine: float = marked(
        30.0, "convention", "nearer to a thousand, the usual factor between units, than to one"
    )
    at_odds: float = marked(0.3, "convention", "about one of three")
    most_excess: float = marked(
        2.0, "convention", "units, exchanged channels and dead sensors differ by more, or by sign"
    )
    least_strokes: int = marked(3, "convention", "two intervals that can be compared")
    clear_cut_w: float = marked(2.0, "convention", "less than any cut takes")
    other_half: float = marked(0.4, "convention", "inertia and offsets hold less than half of the force")
    locked: float = marked(0.8, "measured", "trials of development campaigns agree above 0.97")
    phase_spread_rad: Mapping[str, float] = marked(
        {"force": 0.6, "current": 1.0, "current in air": 1.0}, "measured",
        "0.1 rad for the force, 0.4 rad for the current in air, at twice the usual effects",
    )  # fmt: skip
    foreign_share: float = marked(0.3, "convention", "as at_odds")
    lost_strokes: float = marked(0.2, "convention", "one stroke of five")


@dataclass(frozen=True, kw_only=True, slots=True)
class Reading:
    """When what was read from a trial is trusted.

    Attributes
    ----------
    least_coverage : float
        Share of the cells of an average that must hold samples.
    noise_margin : float
        A harmonic counts in a signature as far as its power is above that many times its own variance.
    by_chance : float
        Probability with which noise may pass for a motion of the blade beyond the crank's, in any harmonic of a trial.
    spike_share : float
        Displacement that far from the tracked one, as a share of the radius, is a spike; play is less.
    least_swing_n : float
        Of the force at one stroke: below it the force says nothing of the angle.
    clear_harmonic : float
        Of the current in air, over the odd harmonics: below it the current says nothing of the angle.
    irregular : float
        Interquartile range of stroke times over their median from which these are no strokes.
    clear_line : float
        Height of the line of the strokes over the median of the spectrum around it, in amplitude.
    cyclic_share : float
        Of the variance of an axis's displacement that cycles at one rate must hold.
    lacking_samples : float
        Of a cycle of an axis that may lack at an end of the record for it to count.
    other_motion : float
        Relative difference of a cycle's motion from the usual one from which it is another motion.
    """

    least_coverage: float = marked(0.5, "convention", "more is measured than filled in")
    noise_margin: float = marked(3.0, "convention", "95 % point of a variance with one degree of freedom is 3.8")
    by_chance: float = marked(0.05, "convention", "one trial in twenty")
    spike_share: float = marked(0.1, "convention", "play is less")
    least_swing_n: float = marked(3.0, "convention", "above the noise of load cells")
    clear_harmonic: float = marked(3.0, "convention", "a phase is then certain to a third of a radian")
    irregular: float = marked(0.5, "measured", "noise that crosses its middle has about 1")
    clear_line: float = marked(12.0, "convention", "the largest of 8000 bins of noise is 3.6 times their median")
    cyclic_share: float = marked(0.8, "convention", "as locked")
    lacking_samples: float = marked(3.0, "convention", "what is not recorded has any acceleration")
    other_motion: float = marked(0.1, "convention", "repeats of a controlled axis differ by far less")


@dataclass(frozen=True, kw_only=True, slots=True)
class OffStroke:
    """When what does not follow the stroke is a line or a burst, and no scatter.

    Attributes
    ----------
    least_strokes : int
        Complete strokes that a trial needs.
    lowest_order : float
        Cycles a stroke below which a wave is one of the wood or of the hand: see `stroke_series`.
    near_harmonic : float
        Cycles a stroke: harmonics scatter from stroke to stroke, so no line is looked for that near to one.
    least_power, seen_power : float
        Power over the floor around a line: of the strongest of a set, and of its companions.
    foot_share : float
        A line is narrow: beside it no more than that share of its power is left.
    least_share : float
        Of the variance that does not follow the stroke: what is smaller is a matter of the sensor, not of the machine.
    most_of_it : float
        The same of a line that has no place in common with those of other trials.
    same_current : float
        Logarithm of the ratio of two amplitudes of one current, as two sensors measure them.
    duty_tells : float
        Below it the battery's current is told from that of the motor by its size.
    same_place : float
        Relative difference of two lines that are one.
    in_most : float
        Share of the trials that could show something, in which it must stand to be common to a campaign.
    feed_error : float
        Relative, of the feed that a trial states.
    by_chance : float
        Log likelihood by which one description of a line has to be better than another, nats; so much at most a single
        place that fits neither counts, and so much at least a slow wave has to gain in air.
    most_per_trial : float
        Log evidence that one trial may give, nats.
    ripple_of_bars, ripple_of_armature : float
        What every commutator leaves in a current as its bars pass, and at each turn or half turn: share of the largest
        mean.
    ripple_of_converter : float
        The same of what its switching leaves at a fixed frequency.
    unsteady_friction : float
        Standard deviation of the friction in air from a few strokes to the next: share of the torque of the usual cut.
    strike : float
        Robust deviations by which a cell of the crank angle and a neighbour are off: a stray value is shorter.
    least_struck : float
        Share of the variance that strikes of a machine hold.
    least_picked_up : float
        The same of interference in air: scatter and lines give no strike at all.
    same_burst, felt : float
        Of a stroke: strikes that near are one burst; for so long the motor feels a blow.
    felt_stds : float
        Significance of the motor's answer to blows.
    """

    least_strokes: int = marked(12, "convention", "two thirds of a spectrum are then beside its harmonics")
    lowest_order: float = marked(0.25, "convention", "four strokes a wave")
    near_harmonic: float = marked(
        0.06, "convention", "half width, 1/(6 pi), of a harmonic that remembers three strokes"
    )
    least_power: float = marked(60.0, "convention", "beyond scatter: the largest of 8000 bins is about 9")
    seen_power: float = marked(20.0, "convention", "scatter reaches it once in 6 10^4 such spectra")
    foot_share: float = marked(0.1, "convention", "of a window's line nothing is left there, of a hump most is")
    least_share: float = marked(0.15, "convention", "less is hidden by the scatter itself")
    most_of_it: float = marked(0.5, "convention", "more than all else together")
    same_current: float = marked(0.15, "convention", "of a strong line, amplitudes are known to a tenth each")
    duty_tells: float = marked(0.75, "convention", "twice `same_current` below 1")
    same_place: float = marked(0.003, "convention", "clocks and speeds are known to better than that")
    in_most: float = marked(0.7, "convention", "more than two of three")
    feed_error: float = marked(0.05, "convention", "what a slide keeps under load")
    by_chance: float = marked(4.5, "convention", "three standard deviations")
    most_per_trial: float = marked(20.0, "convention", "no single trial names a cause: one in e^20")
    ripple_of_bars: float = marked(0.05, "convention", "1/k^2 of the back-EMF with k = 5, and the current not less")
    ripple_of_armature: float = marked(0.01, "convention", "windings of one machine are alike to a per cent")
    ripple_of_converter: float = marked(0.01, "convention", "of a ripple of ten per cent a filter leaves a tenth")
    unsteady_friction: float = marked(0.05, "convention", "brushes, grease and bearings; a twentieth, as of any effect")
    strike: float = marked(8.0, "convention", "no scatter reaches it, nor do heavy tails twice in a row")
    least_struck: float = marked(0.3, "convention", "a third of what is asynchronous")
    least_picked_up: float = marked(0.03, "convention", "ten times below what a machine is blamed for")
    same_burst: float = marked(0.15, "convention", "shorter than the cut, which is half a stroke")
    felt: float = marked(0.25, "convention", "the motor's time constant, in strokes")
    felt_stds: float = marked(4.0, "convention", "one in 3 10^4 by chance")
