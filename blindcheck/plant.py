"""A jigsaw to measure: the plant of the simulated bench and of the blind check.

It shares neither code nor constants with the models that judge its recordings. Equations:
`blindcheck.dynamics`; integrator: `blindcheck.integrator`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.errors import InputError, UntrustedResult
from sawbench.blindcheck.dynamics import (
    CHARGE,
    CRANK,
    N_OUTPUTS,
    N_STATES,
    OUTPUT_NAMES,
    RECORD,
)
from sawbench.blindcheck.integrator import integrate
from sawbench.blindcheck.settings import MATERIALS, Material, PlantSettings

__all__ = [
    "MATERIALS",
    "Material",
    "Plant",
    "PlantSettings",
    "brute_force_runtime",
    "column",
    "parameter_record",
]

Floats = NDArray[np.float64]
GRID_S = 5e-5
# At 1e-6 a step covers several teeth of a motor's cogging, whose wave in the speed is smaller than that, and the few
# points within the step sum up to a mean torque that cogging does not have.
RELATIVE_TOLERANCE = 1e-8
# Of the states, at a relative tolerance of 1e-6.
ABSOLUTE_TOLERANCE = np.array(
    [
        1e-5,
        1e-4,
        1e-6,
        1e-6,
        1e-6,
        1e-6,
        1e-6,
        1e-6,
        1e-9,
        1e-9,
        1e-5,
        1e-9,
        1e-6,
        1e-6,
        1e-6,
        1e-5,
        1e-6,
        1e-9,
        1e-5,
    ]
)
ABSOLUTE_TOLERANCE.flags.writeable = False

_RECORD_DEFAULTS: Mapping[str, float] = MappingProxyType(
    {
        "c_winding": 19.0, "c_housing": 90.0, "r_wind_house": 1.6, "r_house_air": 3.5, "width_ratio": 1.0,
        "windage_power": 1.85, "guide_presliding_m": 1.2e-4, "guide_stribeck": 0.4, "contact_n_m": 8e5,
        "contact_loss_s_m": 0.6, "tooth_pitch_m": 2.9e-3, "tooth_sharpness": 0.75, "chip_ref_mm": 0.27,
        "chip_edge_mm": 0.08, "knee_ref_m_s": 0.7, "blade_n_s_m": 25.0, "polar_fast_s": 2.0,
        "polar_slow_s": 22.0, "wear_power": 0.5,
    }
)  # fmt: skip


def parameter_record(settings: PlantSettings) -> np.ndarray:
    """Return the record array, shape (1,), that the equations of motion read."""
    record = np.zeros(1, dtype=RECORD)
    values = dict(_RECORD_DEFAULTS) | {
        "resistance": settings.resistance_ohm,
        "inductance": settings.inductance_h,
        "k_e": settings.back_emf_constant_v_s_per_rad,
        "k_m": settings.torque_constant_n_m_per_a,
        "rotor_inertia": settings.rotor_inertia_kg_m2,
        "yoke_inertia": settings.yoke_inertia_kg_m2,
        "mass": settings.reciprocating_mass_kg,
        "radius": settings.crank_radius_m,
        "rod": settings.rod_length_m or 0.0,
        "damping": settings.motor_damping_n_m_s_per_rad,
        "gear": settings.gear_ratio,
        "v_nominal": settings.nominal_voltage_v,
        "capacity_as": settings.capacity_ah * 3600.0,
        "beta": settings.beta,
        "r_battery": settings.internal_resistance_ohm,
        "duty": settings.duty,
        "held_v": settings.held_voltage_v or 0.0,
        "is_on": 1.0,
        "k_fc": settings.k_fc_n_s_per_m,
        "cut_direction": -1.0 if settings.cutting_half == "pi_to_2pi" else 1.0,
        "cuts": 1.0 if settings.k_fc_n_s_per_m > 0 else 0.0,
        "feed_mm_s": settings.feed_mm_s,
    }
    if settings.open_circuit_v is not None:
        values["open_circuit_v"] = settings.open_circuit_v
    for name, value in (values | dict(settings.extras)).items():
        record[name] = value
    return record


def stroke_factors(settings: PlantSettings, n: int = 16384) -> Floats:
    """Return the factor on the damper for each stroke, shape (n,): stationary AR(1) processes about a mean of 1.

    One forgets from stroke to stroke. The other one is the wood's along the cut, at the stroke rate without a load.
    """
    from_stroke_to_stroke = _remembering(np.random.default_rng([settings.seed, 1]), settings.stroke_correlation, n)
    factor = 1.0 + settings.stroke_rel_std * from_stroke_to_stroke
    if settings.uneven_rel_std > 0.0 and settings.feed_mm_s > 0.0:
        motor_rad_s = settings.duty * settings.nominal_voltage_v / settings.back_emf_constant_v_s_per_rad
        stroke_mm = settings.feed_mm_s * 2.0 * np.pi * settings.gear_ratio / motor_rad_s
        memory = float(np.exp(-stroke_mm / settings.uneven_mm))
        factor += settings.uneven_rel_std * _remembering(np.random.default_rng([settings.seed, 4]), memory, n)
    return np.clip(factor, 0.2, 2.0)


def _remembering(rng: np.random.Generator, rho: float, n: int) -> Floats:
    """Stationary AR(1) process of unit variance, shape (n,)."""
    n_memory = min(int(np.log(1e-12) / np.log(max(rho, 1e-6))) + 1, 2000)
    shocks = np.sqrt(1.0 - rho * rho) * rng.standard_normal(n + n_memory - 1)
    return np.convolve(shocks, rho ** np.arange(n_memory), mode="valid")


def texture(seed: int, *, wavelength_mm: float = 4.2, n: int = 8192, step_mm: float = 0.05) -> Floats:
    """Return a coloured, unit-variance wood texture along the feed path, shape (n,), periodic.

    White noise through a band of one octave around the ring distance plus a 1/f part.
    """
    rng = np.random.default_rng([seed, 2])
    spectrum = np.fft.rfft(rng.standard_normal(n))
    wave_number = np.fft.rfftfreq(n, step_mm)
    ring = np.exp(-0.5 * (np.log2(np.maximum(wave_number, 1e-6) * wavelength_mm) / 0.35) ** 2)
    slow = 0.35 / (1.0 + (wave_number * 25.0) ** 2) ** 0.5
    shape = ring + slow
    shape[0] = 0.0
    values = np.fft.irfft(spectrum * shape, n)
    return values / values.std()


def wander_noise(seed: int, n: int = 16384) -> Floats:
    """Return unit-variance noise in time with a memory of a few cells, shape (n,), periodic."""
    rng = np.random.default_rng([seed, 3])
    values = np.convolve(rng.standard_normal(n), np.hanning(9)[1:-1], mode="same")
    return (values - values.mean()) / values.std()


class Plant:
    """The plant at one moment, advanced in time from the instant it is switched on.

    Parameters
    ----------
    settings : PlantSettings
    state : ndarray, shape (N_STATES,), optional
        State to start from (heat, wear and charge carried over); crank angle and charge of `settings` are
        used when it is not given.
    rtol : float
        Relative tolerance of the integrator.

    Examples
    --------
    >>> plant = Plant(PlantSettings(stroke_rel_std=0.0))
    >>> rows = plant.advance(0.05)
    >>> rows.shape
    (1001, 7)
    """

    def __init__(
        self, settings: PlantSettings, *, state: Floats | None = None, rtol: float = RELATIVE_TOLERANCE
    ) -> None:
        self.settings = settings
        self.time_s = 0.0
        self.record = parameter_record(settings)
        self.state = np.zeros(N_STATES) if state is None else np.array(state, dtype=np.float64)
        if state is None:
            self.state[CRANK] = settings.initial_crank_rad
            self.state[CHARGE] = (1.0 - settings.initial_soc) * settings.capacity_ah * 3600.0
        self._tables = (stroke_factors(settings), texture(settings.seed), wander_noise(settings.seed))
        self._rtol = rtol
        self._step_s = 1e-5

    def advance(self, duration_s: float, *, grid_s: float = GRID_S, stop_charge_as: float = np.inf) -> Floats:
        """Advance by `duration_s` and return the outputs on a grid, first row now.

        Parameters
        ----------
        duration_s : float, s
        grid_s : float, s
        stop_charge_as : float, A s
            Stop early where this much charge has been drawn from the full battery.

        Returns
        -------
        ndarray, shape (n, 7)
            Columns `dynamics.OUTPUT_NAMES`; rows that were not reached are dropped.

        Raises
        ------
        UntrustedResult
            If the integrator cannot go on at the required accuracy.
        """
        n_rows = int(np.floor(duration_s / grid_s + 1e-6)) + 1
        rows = np.empty((n_rows, N_OUTPUTS))
        start_s = self.time_s
        end_s, step_s, _ = integrate(
            self.state, start_s, start_s + duration_s, self._step_s, start_s, grid_s, rows, self.record,
            *self._tables, self._rtol, ABSOLUTE_TOLERANCE * (self._rtol / 1e-6), stop_charge_as,
        )  # fmt: skip
        if step_s < 0:
            raise UntrustedResult(
                f"the plant's integrator stopped at t = {end_s:.6f} s",
                remedy="the settings are beyond what the plant can simulate; go back towards the defaults",
            )
        self.time_s, self._step_s = end_s, step_s
        return rows[: int(np.floor((end_s - start_s) / grid_s + 1e-6)) + 1]

    def in_wood(self, *, is_in: bool) -> None:
        """Push the blade into the workpiece, or take it out."""
        self.record["cuts"] = float(is_in and self.settings.k_fc_n_s_per_m > 0)

    def switch_off(self) -> None:
        """Open the converter: the current dies out and the tool coasts to rest."""
        self.record["is_on"] = 0.0


def column(rows: Floats, name: str) -> Floats:
    """Return one output of `Plant.advance` by its name in `dynamics.OUTPUT_NAMES`."""
    return rows[:, OUTPUT_NAMES.index(name)]


def brute_force_runtime(settings: PlantSettings, cutoff_soc: float = 0.2) -> float:
    """Return the time from switching on until the state of charge falls to `cutoff_soc`, s.

    Every stroke of the whole discharge is integrated.

    Raises
    ------
    InputError
        If the battery starts below the cut-off.
    UntrustedResult
        If the battery does not reach the cut-off within ten hours.
    """
    if not 0.0 < cutoff_soc < settings.initial_soc:
        raise InputError(f"cutoff_soc is {cutoff_soc!r}, allowed is between 0 and initial_soc {settings.initial_soc!r}")
    plant = Plant(settings)
    goal_as = (1.0 - cutoff_soc) * settings.capacity_ah * 3600.0
    while plant.time_s < 36_000.0:
        before_s = plant.time_s
        plant.advance(60.0, grid_s=60.0, stop_charge_as=goal_as)
        if plant.time_s < before_s + 60.0 - 1e-9:
            return plant.time_s
    raise UntrustedResult(f"the battery is still above {cutoff_soc} after ten hours")
