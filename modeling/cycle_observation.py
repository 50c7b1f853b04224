"""From measured strokes to the few numbers a fit compares, and the same numbers from the model.

A stroke becomes the Fourier coefficients of current and force over the crank angle, and its duration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.config import BatteryConfig, ConverterConfig
from sawbench.bench.errors import InputError
from sawbench.modeling.cycle_statistics import FEWEST_STROKES, fourier_basis
from sawbench.modeling.measured_cycles import TWO_PI, MeasuredCycles
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.modeling.periodic_cycle import COLUMNS, N_STEPS, CuttingHalf, periodic_cycles

Floats = NDArray[np.float64]
FitMethod = Literal["current_and_force", "current", "force"]

N_HARMONICS: Final = 8
FINE_PER_STEP: Final = 8
# What bin means, angle interpolation and the solver leave, relative to the channel: no data are better.
FLOOR_RELATIVE: Final = 5e-4
SENSOR_NAMES: Final = ("current_gain", "force_gain", "voltage_gain", "angle_zero_rad", "force_offset_n")


@dataclass(frozen=True, kw_only=True, slots=True)
class Drive:
    """Voltage and resistance that drive the motor in one trial, as far as they are known.

    Attributes
    ----------
    voltage_v : float
        Duty times open-circuit voltage of the battery, or the held voltage.
    source_resistance_ohm : float
        Battery resistance seen from the motor, duty^2 * R_b.
    extra_voltage_rel_std : float
        Beyond the gain of the voltage sensor.
    note : str
    """

    voltage_v: float
    source_resistance_ohm: float
    extra_voltage_rel_std: float = 0.0
    note: str = ""


def drive_of(cycles: MeasuredCycles, battery: BatteryConfig | None, converter: ConverterConfig | None) -> Drive:
    """Motor supply of a trial from its duty, its battery voltage and the converter.

    The battery voltage is taken as measured. Without it, the full battery of the configuration is assumed
    with 3 % uncertainty, and the note says so.

    Raises
    ------
    InputError
        Where neither the trial nor the configuration says what voltage the motor gets.
    """
    if converter is not None and converter.mode == "held_voltage" and converter.voltage_v is not None:
        return Drive(voltage_v=converter.voltage_v, source_resistance_ohm=0.0)
    if cycles.duty is None:
        raise InputError(
            "the duty of the trial is unknown, so the motor voltage is unknown too",
            where=cycles.label,
            remedy="state the duty of the trial, or set [converter] mode = 'held_voltage' with voltage_v",
        )
    duty = cycles.duty
    resistance_ohm = 0.0 if battery is None else battery.internal_resistance_ohm
    measured_v = np.array([]) if cycles.battery_voltage_v is None else cycles.battery_voltage_v
    if np.isfinite(measured_v).any():
        if cycles.battery_current_a is not None and np.isfinite(cycles.battery_current_a).any():
            battery_current_a = float(np.nanmean(cycles.battery_current_a))
        elif cycles.current_a is not None:
            battery_current_a = duty * float(np.nanmean(cycles.current_a))
        else:
            battery_current_a = 0.0
        open_v = float(np.nanmean(measured_v)) + resistance_ohm * battery_current_a
        return Drive(voltage_v=duty * open_v, source_resistance_ohm=duty**2 * resistance_ohm)
    if battery is None:
        raise InputError(
            "has no battery voltage, and no battery is configured",
            where=cycles.label,
            remedy="record battery_voltage_v or fill in [battery]",
        )
    return Drive(
        voltage_v=duty * battery.nominal_voltage_v,
        source_resistance_ohm=duty**2 * resistance_ohm,
        extra_voltage_rel_std=0.03,
        note="battery voltage not measured: a full battery is assumed, with 3 % uncertainty",
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialObservation:
    """Features of one trial.

    Attributes
    ----------
    data : ndarray, shape (m,)
        Means over the strokes.
    scatter : ndarray, shape (n_strokes, m)
        Each stroke's deviation from the mean; where bins are empty the rest stands for them.
    channel : ndarray of int, shape (m,)
        0 current, 1 force, 2 period.
    floor_variance : ndarray, shape (m,)
    n_bins : int
    drive : Drive
    """

    data: Floats
    scatter: Floats
    channel: NDArray[np.int64]
    floor_variance: Floats
    n_bins: int
    drive: Drive


def observe(cycles: MeasuredCycles, method: FitMethod, drive: Drive) -> TrialObservation:
    """Reduce measured strokes to features.

    Raises
    ------
    InputError
        If a channel that the method needs is missing, or the strokes are too few.
    """
    if cycles.n_cycles < FEWEST_STROKES:
        raise InputError(
            f"{cycles.n_cycles} complete strokes are not enough, {FEWEST_STROKES} are needed",
            where=cycles.label,
            remedy="record longer",
        )
    wanted = {"current": ("current_a",), "force": ("force_n",)}.get(method, ("current_a", "force_n"))
    basis = fourier_basis(cycles.angle_rad, min(N_HARMONICS, (cycles.n_bins - 1) // 2))
    data, scatter, channel, floor = [], [], [], []
    for name in wanted:
        values = getattr(cycles, name)
        if values is None:
            raise InputError(
                f"method {method!r} needs {name}, which this trial does not have",
                where=cycles.label,
                remedy="choose a method whose channels were recorded: current, force or current_and_force",
            )
        mean, deviations = _mean_and_scatter(values, name, cycles.label)
        data.append(basis @ mean)
        scatter.append(deviations @ basis.T)
        channel.append(np.full(len(basis), 1 if name == "force_n" else 0))
        floor.append(np.full(len(basis), FLOOR_RELATIVE**2 * float(np.mean(mean**2))))
    mean_period_s = float(cycles.period_s.mean())
    data.append(np.array([mean_period_s]))
    scatter.append((cycles.period_s - mean_period_s)[:, None])
    channel.append(np.array([2]))
    floor.append(np.array([(FLOOR_RELATIVE * mean_period_s) ** 2]))
    return TrialObservation(
        data=np.concatenate(data),
        scatter=np.hstack(scatter),
        channel=np.concatenate(channel),
        floor_variance=np.concatenate(floor),
        n_bins=cycles.n_bins,
        drive=drive,
    )


def _mean_and_scatter(values: Floats, name: str, label: str) -> tuple[Floats, Floats]:
    present = np.isfinite(values)
    filled = present.mean(axis=0)
    if filled.min() < 0.1:
        raise InputError(
            f"{name}: the bin at {int(np.argmin(filled))} of {values.shape[1]} has samples in only "
            f"{filled.min():.0%} of the strokes",
            where=label,
            remedy="record this channel at a higher rate or for longer; `sawbench process` says what of it is missing",
        )
    mean = np.where(present, values, 0.0).sum(axis=0) / present.sum(axis=0)
    return mean, np.where(present, values - mean, 0.0) / filled


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureModel:
    """The features of `TrialObservation` as the model has them.

    Attributes
    ----------
    gear_ratio : float
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
    rod_length_m : float or None
    crank_radius_m : float
        Nominal; shapes the lever of a slider-crank.
    """

    gear_ratio: float
    cutting_half: CuttingHalf
    rod_length_m: float | None
    crank_radius_m: float

    def predict(self, values: dict[str, Floats], observation: TrialObservation) -> tuple[Floats, NDArray[np.bool_]]:
        """Features for many parameter vectors.

        Parameters
        ----------
        values : dict of str to ndarray, shape (n_cases,)
            The plant's names, `k_fc_n_s_per_m` and `SENSOR_NAMES`.
        observation : TrialObservation
            Says which channels, bins and supply.

        Returns
        -------
        features : ndarray, shape (n_cases, m)
        is_valid : ndarray of bool, shape (n_cases,)
        """
        drive = observation.drive
        motor = {**values, "voltage_v": drive.voltage_v / values["voltage_gain"]}
        motor["resistance_ohm"] = values["resistance_ohm"] + drive.source_resistance_ohm
        current_a, speed_rad_s, is_valid = periodic_cycles(
            np.column_stack([motor[name] for name in COLUMNS]),
            gear_ratio=self.gear_ratio,
            cutting_half=self.cutting_half,
            rod_length_m=self.rod_length_m,
        )
        blocks = []
        n_current = int((observation.channel == 0).sum())
        if n_current:
            features = current_a @ _node_basis(n_current, observation.n_bins, N_STEPS).T
            blocks.append(values["current_gain"][:, None] * features)
        n_force = int((observation.channel == 1).sum())
        if n_force:
            kernel = _force_kernel(
                n_force, observation.n_bins, crank_radius_m=self.crank_radius_m, rod_length_m=self.rod_length_m,
                cutting_half=self.cutting_half,
            )  # fmt: skip
            scale = values["force_gain"] * values["k_fc_n_s_per_m"] * values["crank_radius_m"]
            features = scale[:, None] * (speed_rad_s @ kernel)
            features[:, 0] += values["force_offset_n"] * np.sqrt(observation.n_bins)
            blocks.append(features)
        rotated = [_rotate(block, values["angle_zero_rad"]) for block in blocks]
        positive = np.where(speed_rad_s > 0, speed_rad_s, 1.0)
        period_s = TWO_PI * np.mean(1.0 / positive, axis=1)
        return np.hstack([*rotated, period_s[:, None]]), is_valid


@lru_cache(maxsize=16)
def _force_kernel(
    n_features: int, n_bins: int, *, crank_radius_m: float, rod_length_m: float | None, cutting_half: CuttingHalf
) -> Floats:
    """Map crank speed at the nodes to force features per k_Fc * r_c, the kinks resolved."""
    n_fine = FINE_PER_STEP * N_STEPS
    angle = np.arange(n_fine) * TWO_PI / n_fine
    lever = Mechanism(radius_m=crank_radius_m, rod_length_m=rod_length_m).lever(angle) / crank_radius_m
    cuts = np.sin(angle) < 0 if cutting_half == "pi_to_2pi" else np.sin(angle) > 0
    spectrum = np.fft.rfft(np.eye(N_STEPS), axis=1)
    finer = np.fft.irfft(spectrum, n=n_fine, axis=1) * FINE_PER_STEP
    kernel = (finer * (np.abs(lever) * cuts)) @ _node_basis(n_features, n_bins, n_fine).T
    kernel.flags.writeable = False
    return kernel


def _node_basis(n_features: int, n_bins: int, n_nodes: int) -> Floats:
    """Coefficients that a mean over bins would have, from values at the model's nodes."""
    n_harmonics = (n_features - 1) // 2
    angle = np.arange(n_nodes) * TWO_PI / n_nodes
    basis = fourier_basis(angle, n_harmonics) * np.sqrt(n_bins / n_nodes)
    harmonic = np.repeat(np.arange(n_harmonics + 1), [1, *[2] * n_harmonics])
    return basis * np.sinc(harmonic / n_bins)[:, None]


def _rotate(features: Floats, angle_rad: Floats) -> Floats:
    """Features of the same curve seen by an angle sensor that reads `angle_rad` too much."""
    result = features.copy()
    n_harmonics = (features.shape[1] - 1) // 2
    phase = np.exp(1j * np.arange(1, n_harmonics + 1)[None, :] * angle_rad[:, None])
    turned = (features[:, 1::2] + 1j * features[:, 2::2]) * phase
    result[:, 1::2], result[:, 2::2] = turned.real, turned.imag
    return result
