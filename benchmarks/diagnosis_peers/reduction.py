"""From a campaign to what the peers work on: residual features of fixed length, and a dictionary of terms.

The campaign is read and reduced by `diagnosis` (crank angle, residuals of the equations, harmonics), so that the peers
differ from it in how they decide and not in what they see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sawbench.bench.config import LoadedConfig
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats, Recording
from sawbench.diagnosis.campaign import reduce_campaign
from sawbench.diagnosis.inference.features import START_UP_EDGES_S
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part, build_problem

TWO_PI = 2.0 * np.pi
# Second differences of white noise have six times its variance; 1.4826 turns a median deviation into a std.
_MAD_TO_STD = 1.4826
_SECOND_DIFFERENCE = np.sqrt(6.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Reduced:
    """A reduced campaign with the noise of its samples.

    Attributes
    ----------
    problem : LinearProblem
    noise : dict of str to float
        White noise of a sample by channel, in the channel's SI unit.
    rate_hz : float
        Mean sample rate.
    """

    problem: LinearProblem
    noise: dict[str, float]
    rate_hz: float


def read_campaign(case_dir: Path) -> tuple[list[Recording], LoadedConfig]:
    """Read every trial of a case.

    Raises
    ------
    InputError
        If a table is missing or wrong, or no configuration is named.
    """
    from sawbench.storage.importers.campaign import load_campaign
    from sawbench.storage.importers.dispatch import read_table

    campaign, config = load_campaign(case_dir / "campaign.toml")
    if config is None:
        raise InputError("names no configuration", where=case_dir / "campaign.toml", remedy="add config = ...")
    found = []
    for entry in campaign.trial:
        trial = entry.trial()
        content = read_table(case_dir / entry.file, is_idle=trial.is_idle)
        found.append(Recording(trial=trial, signals=content.signals))
    return found, config


def reduce(recordings: Sequence[Recording], config: LoadedConfig) -> Reduced:
    """Reduce a campaign and measure the noise of its samples.

    Parameters
    ----------
    recordings : sequence of Recording
    config : LoadedConfig

    Returns
    -------
    Reduced
    """
    problem = build_problem(reduce_campaign(recordings, config))
    found: dict[str, list[float]] = {}
    rates: list[float] = []
    for recording in recordings:
        for name, signal in recording.signals.items():
            found.setdefault(name, []).append(white_noise(signal.values))
            rates.append(signal.rate_hz)
    return Reduced(
        problem=problem,
        noise={name: float(np.median(values)) for name, values in found.items()},
        rate_hz=float(np.mean(rates)),
    )


def white_noise(values: Floats) -> float:
    """Standard deviation of the white noise on a smooth signal, from its second differences.

    Examples
    --------
    >>> wave = np.sin(np.arange(20000) / 300.0) + 0.1 * np.random.default_rng(1).standard_normal(20000)
    >>> abs(white_noise(wave) - 0.1) < 0.005
    True
    """
    second = np.diff(values, 2)
    return float(_MAD_TO_STD * np.median(np.abs(second)) / _SECOND_DIFFERENCE)


def equation_noise(reduced: Reduced) -> dict[str, float]:
    """Noise of one sample of each equation's residual, as sensor noise alone would make it."""
    plant, battery = reduced.problem.campaign.baseline.plant, reduced.problem.campaign.baseline.battery
    noise = reduced.noise
    current = noise.get("motor_current_a", 0.0)
    force = noise.get("force_n", 0.0)
    drawn, voltage = noise.get("battery_current_a", 0.0), noise.get("battery_voltage_v", 0.0)
    lever = plant.crank_radius_m.nominal / plant.gear_ratio / np.sqrt(2.0)
    inner = battery.internal_resistance_ohm if battery else 0.0
    duty = float(np.mean([part.setting.duty for part in reduced.problem.parts]))
    return {
        "electrical": float(np.hypot(plant.resistance_ohm.nominal * current, duty * voltage)),
        "mechanical": float(np.hypot(plant.torque_constant_n_m_per_a.nominal * current, lever * force)),
        "cutting": force,
        "supply": float(np.hypot(voltage, inner * drawn)),
        "converter": float(np.hypot(drawn, duty * current)),
    }


def naive_std(reduced: Reduced, part: Part) -> Floats:
    """Standard deviation of a part's features from sensor noise and raw sample counts, shape (n_blocks, size)."""
    per_sample = equation_noise(reduced)
    n_blocks = part.blocks.shape[0]
    std = np.empty((n_blocks, part.layout.size))
    for equation, place in part.layout.slices.items():
        if part.state.kind == "running":
            period_s = TWO_PI / float(np.mean(part.state.speed_rad_s))
            strokes = (part.blocks > 0) @ part.state.n_strokes
            n = np.maximum(strokes * period_s * reduced.rate_hz, 1.0)[:, None]
            factor = np.full(place.stop - place.start, np.sqrt(2.0))
            factor[0] = 1.0
            std[:, place] = per_sample[equation] * factor / np.sqrt(n)
        else:
            n = np.maximum(np.diff(START_UP_EDGES_S) * reduced.rate_hz, 1.0)
            std[:, place] = per_sample[equation] / np.sqrt(n)
    return std


def physical(part: Part, columns: Floats) -> Floats:
    """Features in the units of their equations, shape (n_blocks, size, q), from stacked whitened ones (n, q)."""
    inside = columns[part.place].reshape(part.blocks.shape[0], part.layout.size, -1)
    return np.matmul(np.linalg.inv(part.whitener), inside)


def retuned(problem: LinearProblem) -> tuple[Floats, Floats]:
    """Most probable nuisances in units of their prior, shape (p,), and the whitened residual they leave, (n,)."""
    design = problem.nuisance
    inner = np.eye(design.shape[1]) + design.T @ design
    x: Floats = np.asarray(np.linalg.solve(inner, design.T @ problem.data), dtype=np.float64)
    return x, problem.data - design @ x
