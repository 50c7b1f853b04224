"""What the baseline of a linear axis may leave out: signatures in its balance of forces, N.

    r = F_drive - m a - b v - F_load

The ids are those of the catalogue where the cause is the same; `cogging` and `elastic_load` are the axis's own.
Sizes are shares of the force, travel and speed that the campaign reaches (an axis may be of any size): assumed.
Dry friction of guide and of motor are one term on an axis that the motor moves rigidly: `guide_friction` stands
for both and says so (`same_as`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bench.recording import Floats
from diagnosis.effects.effect import Effect, Strength
from diagnosis.effects.transfer import filtered
from diagnosis.equations import Signature
from diagnosis.plants.axis_motion import AxisState

if TYPE_CHECKING:
    from diagnosis.plants.linear_axis import LinearAxis

_SMOOTH_SHARE = 0.01
_TAUS_S: Final = tuple(float(tau) for tau in np.geomspace(3e-4, 3e-2, 8))
_LOAD, _DRIVE, _MOTION = 0.0, 1.0, 2.0
# Presliding: friction turns round over a distance (Dahl 1968), here as a share of the stroke; 0 is Coulomb's law.
_PRESLIDING: Final = (0.0, 0.002, 0.004, 0.007, 0.012, 0.02, 0.035, 0.06, 0.1)


def axis_effects(force_n: float, stroke_m: float) -> tuple[Effect, ...]:
    """List every effect for an axis of the given size.

    Parameters
    ----------
    force_n, stroke_m : float
        Force of the drive and travel.

    Returns
    -------
    tuple of Effect
    """
    return (
        *_frictions(force_n),
        *_positions(force_n, stroke_m),
        *_readings(force_n),
    )


def direction(state: AxisState, presliding_m: float) -> Floats:
    """Direction of the friction force, -1..1, over the cycle; shape of the state.

    dz/dx = (sgn(v) - z) / presliding_m (Dahl): without presliding the smoothed sign of the velocity.
    """
    if presliding_m <= 0.0:
        top = np.abs(state.velocity_m_s).max(axis=1, keepdims=True)
        return np.tanh(state.velocity_m_s / (_SMOOTH_SHARE * top))
    step = np.diff(state.position_m, axis=1, prepend=state.position_m[:, -1:])
    keep, sign = np.exp(-np.abs(step) / presliding_m), np.sign(step)
    out, z = np.zeros_like(step), np.zeros(len(step))
    for _ in range(2):  # the second time round the cycle is periodic
        for k in range(step.shape[1]):
            z = sign[:, k] + (z - sign[:, k]) * keep[:, k]
            out[:, k] = z
    return out


def _dry(
    axis: LinearAxis,
    state: AxisState,
    presliding: float,
    slope: float = 0.0,
    static_ratio: float = 1.0,
    stribeck: float = 1.0,
) -> tuple[Signature, ...]:
    speed = np.abs(state.velocity_m_s) / (stribeck * axis.top_speed_m_s)
    dip = 1.0 + (static_ratio - 1.0) * np.exp(-(speed**2))
    place = (state.position_m - np.mean(state.position_m)) / (0.5 * axis.stroke_m)
    return ({"mechanical": direction(state, presliding * axis.stroke_m) * dip * (1.0 + slope * place)},)


def _loaded(axis: LinearAxis, state: AxisState, presliding: float) -> tuple[Signature, ...]:
    if state.force_n is None:
        return ({},)
    return ({"mechanical": np.abs(state.force_n) * direction(state, presliding * axis.stroke_m)},)


def _drag(axis: LinearAxis, state: AxisState, power: float) -> tuple[Signature, ...]:
    share = state.velocity_m_s / axis.top_speed_m_s
    return ({"mechanical": np.sign(share) * np.abs(share) ** power},)


def _frictions(force_n: float) -> tuple[Effect, ...]:
    dip = [(s, v) for s in (1.5, 2.0) for v in (0.05, 0.3)]
    return (
        Effect(
            name="guide_friction",
            place="mechanical",
            equation="F_c * sgn(v), with a Stribeck dip, presliding, or more at one end",
            strength=Strength(name="force_n", unit="N", typical=0.2 * force_n, low=0.1, high=6.0, source="assumed"),
            signature=_dry,
            shapes=(
                *({"presliding": p, "slope": k} for p in _PRESLIDING for k in (0.0, 0.25, -0.25)),
                *({"presliding": p, "static_ratio": s, "stribeck": v} for p in (0.0, 0.004, 0.012) for s, v in dip),
            ),
            confused_with=("load_dependent_friction", "windage_drag"),
            told_apart_by="a sweep of the cycle rate, with two loads",
            same_as=("motor_coulomb_friction",),
        ),
        Effect(
            name="load_dependent_friction",
            place="mechanical",
            equation="mu * |F_load| * sgn(v)",
            strength=Strength(name="friction_share", unit="1", typical=0.1, low=0.1, high=6.0, source="assumed"),
            signature=_loaded,
            shapes=tuple({"presliding": p} for p in _PRESLIDING),
            grows_with=("load",),
            confused_with=("guide_friction",),
            told_apart_by="the same rate with two loads, one of them none",
        ),
        Effect(
            name="windage_drag",
            place="mechanical",
            equation="c * |v|^p * sgn(v)",
            strength=Strength(
                name="force_at_top_speed_n", unit="N", typical=0.1 * force_n, low=0.1, high=6.0, source="assumed"
            ),
            signature=_drag,
            shapes=tuple({"power": p} for p in (2.0, 1.6, 2.4)),
            grows_with=("speed",),
            confused_with=("guide_friction",),
            told_apart_by="a sweep of the cycle rate",
        ),
    )  # fmt: skip


def _play(axis: LinearAxis, state: AxisState, gap: float) -> tuple[Signature, ...]:
    """Between the flanks the drive carries nothing: the required force is missing until the gap is crossed."""
    crossed = np.abs(direction(state, gap * axis.stroke_m) - np.sign(state.velocity_m_s))
    is_free = crossed > 2.0 * np.exp(-1.0)
    return ({"mechanical": -axis.required_force(state) * is_free},)


def _cogging(_: LinearAxis, state: AxisState, pitch_m: float) -> tuple[Signature, ...]:
    phase = 2.0 * np.pi * state.position_m / pitch_m
    return {"mechanical": np.sin(phase)}, {"mechanical": np.cos(phase)}


def _spring(axis: LinearAxis, state: AxisState, power: float) -> tuple[Signature, ...]:
    share = (state.position_m - np.mean(state.position_m)) / (0.5 * axis.stroke_m)
    return ({"mechanical": 0.5 * axis.stroke_m * np.sign(share) * np.abs(share) ** power},)


def _positions(force_n: float, stroke_m: float) -> tuple[Effect, ...]:
    return (
        Effect(
            name="yoke_backlash",
            place="mechanical",
            equation="no force across a gap after each reversal",
            strength=Strength(name="gap_m", unit="m", typical=1.0, low=0.7, high=1.4, source="assumed"),
            signature=_play,
            shapes=tuple({"gap": g} for g in (0.005, 0.01, 0.02, 0.05)),
            shape_strength=lambda amplitude, shape: amplitude * shape["gap"] * stroke_m,
            grows_with=("position",),
            confused_with=("guide_friction",),
            told_apart_by="a load that does not change its sign: it closes the gap",
        ),
        Effect(
            name="cogging",
            place="mechanical",
            equation="a * sin(2 pi x / p + psi)",
            strength=Strength(
                name="amplitude_n", unit="N", typical=0.05 * force_n, low=0.1, high=6.0, source="assumed"
            ),
            signature=_cogging,
            shapes=tuple({"pitch_m": float(p) * stroke_m} for p in np.geomspace(0.1, 0.4, 48)),
            grows_with=("position",),
            confused_with=("elastic_load",),
            told_apart_by="another stroke: it stays at its place",
        ),
        Effect(
            name="elastic_load",
            place="mechanical",
            equation="k * (x - x_0): spring, cable, bellows",
            strength=Strength(
                name="stiffness_n_per_m", unit="N/m", typical=0.2 * force_n / stroke_m, low=0.1, high=20.0,
                source="assumed",
            ),
            signature=_spring,
            shapes=({"power": 1.0}, {"power": 3.0}),
            grows_with=("position",),
            confused_with=("cogging",),
            told_apart_by="another stroke: it grows with the distance from the middle, whatever the speed",
        ),
    )  # fmt: skip


def _late(wave: Floats, state: AxisState, delay_s: float) -> Floats:
    return filtered(wave, state, lambda f: np.exp(-2j * np.pi * f * delay_s))


def _clock(axis: LinearAxis, state: AxisState, device: float, tau_s: float) -> tuple[Signature, ...]:
    if device == _LOAD:
        return ({},) if state.force_n is None else ({"mechanical": state.force_n - _late(state.force_n, state, tau_s)},)
    if device == _DRIVE:
        required = axis.required_force(state)
        return ({"mechanical": _late(required, state, tau_s) - required},)
    load = 0.0 if state.force_n is None else state.force_n
    motion = axis.required_force(state) - load
    return ({"mechanical": motion - _late(motion, state, tau_s)},)


def _lagged_load(_: LinearAxis, state: AxisState, tau_s: float) -> tuple[Signature, ...]:
    if state.force_n is None:
        return ({},)
    return ({"mechanical": state.force_n - _low_pass(state.force_n, state, tau_s)},)


def _lagged_drive(axis: LinearAxis, state: AxisState, tau_s: float) -> tuple[Signature, ...]:
    return ({"mechanical": _low_pass(state.drive_n, state, tau_s) - state.drive_n},)


def _low_pass(wave: Floats, state: AxisState, tau_s: float) -> Floats:
    return filtered(wave, state, lambda f: 1.0 / (1.0 + 2j * np.pi * f * tau_s))


def _drift(_: LinearAxis, state: AxisState, sign: float) -> tuple[Signature, ...]:
    elapsed_s = state.setting.session_s + state.time_s
    return ({"mechanical": sign * elapsed_s / 1000.0},)


def _readings(force_n: float) -> tuple[Effect, ...]:
    delay = Strength(name="delay_s", unit="s", typical=1.0, low=0.7, high=1.4, source="assumed")
    lag = Strength(name="time_constant_s", unit="s", typical=1.0, low=0.7, high=1.4, source="assumed")

    def seconds(amplitude: float, shape: dict[str, float]) -> float:
        return amplitude * shape["tau_s"]

    return (
        Effect(
            name="force_sensor_lag", place="sensing", equation="tau * dF_m/dt + F_m = F_load", strength=lag,
            signature=_lagged_load, shapes=tuple({"tau_s": tau} for tau in _TAUS_S), shape_strength=seconds,
            grows_with=("speed",), confused_with=("clock_offset",), told_apart_by="a sweep of the cycle rate",
        ),
        Effect(
            name="current_sensor_lag", place="sensing", equation="tau * dy/dt + y = drive", strength=lag,
            signature=_lagged_drive, shapes=tuple({"tau_s": tau} for tau in _TAUS_S), shape_strength=seconds,
            grows_with=("speed",), confused_with=("clock_offset",), told_apart_by="a sweep of the cycle rate",
        ),
        Effect(
            name="clock_offset", place="sensing", equation="one device: y_m(t) = y(t - tau)", strength=delay,
            signature=_clock,
            shapes=tuple({"device": d, "tau_s": tau} for d in (_LOAD, _DRIVE, _MOTION) for tau in _TAUS_S),
            shape_strength=seconds, grows_with=("speed",),
            confused_with=("force_sensor_lag", "current_sensor_lag"),
            told_apart_by="a sweep of the cycle rate; no amplitude is lost",
        ),
        Effect(
            name="force_offset_drift", place="sensing", equation="F_m = F + d(t)",
            strength=Strength(
                name="drift_n_per_1000_s", unit="N", typical=0.05 * force_n, low=0.1, high=6.0, source="assumed"
            ),
            signature=_drift, shapes=({"sign": 1.0}, {"sign": -1.0}),
            shape_strength=lambda amplitude, shape: amplitude * shape["sign"],
            grows_with=("time",), told_apart_by="the first trial again at the end",
        ),
    )  # fmt: skip
