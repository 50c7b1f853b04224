"""Measured motion and signals on one grid: what every residual and every effect signature is computed from.

All arrays of one `State` have the same shape: (n_units, n_bins) for running strokes, where a unit is a few
consecutive strokes averaged over the crank angle, or (1, n_times) for the start-up. SI units throughout.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Alignment, Floats

if TYPE_CHECKING:
    from sawbench.modeling.parts.mechanism import Mechanism

TWO_PI = 2.0 * np.pi
# Grid of a start-up.
START_UP_STEP_S = 1e-3


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialSetting:
    """What was commanded in one trial, and what the trials before it left behind.

    Attributes
    ----------
    label : str
    index : int
        Position in the campaign.
    duty : float
    is_idle : bool
        The blade runs in air.
    stock : str
        Workpiece and thickness: trials of one stock share one nominal cutting coefficient.
    feed_m_s, thickness_m : float
        NaN where nobody said.
    operating_point : str
        Trials of one operating point are repeats of each other.
    session_s : float
        Start of the trial since the start of the campaign, s.
    alignments : mapping of str to Alignment
        How well the times of each channel are known, where the recording states it.
    battery : int
        Number of the battery in the order of the campaign, 0 for the first.
    """

    label: str
    index: int
    duty: float
    is_idle: bool
    stock: str
    feed_m_s: float
    thickness_m: float
    operating_point: str
    session_s: float
    alignments: Mapping[str, Alignment] = field(default_factory=lambda: MappingProxyType({}), hash=False)
    battery: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Memory:
    """Slow state of an effect: a first-order memory of what drives it, tau dq/dt = drive - q, kept between trials.

    Attributes
    ----------
    drive : {"motor_current_squared_a2", "crank_speed_squared_rad2_s2", "battery_current_a"}
        Its unit is that of q. Between two trials the drive is 0.
    time_constant_s : float
    """

    drive: Literal["motor_current_squared_a2", "crank_speed_squared_rad2_s2", "battery_current_a"]
    time_constant_s: float


@dataclass(frozen=True, eq=False)
class Motion:
    """What follows from the motion of a state, worked out once and kept here; therefore without slots.

    Attributes
    ----------
    angle_rad, speed_rad_s : ndarray, shape (n_units, n_points)
    """

    angle_rad: Floats
    speed_rad_s: Floats
    _levers: dict[Mechanism, tuple[Floats, Floats]] = field(default_factory=dict, init=False, repr=False)

    def levers(self, mechanism: Mechanism) -> tuple[Floats, Floats]:
        """First and second derivative of the blade's travel by the angle, m; see `Mechanism.levers`."""
        if mechanism not in self._levers:
            self._levers[mechanism] = mechanism.levers(self.angle_rad)
        return self._levers[mechanism]

    @cached_property
    def slowness(self) -> Floats:
        """Time a turn at each angle, s; one row where all units are alike, as the strokes of an averaged state."""
        speed = self.speed_rad_s
        return TWO_PI / (speed[:1] if np.all(speed == speed[:1]) else speed)

    @cached_property
    def period_s(self) -> Floats:
        """Period of the stroke, shape (rows, 1)."""
        return self.slowness.mean(axis=-1, keepdims=True)

    @cached_property
    def times(self) -> Floats:
        """Time over each angle, 1 on average of a stroke; rows as of `slowness`."""
        return self.slowness / self.period_s

    @cached_property
    def turns(self) -> NDArray[np.complexfloating]:
        """exp(j n 2 pi t / T) at each crank angle, shape (rows, orders, points)."""
        n_points = self.slowness.shape[-1]
        # 2 pi times the share of the period that has passed: the integral of the slowness.
        spectrum = np.fft.rfft(self.times, axis=-1)
        spectrum[..., 0] = 0.0
        spectrum[..., 1:] /= 1j * np.arange(1, spectrum.shape[-1])
        phase = (np.arange(n_points) + 0.5) * TWO_PI / n_points + np.fft.irfft(spectrum, n_points, axis=-1)
        # Each order is the one before times the first: the exponential of a multiple would round the multiple as well.
        powers = np.repeat(np.exp(1j * phase)[..., None, :], n_points // 2, axis=-2)
        powers[..., 0, :] = 1.0
        return np.cumprod(powers, axis=-2)


@dataclass(frozen=True, kw_only=True, slots=True)
class State:
    """Measured state of one trial on a grid of shape (n_units, n_points).

    Attributes
    ----------
    kind : {"running", "start_up", "instant"}
        The last for single instants of a simulation: a row each, shape (n_units, 1).
    setting : TrialSetting
    angle_rad : ndarray
        Crank angle.
    speed_rad_s, acceleration_rad_s2 : ndarray
        Of the crank, with time.
    current_a, current_rate_a_s : ndarray or None
    force_n, force_rate_n_s : ndarray or None
        Positive when the blade cuts.
    battery_voltage_v, battery_current_a : ndarray or None
    motor_voltage_v : ndarray
        duty * battery voltage (measured where there is one, else of the battery model).
    time_s : ndarray, shape (n_units, 1)
        Time since the start of the trial.
    cut_distance_m : ndarray, shape (n_units, 1)
        Way of the teeth through the wood before, one stroke a turn, over the blade's life in this campaign.
    charge_used_as : ndarray, shape (n_units, 1)
        Charge taken from the battery before, A s.
    slow : mapping of Memory to ndarray, shape (n_units, 1)
        Slow states that effects need, computed once a campaign; read-only.
    k_guess_n_s_per_m : float
        k_Fc of the trial's stock by regression over the campaign; 0 in air.
    hardness : float
        Cutting coefficient of the trial's own piece over that of its stock.
    regressed_at_rad_s : float
        Crank speed at which it was regressed, as the trials of the stock count there; 0 where it is that of the cutting
        law, whatever else acts.
    k_below_n_s_per_m : float
        k_Fc of the trial by its own force far below the campaign's peak, which a clipped peak does not lower; 0 in air
        or where it is not known.
    peak_force_n, top_current_a : float
        Largest force of a mean stroke, and largest current of a mean stroke or a start-up, of the campaign; 0 where
        there is none.
    n_strokes : ndarray, shape (n_units,)
    motion : Motion
        Of `angle_rad` and `speed_rad_s`; made here.
    ripple_std_rad : ndarray, shape (k,)
        Standard uncertainty of the harmonics of the angle within the mean stroke; empty where none is known.
    resolved_orders : mapping of str to float
        Channel, by its name here -> highest harmonic of the stroke that its samples resolve; without an entry, all.
    resolved_s : mapping of str to float
        Of a start-up: channel, by its name here -> shortest time of which its samples resolve the mean, s; without an
        entry, any.
    blade_excess_m_s : ndarray or None
        Measured velocity of the blade beyond that of the crank's angle and speed (with the radius that was tracked):
        what the tracker of the angle is too slow for, as where a plunger crosses its play. None where it was not
        measured.
    stroke_std_m : ndarray, shape (n_points,) or (0,)
        Standard uncertainty of the mean displacement at each angle by coarse steps of its converter. They are the same
        in all strokes of a campaign: times the root of the trials, so that no average over trials lowers it. Empty
        where the steps are finer than the noise.
    excess_std_m_s : ndarray, shape (k,) or (0,)
        Standard uncertainty of sine and cosine part of the harmonics of a mean `blade_excess_m_s`, 0 where it has none;
        empty where it is no mean.
    """

    kind: Literal["running", "start_up", "instant"]
    setting: TrialSetting
    angle_rad: Floats
    speed_rad_s: Floats
    acceleration_rad_s2: Floats
    current_a: Floats | None
    current_rate_a_s: Floats | None
    force_n: Floats | None
    force_rate_n_s: Floats | None
    battery_voltage_v: Floats | None
    battery_current_a: Floats | None
    motor_voltage_v: Floats
    time_s: Floats
    cut_distance_m: Floats
    charge_used_as: Floats
    n_strokes: Floats
    slow: Mapping[Memory, Floats] = field(default_factory=dict)
    k_guess_n_s_per_m: float = 0.0
    hardness: float = 1.0
    regressed_at_rad_s: float = 0.0
    k_below_n_s_per_m: float = 0.0
    peak_force_n: float = 0.0
    top_current_a: float = 0.0
    ripple_std_rad: Floats = field(default_factory=lambda: np.zeros(0))
    resolved_orders: Mapping[str, float] = field(default_factory=dict)
    resolved_s: Mapping[str, float] = field(default_factory=dict)
    blade_excess_m_s: Floats | None = None
    stroke_std_m: Floats = field(default_factory=lambda: np.zeros(0))
    excess_std_m_s: Floats = field(default_factory=lambda: np.zeros(0))
    motion: Motion = field(default=None, repr=False, compare=False)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        object.__setattr__(self, "slow", MappingProxyType(dict(self.slow)))
        # A copy that moves the same keeps what was worked out.
        known = self.motion
        if known is None or known.angle_rad is not self.angle_rad or known.speed_rad_s is not self.speed_rad_s:
            object.__setattr__(self, "motion", Motion(self.angle_rad, self.speed_rad_s))


def angle_derivative(waves: Floats) -> Floats:
    """Derivative of periodic rows with respect to the crank angle."""
    n_points = waves.shape[-1]
    spectrum = np.fft.rfft(waves, axis=-1)
    spectrum *= 1j * np.arange(spectrum.shape[-1])
    return np.fft.irfft(spectrum, n_points, axis=-1)


def turned(state: State, wave_rad: Floats, shares: Sequence[float]) -> list[State]:
    """States as it is if its angle is larger by shares of a periodic wave, rad, of the angle's shape or one row."""
    faster = state.speed_rad_s * angle_derivative(wave_rad)
    gaining = state.speed_rad_s * angle_derivative(faster)
    return [
        replace(
            state,
            angle_rad=state.angle_rad + share * wave_rad,
            speed_rad_s=state.speed_rad_s + share * faster,
            acceleration_rad_s2=state.acceleration_rad_s2 + share * gaining,
        )
        for share in shares
    ]
