"""What each fitted number of the diagnosis is held to, apart from any report: a principle that half and twice break.

    python -m tests.rigs.principles

prints for every fitted number the principle, the quantity that it bounds, and that quantity with the number as it is,
with half of it and with twice of it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from sawbench.bench.config import PlantConfig
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.form_error import form_modes
from sawbench.diagnosis.inference.linear_problem import LinearProblem, build_problem
from sawbench.diagnosis.inference.settings import SETTINGS, Settings
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.diagnosis.screening import doubted_duties
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import TWO_PI, State, TrialSetting

from tests.rigs.remembering import remembering


@dataclass(frozen=True, kw_only=True, slots=True)
class Principle:
    """What a fitted number must keep.

    Attributes
    ----------
    number : str
        "topic.number" of `Settings`.
    says : str
    value : callable
        Settings -> the quantity that it bounds.
    low, high : float
    """

    number: str
    says: str
    value: Callable[[Settings], float]
    low: float
    high: float

    def holds(self, settings: Settings) -> bool:
        """Whether the quantity lies within its bounds."""
        return self.low <= self.value(settings) <= self.high


# --- the noise, and what forms miss, on strokes of constant speed -----------------------------------------------------

_N_POINTS, _N_UNITS, _STROKES_A_UNIT, _RATE_HZ = 128, 24, 16, 13.0
_K_N_S_PER_M = 240.0


def _baseline() -> Baseline:
    plant = PlantConfig.model_validate(
        {
            "resistance_ohm": 0.176, "inductance_h": 0.00321, "back_emf_constant_v_s_per_rad": 0.007383,
            "torque_constant_n_m_per_a": 0.005632, "rotor_inertia_kg_m2": 2.4e-05, "yoke_inertia_kg_m2": 2.38e-05,
            "reciprocating_mass_kg": 0.239, "crank_radius_m": 0.01, "motor_damping_n_m_s_per_rad": 3.4274e-06,
            "gear_ratio": 9.333333333333334,
        }
    )  # fmt: skip
    return Baseline(plant=plant, battery=None, cutting_sign=-1)


def _remembering_wood(n: int, memory: float, rng: np.random.Generator) -> np.ndarray:
    """Hardness of strokes about 1, each remembering the one before."""
    return 1.0 + 0.2 * remembering(rng, memory, n)


def _trial(index: int, hardness: np.ndarray, noise_n: float, rng: np.random.Generator) -> State:
    """One trial at constant speed whose force alone was measured, averaged over units."""
    shape = (_N_UNITS, _N_POINTS)
    angle = np.broadcast_to((np.arange(_N_POINTS) + 0.5) * TWO_PI / _N_POINTS, shape)
    speed = np.full(shape, TWO_PI * _RATE_HZ)
    into_wood = np.maximum(-0.01 * speed * np.sin(angle), 0.0)
    units = hardness.reshape(_N_UNITS, _STROKES_A_UNIT).mean(axis=1, keepdims=True)
    force = _K_N_S_PER_M * units * into_wood + noise_n * rng.standard_normal(shape) / np.sqrt(_STROKES_A_UNIT)
    at_s = (np.arange(_N_UNITS)[:, None] + 0.5) * _STROKES_A_UNIT / _RATE_HZ
    setting = TrialSetting(
        label=f"t{index}", index=index, duty=0.44, is_idle=False, stock="oak", feed_m_s=0.004, thickness_m=0.02,
        operating_point="duty 0.44", session_s=120.0 * index,
    )  # fmt: skip
    zeros = np.zeros((_N_UNITS, 1))
    return State(
        kind="running", setting=setting, angle_rad=angle, speed_rad_s=speed, acceleration_rad_s2=np.zeros(shape),
        current_a=None, current_rate_a_s=None, force_n=force, force_rate_n_s=None, battery_voltage_v=None,
        battery_current_a=None, motor_voltage_v=np.zeros(shape), time_s=at_s, cut_distance_m=zeros,
        charge_used_as=zeros, k_guess_n_s_per_m=_K_N_S_PER_M, peak_force_n=200.0,
        n_strokes=np.full(_N_UNITS, float(_STROKES_A_UNIT)),
    )  # fmt: skip


def _problem(settings: Settings, *, memory: float, noise_n: float, seed: int) -> LinearProblem:
    rng = np.random.default_rng(seed)
    n_strokes = _N_UNITS * _STROKES_A_UNIT
    states = tuple(_trial(k, _remembering_wood(n_strokes, memory, rng), noise_n, rng) for k in range(12))
    campaign = Campaign(plant=Jigsaw(baseline=_baseline()), states=states, k_guess_n_s_per_m={}, warnings=())
    return build_problem(campaign, settings=settings)


def _block_variance(settings: Settings) -> float:
    """Variance of a block's mean force over the stated one, for wood that remembers eight strokes in ten."""
    found = []
    for seed in range(6):
        problem = _problem(settings, memory=0.8, noise_n=0.5, seed=seed)
        for part in problem.parts:
            whitened = problem.data[part.place].reshape(-1, part.layout.size)
            # Hardness is one direction: that of the mean stroke, whitened.
            force_n = part.state.force_n.mean(axis=0)[None]
            direction = part.whitener @ part.layout.place({"cutting": force_n}, part.times[:1])[0]
            found.append(whitened @ direction / np.linalg.norm(direction))
    return float(np.var(np.array(found)))


def _form_problem(settings: Settings) -> tuple[LinearProblem, np.ndarray, np.ndarray]:
    """A problem, a force at the seventh harmonic, and the same turned by a right angle."""
    problem = _problem(settings, memory=0.0, noise_n=0.5, seed=1)
    plain, turned = (
        problem.project(lambda s, wave=wave: {"cutting": wave(7.0 * s.angle_rad)}) for wave in (np.cos, np.sin)
    )
    return problem, plain, turned


def _along(modes: np.ndarray, direction: np.ndarray) -> np.ndarray:
    return modes.T @ direction / float(direction @ direction)


def _turned_rad(settings: Settings) -> float:
    """How far the form of an effect may turn a harmonic at most, over what a corner of twice the frequency turns."""
    problem, plain, turned = _form_problem(settings)
    largest = settings.forms.shares[-1] * np.linalg.norm(_along(form_modes(problem, plain), turned))
    return float(largest / (np.arctan(np.sqrt(2.0)) - np.arctan(np.sqrt(0.5))))


def _even(odds: Callable[[float], float], low: float, high: float) -> float:
    """Where rising log odds pass zero, by bisection."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if odds(middle) > 0.0 else (middle, high)
    return middle


def _found_slip(settings: Settings) -> float:
    """Smallest slip of one duty of 24 that is found where all other trials are exact."""
    stated = np.tile([0.375, 0.4375, 0.5, 0.5625], 6)
    asked, current = 0.9 * stated, np.linspace(4.0, 9.0, len(stated))
    least = SETTINGS.screening.duty_deviation

    def is_found(slip: float) -> float:
        wrong = stated.copy()
        wrong[10] += slip
        # The peak of the start-up goes with the true duty.
        numbers = settings.screening
        return 1.0 if np.isfinite(doubted_duties(wrong, asked, current, 100.0 * stated, numbers)[10]) else -1.0

    return _even(is_found, 0.1 * least, 10.0 * least)


PRINCIPLES = (
    Principle(
        number="noise.correlation_factor", says="blocks of a wood that remembers scatter as stated",
        value=_block_variance, low=0.75, high=1.5,
    ),
    Principle(
        number="forms.harmonic_factor",
        says="another filter turns a harmonic as far as a corner of twice the frequency", value=_turned_rad,
        low=2.0 / 3.0, high=1.5,
    ),
    Principle(
        number="screening.duty_deviation",
        says="a duty that is stated one sixteenth off is found, and nothing is looked for below a thirtieth",
        value=_found_slip, low=1.0 / 30.0, high=1.0 / 16.0,
    ),
)  # fmt: skip


def table() -> str:
    """For every principle its quantity with the number as it is, half and twice."""
    lines = [f"{'number':34} {'bounds':>18}  {'as it is':>9} {'half':>9} {'twice':>9}  principle"]
    for p in PRINCIPLES:
        values = [p.value(SETTINGS), *(p.value(SETTINGS.moved(p.number, factor)) for factor in (0.5, 2.0))]
        bounds = f"{p.low:.3g} to {p.high:.3g}"
        lines.append(f"{p.number:34} {bounds:>18}  {' '.join(f'{v:9.4g}' for v in values)}  {p.says}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(table() + "\n")
