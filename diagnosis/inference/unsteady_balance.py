"""Balances that do not hold throughout a trial.

However hard the wood is, the voltages of the motor and the battery and the currents of the converter balance in every
stroke: the equations take what was measured. A number of the machine that is off, and any effect of the catalogue,
leaves something that goes with the currents in that balance or changes slowly; a sensor leaves its noise, its steps,
and a zero that may wander by as much as it is stated to be uncertain. A duty is known to the steps of its modulator.
What varies beyond is the machine's: a contact that is loose, a duty that is not the one stated.

The torques balance in every stroke too, but all that the machine does to them goes with the current. In air there is no
load to vary: what is left there is a friction that does not stay what it is. That of brushes, grease and bearings never
does; what is more than a twentieth of the torque of the usual cut is no such friction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.spread import robust_std
from sawbench.diagnosis.inference.asynchronous import Finding, enough_trials
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part
from sawbench.diagnosis.inference.sensor_faults import SensorFaults
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.residuals import Equation
from sawbench.modeling.state import TWO_PI, State

# Mean, slope and bend of a trial: what warms up and discharges.
_TREND: Final = 3
_FEWEST_UNITS: Final = 8
# Of least absolute values by least squares with weights; residuals below a share of their median weigh alike.
_N_PASSES, _LEAST_SHARE = 10, 0.1
_NUMBERS: Final = SETTINGS.off_stroke


@dataclass(frozen=True, kw_only=True, slots=True)
class _Balance:
    """One equation, and when it is looked at.

    Attributes
    ----------
    equation : Equation
    name, why : str
        What does not balance, and what is said of it.
    is_by_current : bool
        All that the machine may do to it grows with a current: what varies in air is the reading.
    beside : callable
        (problem, state) -> what may leave a part of it, shape (n,) each. No more than that: the battery's current over
        that of the motor is the duty, and with both at hand a duty that wanders leaves nothing of the motor's voltages,
        nor anything at all of the converter's currents.
    is_in_air : bool
        It is compared in air alone, where the current answers to nothing but what is missing from it.
    """

    equation: Equation
    name: str
    why: str
    beside: Callable[[LinearProblem, State], list[Floats]]
    is_by_current: bool = False
    is_in_air: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class _Trial:
    """One balance of one trial, a row for each few strokes, without the trial's trend.

    Attributes
    ----------
    rest : ndarray, shape (n,)
        Residual, in the unit of its equation.
    beside : ndarray, shape (n, q)
        What may leave a part of it.
    allowed : float
        Variance that the sensors explain.
    is_idle : bool
    """

    rest: Floats
    beside: Floats
    allowed: float
    is_idle: bool


def unsteady_balances(problem: LinearProblem) -> list[Finding]:
    """Weigh what varies within trials against all that the sensors may do.

    Parameters
    ----------
    problem : LinearProblem

    Returns
    -------
    list of Finding
        One for each balance that varies by more in most of the trials.
    """
    plant = problem.campaign.plant
    balances = [balance for balance in _BALANCES if balance.equation in plant.equations]
    if not balances:
        return []
    faults = SensorFaults(problem.campaign)
    running = [(part, plant.residuals(part.state)) for part in problem.parts if _is_long_enough(part.state)]
    found = []
    for balance in balances:
        each = [
            _trial(problem, part, balance, wave[balance.equation], faults)
            for part, wave in running
            if balance.equation in wave and (part.setting.is_idle or not balance.is_in_air)
        ]
        found += list(_weighed(problem, balance, [trial for trial in each if trial.allowed > 0.0]))
    return found


def _is_long_enough(state: State) -> bool:
    """And with a battery voltage that is measured: that of the model is off, and the balance varies with that."""
    return state.kind == "running" and state.battery_voltage_v is not None and len(state.angle_rad) >= _FEWEST_UNITS


def _weighed(problem: LinearProblem, balance: _Balance, trials: Sequence[_Trial]) -> Iterator[Finding]:
    if not trials:
        return
    beside = np.concatenate([t.beside for t in trials])
    rest = _without(np.concatenate([t.rest for t in trials])[:, None], beside)[:, 0]
    parts = np.split(rest, np.cumsum([len(t.rest) for t in trials])[:-1])
    free = np.array([len(part) - _TREND - beside.shape[1] / len(trials) for part in parts])
    spread = np.array([robust_std(part) for part in parts])
    variance = spread**2 * np.array([len(part) for part in parts]) / np.maximum(free, 1.0)
    allowed, is_loaded = np.array([t.allowed for t in trials]), np.array([not t.is_idle for t in trials])
    if balance.is_by_current and not is_loaded.all():
        # In air hardly a current flows: what varies there is the reading, whose noise may be of lower frequencies too.
        allowed = np.maximum(allowed, np.median(variance[~is_loaded]))
    over = variance / allowed
    nats = 0.5 * free * np.where(over > 1.0, over - 1.0 - np.log(np.maximum(over, 1.0)), 0.0)
    shown = over > 1.0
    # In air hardly a current flows through a contact that is loose, and few campaigns hold more than one trial in air.
    fewest = 1 if balance.is_in_air else SETTINGS.noise.least_trials
    groups = (np.ones_like(shown), is_loaded)
    group = next((group for group in groups if shown[group].sum() >= enough_trials(group.sum(), fewest)), None)
    if group is None:
        return
    form = problem.campaign.plant.equations[balance.equation]
    usual = float(np.sqrt(np.median(variance[group & shown])))
    yield Finding(
        log_evidence=float(np.minimum(nats, _NUMBERS.most_per_trial)[group].sum()),
        channel=form.channel,
        equation=form.place,
        text=(
            f"{balance.name} varies within a trial by {usual:.2g} {form.unit}, in {(group & shown).sum()} of"
            f" {group.sum()} {'trial' if group.sum() == 1 else 'trials'}, {balance.why}; no effect of the catalogue"
            " does this"
        ),
    )


def _trial(problem: LinearProblem, part: Part, balance: _Balance, wave: Floats, faults: SensorFaults) -> _Trial:
    """One trial, by the residual of the equation, shape (n, n_points)."""
    state = part.state
    rounding = faults.variance(part.layout, state)[part.layout.slices[balance.equation].start]
    rows = np.column_stack([wave.mean(axis=1), *balance.beside(problem, state)])
    rows = _without(rows, np.vander(np.linspace(-1.0, 1.0, len(rows)), _TREND))
    return _Trial(
        rest=rows[:, 0], beside=rows[:, 1:], is_idle=state.setting.is_idle,
        allowed=_by_sensors(problem, state, balance.equation) + _by_duty(problem, state, balance.equation)
        + _by_friction(problem, balance) + float(rounding),
    )  # fmt: skip


def _by_duty(problem: LinearProblem, state: State, equation: Equation) -> float:
    """Variance of a few strokes' balance by a duty that is off by its standard uncertainty."""
    times_duty = {"electrical": state.battery_voltage_v, "converter": state.current_a}.get(equation)
    off_by = problem.settings.sensors.mean_voltage_share["electrical"]
    return 0.0 if times_duty is None else (off_by * float(times_duty.mean())) ** 2


def _by_friction(problem: LinearProblem, balance: _Balance) -> float:
    """Variance of the balance in air by a friction that is ordinary and not steady."""
    if not balance.is_in_air:
        return 0.0
    return (_NUMBERS.unsteady_friction * problem.campaign.plant.model.load.torque_n_m) ** 2


def _by_sensors(problem: LinearProblem, state: State, equation: Equation) -> float:
    """Variance of a few strokes' balance by zeros that wander by their standard uncertainty, and by white noise."""
    plant = problem.campaign.plant
    unit_s = float(np.mean(state.n_strokes)) * TWO_PI / float(state.speed_rad_s.mean())
    variance = 0.0
    for nuisance in plant.nuisances():
        wave = nuisance.signature(plant.model, state).get(equation) if nuisance.is_zero else None
        if wave is not None:
            variance += (nuisance.std * float(np.mean(wave))) ** 2
    for channel, reading in plant.readings().items():
        noise = [
            h.noise / np.sqrt(max(h.rate_hz * unit_s, 1.0)) for h in problem.campaign.health if h.channel == channel
        ]
        wave = reading.signature(plant.model, state).get(equation)
        if wave is not None:
            # Noise that has no mean has no sign either: a lever that turns round does not cancel it.
            variance += max(noise, default=0.0) ** 2 * float(np.mean(wave**2))
    return variance


def _other_torques(problem: LinearProblem, state: State) -> list[Floats]:
    """Means over a few strokes of acceleration and load as measured, shape (n,): what goes with them is their noise."""
    plant = problem.campaign.plant
    per_newton = plant.readings()["force_n"].signature(plant.model, state).get("mechanical", 0.0)
    force_n = np.zeros_like(state.speed_rad_s) if state.force_n is None else state.force_n
    return [state.acceleration_rad_s2.mean(axis=1), (per_newton * force_n).mean(axis=1)]


def _of_motor(problem: LinearProblem, state: State) -> list[Floats]:
    """Means over a few strokes of the motor's current, its square and its change.

    The change is that of the means from row to row, and from the first to the last place of a row: where the wood is
    harder every other stroke the two differ. Zeros where it was not measured.
    """
    motor_a = np.zeros_like(state.speed_rad_s) if state.current_a is None else state.current_a
    mean_a = motor_a.mean(axis=1)
    return [mean_a, (motor_a**2).mean(axis=1), np.gradient(mean_a), motor_a[:, -1] - motor_a[:, 0]]


def _of_battery(problem: LinearProblem, state: State) -> list[Floats]:
    """Means over a few strokes of the battery's current, their change, and what the battery remembers of it."""
    battery_a = np.zeros_like(state.speed_rad_s) if state.battery_current_a is None else state.battery_current_a
    mean_a = battery_a.mean(axis=1)
    remembered = [track[:, 0] for memory, track in state.slow.items() if memory.drive == "battery_current_a"]
    return [mean_a, np.gradient(mean_a), *remembered]


def _of_converter(problem: LinearProblem, state: State) -> list[Floats]:
    """What goes with the motor's current, and with the share of it that the battery gives by the duty.

    Not with the battery's own: less that share it is the balance.
    """
    of_motor = _of_motor(problem, state)
    return [*of_motor, *(state.setting.duty * found for found in of_motor)]


def _without(rows: Floats, design: Floats) -> Floats:
    """Take off rows, shape (n, q), what goes with a design, shape (n, p): least absolute values of the first column."""
    left, weight = rows, np.ones((len(rows), 1))
    for _ in range(_N_PASSES):
        left = rows - design @ np.linalg.lstsq(weight * design, weight * rows, rcond=None)[0]
        size = np.abs(left[:, :1])
        # Few strokes that were not measured well have no weight.
        weight = 1.0 / np.sqrt(np.maximum(size, _LEAST_SHARE * np.median(size) + 1e-300))
    return left


_CONTACT: Final = "more than currents and sensors explain: a loose contact or a duty that is not as stated"
_DRAWS: Final = "more than currents and sensors explain: another load of the battery, or a duty that is not as stated"
_DRAGS: Final = "more than friction that is never steady: something drags or seizes now and then, such as a bearing"
_BALANCES: Final = (
    _Balance(equation="electrical", name="the balance of voltages at the motor", why=_CONTACT, beside=_of_motor),
    _Balance(
        equation="supply",
        name="the balance of voltages at the battery",
        why=_CONTACT,
        beside=_of_battery,
        is_by_current=True,
    ),
    _Balance(equation="converter", name="the balance of currents at the converter", why=_DRAWS, beside=_of_converter),
    _Balance(
        equation="mechanical", name="the balance of torques in air", why=_DRAGS, beside=_other_torques, is_in_air=True
    ),
)
