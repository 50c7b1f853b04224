"""What the processing finds in one trial. Shared, because storage writes it and reports show it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np
from sawbench.bench.folded import FoldedCycle
from sawbench.bench.recording import Floats, Signal, Trial, loss_in_words

Confidence = Literal["high", "moderate", "low"]
PhaseKind = Literal["rest", "spin_up", "in_air", "running", "spin_down", "stall"]
# Whose equations a machine moves by: those of a driven crank, or of a force on a mass.
Frame = Literal["crank", "linear_axis"]
TrialStatus = Literal["cutting", "no_cutting", "moving", "stalled", "no_stroke"]


@dataclass(frozen=True, kw_only=True, slots=True)
class PeriodCandidate:
    """A period that the spectrum also allows.

    Attributes
    ----------
    period_s : float
    relative_power : float
        Power of its line (and harmonics) relative to the chosen one.
    reason : str
        Why it is not the answer, or why it could be.
    """

    period_s: float
    relative_power: float
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class PeriodEstimate:
    """Stroke period with its standard uncertainty.

    Attributes
    ----------
    period_s : float
        Mean stroke period over the running part, s.
    period_std_s : float
        Standard uncertainty of `period_s`, s.
    spread_s : float
        Standard deviation from stroke to stroke, s.
    n_cycles : int
        Complete cycles it rests on.
    confidence : {"high", "moderate", "low"}
    reason : str
        Why the confidence is what it is.
    channel : str
        Channel it was found in.
    rivals : tuple of PeriodCandidate
        Most likely first; empty where nothing else fits.
    """

    period_s: float
    period_std_s: float
    spread_s: float
    n_cycles: int
    confidence: Confidence
    reason: str
    channel: str
    rivals: tuple[PeriodCandidate, ...] = ()

    @property
    def rate_hz(self) -> float:
        """Stroke rate, Hz."""
        return 1.0 / self.period_s


@dataclass(frozen=True, kw_only=True, slots=True)
class CrankAngle:
    """Crank angle and speed over time, from the displacement (or from the phase of another channel).

    Attributes
    ----------
    time_s : ndarray, shape (n,), s
    angle_rad : ndarray, shape (n,), rad
        Unwrapped and never decreasing; 0 (mod 2*pi) is the dead centre where the displacement is smallest.
    speed_rad_s : ndarray, shape (n,), rad/s
    angle_std_rad : ndarray, shape (n,), rad
        Standard uncertainty of the angle.
    radius_m : float
        Crank radius used or estimated, m (0 where the angle does not come from displacement).
    source : str
        Channel the angle comes from.
    is_absolute : bool
        False where the zero of the angle is unknown (no displacement).
    rod_length_m : float or None
        Connecting rod of the slider-crank that the angle was tracked with; None for a Scotch yoke.
    ripple_std_rad : ndarray, shape (k,)
        Standard uncertainty of the harmonics 1..k of the angle within the mean stroke; empty where no mean
        stroke was regressed.
    """

    time_s: Floats
    angle_rad: Floats
    speed_rad_s: Floats
    angle_std_rad: Floats
    radius_m: float
    source: str
    is_absolute: bool
    rod_length_m: float | None = None
    ripple_std_rad: Floats = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, kw_only=True, slots=True)
class Phase:
    """A stretch of the trial: at rest, spinning up, running, spinning down, stalled; in air, where it is to cut."""

    kind: PhaseKind
    start_s: float
    end_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Cut:
    """Part of a trial in which the blade cuts.

    Attributes
    ----------
    start_s, end_s : float or None
        The first stroke that is wholly in the wood begins, the last one ends; None where no stroke is in air before or
        behind.
    """

    start_s: float | None = None
    end_s: float | None = None

    @property
    def words(self) -> str:
        """For the technician."""
        if self.start_s is None:
            return f"the blade leaves the wood after {self.end_s:.2f} s; the strokes in air behind are left out"
        if self.end_s is None:
            return f"the blade cuts from {self.start_s:.2f} s on; the strokes in air before are left out"
        return f"the blade cuts from {self.start_s:.2f} s to {self.end_s:.2f} s; the strokes in air are left out"


@dataclass(frozen=True, kw_only=True, slots=True)
class SteadyPart:
    """The longest part of a trial in which the blade neither stands nor slows down, and cuts where it is to cut.

    Attributes
    ----------
    first_motion_s : float
        Time at which the crank begins to turn; the first sample where it turns all along.
    start_s, end_s : float
        The first motion and the end of the trial where nothing interrupts it.
    settled_s : float
        From here on strokes are compared with a model of settled strokes; may lie behind `end_s`.
    cut : Cut or None
        In which part of a cutting trial the blade cuts; None where it does all along.
    """

    first_motion_s: float
    start_s: float
    settled_s: float
    end_s: float
    cut: Cut | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class RemovedForce:
    """What zeroing the return stroke took away; reported, not hidden.

    Attributes
    ----------
    mean_n, rms_n, peak_n : float
        Of the force on the return half before it was set to zero, N.
    share_of_impulse : float
        Mean absolute force removed over mean absolute force of the whole cycle, 0..1.
    half : str
        "zero_to_pi" or "pi_to_2pi": the half that was zeroed.
    looks_swapped : bool
        True where the removed half carries more force than the kept one: the cutting half of the
        configuration is probably wrong.
    """

    mean_n: float
    rms_n: float
    peak_n: float
    share_of_impulse: float
    half: str
    looks_swapped: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelQuality:
    """Health of one channel.

    Attributes
    ----------
    channel, unit : str
    rate_hz : float
        Median sample rate.
    n_samples, n_missing : int
    jitter_std_s : float
        Standard deviation of the sample interval.
    noise_std : float
        White-noise estimate, in `unit`.
    n_spikes, n_clipped : int
    n_impacts : int
        Spikes at one crank angle: impacts in the machine, kept.
    problems : tuple of str
    doubts : tuple of str
        Those of `problems` that make the values wrong, not only fewer: clipped, reversed, swapped, in another
        unit, not connected, moved in time. A result that rests on such a channel is not reliable.
    """

    channel: str
    unit: str
    rate_hz: float
    n_samples: int
    n_missing: int
    jitter_std_s: float
    noise_std: float
    n_spikes: int
    n_clipped: int
    n_impacts: int = 0
    problems: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeOffset:
    """How much later a channel comes than the displacement, which another instrument delivers, by their strokes.

    Attributes
    ----------
    channel, device : str
    against : str
        Instrument of the displacement.
    offset_s, offset_std_s : float or None
        Positive: too late; and its standard uncertainty with that of the model. None where the trial cannot tell.
    repeat_std_s : float or None
        The part of `offset_std_s` that differs from trial to trial: what a difference between two trials of one
        session is known to.
    change_s, change_std_s : float or None
        How much later it comes at the end of the trial than at its beginning, and its standard uncertainty.
    stated_std_s, stated_latency_s : float or None
        What the recording states of its alignment: standard uncertainty and largest latency.
    reason : str
        Why there is no offset.
    problem : str
        What contradicts the stated alignment; empty where nothing does.
    """

    channel: str
    device: str
    against: str
    offset_s: float | None = None
    offset_std_s: float | None = None
    repeat_std_s: float | None = None
    change_s: float | None = None
    change_std_s: float | None = None
    stated_std_s: float | None = None
    stated_latency_s: float | None = None
    reason: str = ""
    problem: str = ""

    def words(self) -> str:
        """Say offset and change with their uncertainties, or that the trial cannot tell.

        Examples
        --------
        >>> StrokeOffset(channel="force_n", device="b", against="a", offset_s=2e-4, offset_std_s=3e-4).words()
        'force_n (b) against a: +0.20 ± 0.30 ms'
        """
        parts = []
        if self.offset_s is not None and self.offset_std_s is not None:
            parts.append(f"{1e3 * self.offset_s:+.2f} ± {1e3 * self.offset_std_s:.2f} ms")
        else:
            parts.append(f"offset not known ({self.reason})")
        if self.change_s is not None and self.change_std_s is not None:
            parts.append(f"change within the trial {1e3 * self.change_s:+.2f} ± {1e3 * self.change_std_s:.2f} ms")
        if self.stated_std_s is not None and self.stated_latency_s is not None:
            stated, latency = f"{1e3 * self.stated_std_s:.2f}", f"{1e3 * self.stated_latency_s:.1f}"
            parts.append(f"stated alignment ± {stated} ms, plus up to {latency} ms of latency")
        return f"{self.channel} ({self.device or 'no instrument named'}) against {self.against}: {'; '.join(parts)}"


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackedTrial:
    """The channels of one recording, and the crank angle at every time: what strokes are laid over each other by.

    Attributes
    ----------
    trial : Trial
    angle : CrankAngle or None
    steady : SteadyPart or None
        None where there is no angle.
    channels : mapping of str to Signal
        Every channel as recorded, without its spikes; empty in a result that was read back from a file.
    quality : tuple of ChannelQuality
    """

    trial: Trial
    angle: CrankAngle | None
    steady: SteadyPart | None = None
    channels: Mapping[str, Signal] = field(default_factory=dict)
    quality: tuple[ChannelQuality, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))


@dataclass(frozen=True, kw_only=True, slots=True)
class ProcessedTrial(TrackedTrial):
    """Everything `sawbench process` finds in one recording: a `TrackedTrial`, and what its strokes say.

    Attributes
    ----------
    status : {"cutting", "no_cutting", "moving", "stalled", "no_stroke"}
        "moving" of a machine that cuts nothing.
    period : PeriodEstimate or None
        None only where status is "no_stroke" (or the trial is stalled from the start).
    phases : tuple of Phase
    folded : mapping of str to FoldedCycle
        Every channel as measured.
    cutting_force : FoldedCycle or None
        Force with the return stroke set to zero.
    removed : RemovedForce or None
    peak_force_n, peak_force_std_n : float or None
        Mean over the cycles of the largest cutting force, and its standard uncertainty.
    mean_values : mapping of str to float
        Mean of each channel over the running part; keys are channel names.
    rms_values : mapping of str to float
    offsets : tuple of StrokeOffset
        Of the channels of other instruments than the displacement's.
    warnings : tuple of str
    source_path, source_sha256 : str
    frame : {"crank", "linear_axis"}
        Of the machine that the configuration describes.
    """

    status: TrialStatus
    period: PeriodEstimate | None
    phases: tuple[Phase, ...]
    folded: Mapping[str, FoldedCycle]
    cutting_force: FoldedCycle | None
    removed: RemovedForce | None
    peak_force_n: float | None
    peak_force_std_n: float | None
    mean_values: Mapping[str, float] = field(default_factory=dict)
    rms_values: Mapping[str, float] = field(default_factory=dict)
    offsets: tuple[StrokeOffset, ...] = ()
    warnings: tuple[str, ...] = ()
    source_path: str = ""
    source_sha256: str = ""
    frame: Frame = "crank"

    @property
    def losses(self) -> tuple[str, ...]:
        """Channels that miss more than a hundredth of their samples, in words."""
        said = (loss_in_words(q.channel, q.n_samples, q.n_missing) for q in self.quality)
        return tuple(text for text in said if text)

    def doubts(self, *channels: str) -> tuple[str, ...]:
        """What makes results wrong that rest on these channels; empty where nothing does.

        Parameters
        ----------
        channels : str
            Channel names; those the trial does not have are passed over.
        """
        found = [f"{q.channel}: {text}" for q in self.quality if q.channel in channels for text in q.doubts]
        rests_on_half = "force_n" in channels or "displacement_mm" in channels
        if rests_on_half and self.removed is not None and self.removed.looks_swapped:
            found.append(
                f"the force is on the half {self.removed.half}, which is the return stroke according to the"
                " configuration"
            )
        return tuple(found)

    def __post_init__(self) -> None:
        for name in ("folded", "mean_values", "rms_values", "channels"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
