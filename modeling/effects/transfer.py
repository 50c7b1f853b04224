"""Linear distortions of a reading: periodic strokes in the frequency domain, a start-up on its time grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, SignatureFunction, TransferFunction
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import START_UP_STEP_S, TWO_PI, Motion, State, angle_derivative

# Delays and time constants that a sensor of a linear axis may have.
AXIS_TIMES_S: Final = tuple(float(tau) for tau in np.geomspace(3e-4, 3e-2, 8))
Complexes = NDArray[np.complexfloating]
# Of an amplitude, by an average: beyond, nobody can undo it.
_MOST_TAKEN: Final = 0.5
# A start-up with what is put before and behind it, in lengths of the start-up.
_START_LENGTHS: Final = 4


class Spectrum:
    """A wave in the frequency domain, to pass through any number of transfer functions.

    Parameters
    ----------
    wave : ndarray, shape (n_units, n_points)
        Of the state's grid. The speed ripple within a stroke is taken into account.
    state : State
        A start-up is taken to come from rest: before it the wave runs back to 0 with its first slope.

    Examples
    --------
    A transfer function of one changes nothing:

    >>> from types import SimpleNamespace
    >>> from sawbench.modeling.state import Motion
    >>> speed = 90.0 + 15.0 * np.cos(np.arange(32) * TWO_PI / 32)[None, :]
    >>> state = SimpleNamespace(kind="running", motion=Motion(speed, speed))
    >>> bool(np.allclose(Spectrum(speed**2, state).through(np.ones_like), speed**2))
    True
    """

    def __init__(self, wave: Floats, state: State) -> None:
        self._wave, self._state = wave, state

    @cached_property
    def _orders(self) -> tuple[Floats, Complexes]:
        """Frequencies in Hz and the coefficients there; not worked out where no filter asks for them."""
        return _of_strokes(self._wave, self._state.motion) if self._state.kind == "running" else _of_start(self._wave)

    def through(self, transfer: TransferFunction) -> Floats:
        """What a transfer function makes of the wave, of the wave's shape.

        Parameters
        ----------
        transfer : callable
            Frequency in Hz, shape (n_units or 1, n_frequencies) -> complex gain of a shape that broadcasts to it.
        """
        frequency_hz, coefficients = self._orders
        change = coefficients * (transfer(frequency_hz) - 1.0)
        if self._state.kind != "running":
            n = self._wave.shape[-1]
            return self._wave + np.fft.irfft(change, _START_LENGTHS * n, axis=-1)[..., n : 2 * n]
        turns = self._state.motion.turns
        back = (change[:, None, :] @ turns)[:, 0] if len(turns) > 1 else change @ turns[0]
        return self._wave + back.real


def _of_strokes(wave: Floats, motion: Motion) -> tuple[Floats, Complexes]:
    """Frequencies of the orders of a stroke, shape (rows, n_points // 2), and the coefficients there."""
    turns, period_s = motion.turns, motion.period_s
    weighted = wave * motion.times / wave.shape[-1]
    found = (turns.conj() @ weighted[..., None])[..., 0] if len(turns) > 1 else weighted @ turns[0].conj().T
    found[:, 1:] *= 2.0
    return np.arange(wave.shape[-1] // 2) / period_s, found


def _of_start(wave: Floats) -> tuple[Floats, Complexes]:
    """Frequencies and spectrum of a start-up, with its way up from rest before it; after it, it stays and fades out."""
    n = wave.shape[-1]
    first, last = wave[..., :1], wave[..., -1:]
    slope = wave[..., 1:2] - first
    before = first + slope * np.arange(-n, 0)
    before = np.where(before * first > 0, before, 0.0)
    before = np.where(np.abs(before) <= np.abs(first), before, first)
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(n) / n)
    after = np.concatenate([np.broadcast_to(last, wave.shape), last * fade], axis=-1)
    spectrum = np.fft.rfft(np.concatenate([before, wave, after], axis=-1), axis=-1)
    return np.arange(spectrum.shape[-1])[None, :] / (_START_LENGTHS * n * START_UP_STEP_S), spectrum


def delay(delay_s: Floats | float) -> TransferFunction:
    """Pure delay; a negative one is early."""
    return lambda f: np.exp(-2j * np.pi * f * delay_s)


def low_pass(tau_s: float, damping: float = 0.0) -> TransferFunction:
    """Low-pass that delays slow signals by `tau_s`: of first order, or of second order with a damping above 0."""
    if damping == 0.0:
        return lambda f: 1.0 / (1.0 + 2j * np.pi * f * tau_s)
    natural_rad_s = 2.0 * damping / tau_s
    return lambda f: 1.0 / (1.0 + 2j * np.pi * f * tau_s - (2.0 * np.pi * f / natural_rad_s) ** 2)


def resonance(natural_hz: float, damping: float, f: Floats) -> Complexes:
    """What a mass on a spring makes of a force at frequencies `f`, in Hz, over what it makes of a slow one."""
    ratio = f / natural_hz
    return 1.0 / (1.0 - ratio**2 + 2j * damping * ratio)


def average(period_s: float) -> TransferFunction:
    """Mean over a time about each moment: nothing is late."""
    return lambda f: np.sinc(f * period_s).astype(np.complex128)


def before_average(period_s: float) -> TransferFunction:
    """What `average` is undone by; of what it takes more than half of, twice the reading stands for what was there."""
    return lambda f: 1.0 / np.maximum(average(period_s)(f).real, _MOST_TAKEN)


def stroke_rate_hz(state: State) -> Floats:
    """Strokes per second of each unit, shape (n_units, 1)."""
    return 1.0 / (TWO_PI * np.mean(1.0 / np.maximum(state.speed_rad_s, 1e-3), axis=-1, keepdims=True))


def time_derivative(wave: Floats, state: State) -> Floats:
    """Differentiate a wave on the state's grid with time, per second."""
    if state.kind == "running":
        return state.speed_rad_s * angle_derivative(wave)
    return np.gradient(wave, START_UP_STEP_S, axis=-1)


def force_reading(baseline: Baseline, state: State, reading: Floats) -> Signature:
    """Change of the residuals where the load cell shows `reading` instead of the expected force.

    The mechanical equation is evaluated with the reading, so it misses the difference.
    """
    return force_error(baseline, state, reading - baseline.expected_force(state))


def force_error(baseline: Baseline, state: State, error_n: Floats) -> Signature:
    """Change of the residuals where the load cell shows `error_n` too much."""
    return {"cutting": error_n, "mechanical": -baseline.load_torque(state, error_n)}


def shown_through(
    baseline: Baseline, state: State, signatures: Sequence[Signature], transfers: Mapping[str, TransferFunction]
) -> list[Signature]:
    """Signatures of effects as a sensor shows them that distorts what it reads.

    Parameters
    ----------
    baseline : Baseline
    state : State
    signatures : sequence of Signature
        As an ideal sensor shows them. Of the cutting equation they are forces.
    transfers : mapping of str to TransferFunction
        By equation; see `Effect.distorts`.
    """
    shown = [dict(signature) for signature in signatures]
    for name, transfer in transfers.items():
        there = [k for k, signature in enumerate(signatures) if name in signature]
        for k, error in zip(there, _errors([signatures[k][name] for k in there], state, transfer), strict=True):
            parts = force_error(baseline, state, error) if name == "cutting" else {name: error}
            for equation, part in parts.items():
                shown[k][equation] = shown[k].get(equation, 0.0) + part
    return shown


def _errors(waves: Sequence[Floats], state: State, transfer: TransferFunction) -> Sequence[Floats]:
    """What a transfer function adds to each of many waves of one state."""
    if state.kind != "running" or not waves:
        return [Spectrum(wave, state).through(transfer) - wave for wave in waves]
    turns, times, period_s = state.motion.turns, state.motion.times, state.motion.period_s
    n_points = times.shape[-1]
    orders = np.arange(n_points // 2)
    change = np.where(orders > 0, 2.0, 1.0) * (transfer(orders / period_s) - 1.0)
    weights = times / n_points
    # By row: from the wave to its orders, weighed by time, and back; the rows of a state may have one motion.
    matrix = np.real(((turns.conj() * weights[:, None, :]).transpose(0, 2, 1) * change[:, None, :]) @ turns)
    return np.swapaxes(np.swapaxes(waves, 0, 1) @ matrix, 0, 1)


def current_reading(baseline: Baseline, state: State, error_a: Floats, error_rate_a_s: Floats) -> Signature:
    """Change of the residuals where the motor current is read too high by `error_a`."""
    plant = baseline.plant
    return {
        "electrical": -plant.resistance_ohm.nominal * error_a - plant.inductance_h.nominal * error_rate_a_s,
        "mechanical": plant.torque_constant_n_m_per_a.nominal * error_a,
        "converter": -state.setting.duty * error_a,
    }


def lag_on_axis(effect: Effect, equation: str, signature: SignatureFunction) -> Effect:
    """A sensor's lag on a linear axis: one time constant, told from a late clock by the cycle rate.

    Parameters
    ----------
    effect : Effect
        On the saw.
    equation : str
    signature : callable
        (axis, state, tau_s) -> tuple of Signature.
    """
    return replace(
        effect,
        equation=equation,
        signature=signature,
        shapes=tuple({"tau_s": tau} for tau in AXIS_TIMES_S),
        needs=(),
        confused_with=("clock_offset",),
        told_apart_by="a sweep of the cycle rate",
        background=None,
        distorts=None,
    )
