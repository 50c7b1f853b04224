"""The channels as the coupled model predicts them: the periodic stroke that satisfies all equations at once.

The residuals of `modeling.residuals` and the signatures of parameters and effects *are* the physics: a model with
strengths theta holds where

    residual(baseline, state) = sum_k theta_k signature_k(state)                     in all five equations.

On measured signals this says what is left over; here it is solved for the signals. Speed and current are Fourier
series over the crank angle (collocation at the bins, Galerkin projection on as many harmonics as are unknown), found
by Newton's method; force, battery current and battery voltage each stand alone in an equation of their own and are
put in from there. The signatures are evaluated again on what is predicted, so every consequence of an effect reaches
every channel. No model predicts the cutting coefficient of a workpiece: one number a trial is fitted to its own force.

Sensor faults are signatures too, so what is predicted are the readings. Slow states (charge, heat, wear) are those of
the trial. Not for a start-up, nor for a trial whose motion is not periodic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.residuals import EQUATIONS, Baseline, Signature, residuals
from sawbench.modeling.state import TWO_PI, State, angle_derivative

N_HARMONICS = 16
_N = 2 * N_HARMONICS + 1
# Of the largest answer of the force to itself: less is rounding.
_LEAST_ANSWER = 1e-10
_MAX_STEPS = 25
_MAX_JACOBIANS = 5
_DIFFERENCE = 1e-5
_TOLERANCE = 1e-6
# A kept Jacobian that gains less than this a step is replaced.
_GOOD_GAIN = 0.6
# Force, battery current and voltage enter their own signatures only weakly: this many substitutions settle them.
_SUBSTITUTIONS = 2
_SLOWEST_SHARE = 0.05
# What a state's copies for other forces share, row by row.
_MOVING: Final = ("angle_rad", "speed_rad_s", "acceleration_rad_s2", "current_a", "current_rate_a_s")


@dataclass(frozen=True, kw_only=True, slots=True)
class Term:
    """One thing that is not as the baseline says.

    Attributes
    ----------
    amplitude : float
    signature : callable
        State -> change of the residuals for one unit of the amplitude.
    """

    amplitude: float
    signature: Callable[[State], Signature]


@dataclass(frozen=True, kw_only=True, slots=True)
class Prediction:
    """One settled stroke of the coupled model.

    Attributes
    ----------
    state : State
        All channels, shape (1, n_points), on the grid of the measured state.
    wood_n_s_per_m : float
        Cutting coefficient of the piece of wood.
    is_settled : bool
        False where no periodic stroke was found (the model stalls, or Newton's method failed); the state is then
        the last iterate and says nothing.
    """

    state: State
    wood_n_s_per_m: float
    is_settled: bool


def mean_stroke(state: State) -> State:
    """Average the running strokes of a trial to one, shape (1, n_points).

    The average of a speed is the one that takes the average time. `n_strokes` counts all strokes, so that a slow
    modulation averages out as it does in the measurement.
    """

    def mean(wave: Floats | None) -> Floats | None:
        return None if wave is None else wave.mean(axis=0, keepdims=True)

    speed = 1.0 / np.mean(1.0 / state.speed_rad_s, axis=0, keepdims=True)
    return replace(
        state,
        angle_rad=state.angle_rad[:1],
        speed_rad_s=speed,
        acceleration_rad_s2=speed * angle_derivative(speed),
        motor_voltage_v=state.motor_voltage_v.mean(axis=0, keepdims=True),
        n_strokes=np.array([float(state.n_strokes.sum())]),
        # A prediction knows the crank alone.
        blade_excess_m_s=None,
        slow={name: values.mean(axis=0, keepdims=True) for name, values in state.slow.items()},
        **{
            name: mean(getattr(state, name))
            for name in ("current_a", "current_rate_a_s", "force_n", "force_rate_n_s", "battery_voltage_v",
                         "battery_current_a", "time_s", "cut_distance_m", "charge_used_as")
        },
    )  # fmt: skip


def predict(
    baseline: Baseline,
    measured: State,
    terms: Sequence[Term],
    *,
    wood_n_s_per_m: float | None = None,
    start: Prediction | None = None,
) -> Prediction:
    """Solve for the stroke that a model predicts at the operating point of a trial.

    Parameters
    ----------
    baseline : Baseline
    measured : State
        Of `mean_stroke`: setting and slow states are taken from it, the cutting coefficient is fitted to its force
        (to its mean motor current where there is no force), the rest is only where the search starts.
    terms : sequence of Term
        What is not as the baseline says, its known effects apart; empty for the nominal model.
    wood_n_s_per_m : float, optional
        Cutting coefficient, where it shall not be fitted.
    start : Prediction, optional
        A solution nearby.
    """
    known = Term(amplitude=1.0, signature=baseline.known_signature)
    problem = _Stroke(replace(baseline, known=()), measured, [known, *terms], wood_n_s_per_m)
    z = problem.first_guess(measured if start is None else start.state)
    if start is not None and problem.fits_wood:
        z[-1] = start.wood_n_s_per_m - problem.wood_guess
    z, state, is_settled = _newton(problem, z)
    speed = state.speed_rad_s
    is_settled = is_settled and float(speed.min()) > _SLOWEST_SHARE * float(speed.mean())
    return Prediction(state=state, wood_n_s_per_m=problem.wood(z), is_settled=is_settled)


class _Stroke:
    """The algebraic problem: coefficients of speed and current (and the wood) -> what does not cancel."""

    def __init__(self, baseline: Baseline, measured: State, terms: Sequence[Term], wood: float | None) -> None:
        self.baseline, self.measured, self.terms = baseline, measured, terms
        self.waves, self.projection = _basis(measured.angle_rad.shape[1])
        self.wood_guess = measured.k_guess_n_s_per_m if wood is None else wood
        has_target = measured.force_n is not None or measured.current_a is not None
        self.fits_wood = wood is None and not measured.setting.is_idle and has_target
        self.current_scale_a = self._typical_current_a()
        self._answer: Floats | None = None
        plant = baseline.plant
        volt = max(float(measured.motor_voltage_v.mean()), 0.1)
        torque = plant.torque_constant_n_m_per_a.nominal * self.current_scale_a
        self.row_scale = np.repeat([torque, volt], _N)
        self.column_scale = np.repeat([float(measured.speed_rad_s.mean()), self.current_scale_a], _N)
        if self.fits_wood:
            self.row_scale = np.append(self.row_scale, self.current_scale_a if measured.force_n is None else 10.0)
            self.column_scale = np.append(self.column_scale, max(self.wood_guess, 50.0))

    def _typical_current_a(self) -> float:
        measured, plant = self.measured, self.baseline.plant
        if measured.current_a is not None:
            return max(float(np.abs(measured.current_a).mean()), 0.2)
        back_emf = plant.back_emf_constant_v_s_per_rad.nominal * self.baseline.gear * measured.speed_rad_s
        return max(float(np.mean(measured.motor_voltage_v - back_emf)) / plant.resistance_ohm.nominal, 0.2)

    def first_guess(self, near: State) -> Floats:
        current = near.current_a
        if current is None:
            current = np.full_like(near.speed_rad_s, self.current_scale_a)
        parts = [near.speed_rad_s[0] @ self.projection, current[0] @ self.projection]
        return np.concatenate([*parts, [0.0]] if self.fits_wood else parts)

    def wood(self, z: Floats) -> float:
        """Cutting coefficient, N s/m."""
        return float(self.wood_guess + (z[-1] if self.fits_wood else 0.0))

    def close(self, z: Floats, frozen: Signature | None = None) -> tuple[State, Floats]:
        """Put force, battery current and voltage in; return state and what does not cancel, by row.

        With `frozen`, the terms are not evaluated: they are that signature, of shape (1, n_points).
        """
        measured, baseline = self.measured, self.baseline
        speed, current = z[:, :_N] @ self.waves, z[:, _N : 2 * _N] @ self.waves
        wood = self.wood_guess + (z[:, -1:] if self.fits_wood else np.zeros((len(z), 1)))
        duty = measured.setting.duty
        voltage = measured.motor_voltage_v / duty if baseline.battery is None else None
        state = replace(
            measured,
            angle_rad=np.broadcast_to(measured.angle_rad, speed.shape),
            speed_rad_s=speed,
            acceleration_rad_s2=speed * angle_derivative(speed),
            current_a=current,
            current_rate_a_s=speed * angle_derivative(current),
            battery_current_a=duty * current,
        )
        if voltage is None:
            assert baseline.battery is not None
            drop = baseline.battery.internal_resistance_ohm * duty * current
            voltage = baseline.open_circuit_voltage(measured.charge_used_as) - drop
        cutting = wood * baseline.cutting_speed(state)
        state = self._with(state, cutting, np.broadcast_to(voltage, speed.shape), duty * current)
        rest: Signature = {}
        for _ in range(_SUBSTITUTIONS):
            rest = self._rest(state, cutting, frozen)
            assert state.force_n is not None and state.battery_voltage_v is not None
            assert state.battery_current_a is not None
            voltage = state.battery_voltage_v - rest.get("supply", np.zeros(1))
            error_n = rest["cutting"] if self._answer is None or frozen is not None else rest["cutting"] @ self._answer
            state = self._with(state, state.force_n - error_n, voltage, state.battery_current_a - rest["converter"])
        rest = self._rest(state, cutting, frozen)
        rows = [rest["mechanical"] @ self.projection, rest["electrical"] @ self.projection]
        if self.fits_wood:
            rows.append(self._wood_misfit(state))
        return state, np.concatenate(rows, axis=1)

    def linearise(self, z: Floats) -> State:
        """Find, near a solution, how the force answers to what does not cancel in the cutting equation.

        It answers one to one where no term holds the force. A lag or a resonance that is undone on the reading holds
        its derivatives: there plain substitution would raise the high harmonics with every step. Return the state of
        the baseline.
        """
        state = self.close(z[None, :], {})[0]
        force = state.force_n
        assert force is not None
        rows = np.eye(force.shape[1])

        def left(force_n: Floats) -> Floats:
            tried = replace(
                state,
                **{name: np.broadcast_to(getattr(state, name), force_n.shape) for name in _MOVING},
                force_n=force_n, force_rate_n_s=state.speed_rad_s * angle_derivative(force_n),
            )  # fmt: skip
            return self._rest(tried, np.zeros(1), None)["cutting"]

        before = left(force)
        if not np.allclose(left(force + rows[:1]) - before, rows[:1], rtol=0.0, atol=1e-6):
            answer = left(force + rows) - before
            # A term that holds all of some harmonic, as one fitted far off may, leaves no force that answers there.
            self._answer = np.asarray(np.linalg.pinv(answer, rcond=_LEAST_ANSWER), dtype=np.float64)
        return state

    def _with(self, state: State, force: Floats, voltage: Floats, battery_current: Floats) -> State:
        return replace(
            state,
            force_n=force,
            force_rate_n_s=state.speed_rad_s * angle_derivative(force),
            battery_voltage_v=voltage,
            motor_voltage_v=state.setting.duty * voltage,
            battery_current_a=battery_current,
        )

    def _rest(self, state: State, cutting: Floats, frozen: Signature | None) -> Signature:
        rest = residuals(self.baseline, state)
        rest["cutting"] = rest["cutting"] - cutting
        added = self.added(state) if frozen is None else frozen
        return {
            name: np.broadcast_to(rest[name] - added.get(name, 0.0), state.speed_rad_s.shape)
            for name in EQUATIONS
            if name in rest
        }

    def added(self, state: State) -> Signature:
        """Sum of the terms on a state."""
        total: Signature = {}
        for term in self.terms:
            for equation, wave in term.signature(state).items():
                total[equation] = total.get(equation, 0.0) + term.amplitude * wave
        return total

    def _wood_misfit(self, state: State) -> Floats:
        measured = self.measured
        if measured.force_n is None:
            assert state.current_a is not None and measured.current_a is not None
            return np.mean(state.current_a - measured.current_a, axis=1, keepdims=True)
        assert state.force_n is not None
        weight = self.baseline.cutting_speed(measured)
        return np.sum(weight * (state.force_n - measured.force_n), axis=1, keepdims=True) / weight.sum()


@lru_cache(maxsize=4)
def _basis(n_points: int) -> tuple[Floats, Floats]:
    """Fourier waves on the bins' middles, shape (2 h + 1, n_points), and the projection on them, transposed."""
    angle = (np.arange(n_points) + 0.5) * TWO_PI / n_points
    order = np.arange(1, N_HARMONICS + 1)
    waves = np.concatenate([np.ones((1, n_points)), np.cos(np.outer(order, angle)), np.sin(np.outer(order, angle))])
    return waves, waves.T * np.repeat([1.0, 2.0], [1, _N - 1]) / n_points


def _newton(problem: _Stroke, z: Floats) -> tuple[Floats, State, bool]:
    """Newton's method with a Jacobian by differences that is kept as long as it serves; also return the state.

    What the terms add hardly changes with the state, and some are dear: they are evaluated once a step, and the first
    Jacobian is that of the baseline. Where that gains too little, and to end with, they follow every state.
    """

    def jacobian(at: Floats, frozen: Signature | None) -> Floats:
        rows = np.concatenate([at[None, :], at + np.diag(_DIFFERENCE * problem.column_scale)])
        values = problem.close(rows, frozen)[1] / problem.row_scale
        return ((values[1:] - values[0]) / _DIFFERENCE).T

    def misfit(at: Floats, frozen: Signature | None) -> tuple[State, Floats]:
        state, rest = problem.close(at[None, :], frozen)
        return state, rest[0] / problem.row_scale

    frozen: Signature | None = problem.added(problem.linearise(z))
    slope, n_slopes = jacobian(z, frozen), 1
    state, value = misfit(z, frozen)
    for _ in range(_MAX_STEPS):
        if frozen is not None and np.abs(value).max() < _TOLERANCE:
            frozen = None
            state, value = misfit(z, frozen)
        size = float(np.abs(value).max())
        if not np.isfinite(size) or size < _TOLERANCE:
            break
        step = problem.column_scale * np.linalg.lstsq(slope, value, rcond=None)[0]
        for shorter in (1.0, 0.5, 0.2, 0.05):
            tried = misfit(z - shorter * step, frozen)
            if np.abs(tried[1]).max() < size:
                z, (state, value) = z - shorter * step, tried
                if frozen is not None:
                    frozen = problem.added(state)
                    state, value = misfit(z, frozen)
                break
        if not np.abs(value).max() < _GOOD_GAIN * size:
            if n_slopes == _MAX_JACOBIANS:
                break
            frozen = None
            state, value = misfit(z, frozen)
            slope, n_slopes = jacobian(z, frozen), n_slopes + 1
    if frozen is not None:
        state = misfit(z, None)[0]
    # A signature with corners may keep Newton's method from the last digits, which do not matter.
    return z, state, bool(np.abs(value).max() < 1e3 * _TOLERANCE)
