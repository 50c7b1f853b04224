"""Measured motion and signals on one grid: what every residual and every effect signature is computed from.

All arrays of one `State` have the same shape: (n_units, n_bins) for running strokes, where a unit is a few
consecutive strokes averaged over the crank angle, or (1, n_times) for the start-up. SI units throughout.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bench.recording import Floats

TWO_PI = 2.0 * np.pi


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


@dataclass(frozen=True, kw_only=True, slots=True)
class State:
    """Measured state of one trial on a grid of shape (n_units, n_points).

    Attributes
    ----------
    kind : {"running", "start_up"}
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
        Distance the blade had cut before, over its life in this campaign.
    charge_used_as : ndarray, shape (n_units, 1)
        Charge taken from the battery before, A s.
    slow : dict of str to ndarray, shape (n_units, 1)
        Slow states that effects need, computed once a campaign (heat filters, polarization filters).
    n_strokes : ndarray, shape (n_units,)
    ripple_std_rad : ndarray, shape (k,)
        Standard uncertainty of the harmonics of the angle within the mean stroke; empty where none is known.
    blade_excess_m_s : ndarray or None
        Measured velocity of the blade beyond that of the crank's angle and speed (with the radius that was tracked):
        what the tracker of the angle is too slow for, as where a plunger crosses its play. None where it was not
        measured.
    """

    kind: Literal["running", "start_up"]
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
    slow: dict[str, Floats] = field(default_factory=dict)
    ripple_std_rad: Floats = field(default_factory=lambda: np.zeros(0))
    blade_excess_m_s: Floats | None = None
