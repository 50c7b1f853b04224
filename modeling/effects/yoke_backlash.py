"""Play between crank pin and yoke: a dead band of 0.1 to 0.5 mm in which the pin does not carry the plunger.

The pin pushes with m x'' + F; where that force changes sign, the plunger crosses the gap: in air near mid
stroke (inertia), under a cut near the dead centres, and where friction holds the plunger, right after them.
The displacement sensor sits on the plunger, so the crank angle that is read off it swings although the crank does
not: back-EMF and inertia torque of the baseline go with the wrong speed, by far the largest trace, and all of
it is fixed in angle. Where the gap is crossed, and how (free flight, friction, bounce), no form says well:
here the swing is any wave of harmonics that fall as those of a jump do, one in air and one under load, which may
change with speed and stock. What tells it from an unknown cause is that one wave explains back-EMF and inertia and
the cut goes with the plunger's own velocity; what tells it from a bent sensor is that this reads the same wave in air
and under load, and the force misses it. Clearance: assumed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from sawbench.bench.plain_digits import plain
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import BACKGROUND_SHARE, Effect, Prepared, Strength, Words
from sawbench.modeling.effects.friction import direction, through_play
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.modeling.residuals import Baseline, Equation, Signature, residuals
from sawbench.modeling.state import State, turned

if TYPE_CHECKING:
    from sawbench.modeling.machines.linear_axis import AxisBaseline, AxisState

# A pin that strikes shows in harmonics of any order: as many as the electrical equation is compared in. With fewer a
# part of its gap is left, with more those beyond, which nothing measures, stand for what others miss.
_N_HARMONICS = 12
_STEP = 1e-4
# Equations that go with the angle that is read.
_SWINGING: Final[tuple[Equation, ...]] = ("electrical", "mechanical")
_SHOWN, _LARGER = 1e-6, 4.0
# A gap over twice the crank's radius is an angle: a yoke of half a metre turns it back into a gap.
_UNIT_YOKE = Mechanism(radius_m=0.5)
_SPEED_RAD_S, _STIFFNESS_N_S_PER_M = 80.0, 300.0


def _prepared(baseline: Baseline, state: State) -> Callable[..., tuple[Signature, ...]]:
    of_waves = swings(baseline, state, _waves(state.angle_rad) / (2.0 * baseline.radius_m))

    def signature(waves: float) -> tuple[Signature, ...]:
        found: list[Signature] = []
        for weight in _weights(state, int(waves)):
            found.extend({name: weight * rows for name, rows in one.items()} if weight else {} for one in of_waves)
        return tuple(found)

    return signature


def _waves(angle_rad: Floats) -> Floats:
    """Cosine and sine of each harmonic in turn, falling as those of a jump do, shape (2 harmonics, *angle's shape)."""
    found = [f(k * angle_rad) / np.sqrt(k) for k in range(1, _N_HARMONICS + 1) for f in (np.cos, np.sin)]
    return np.stack(found)


def _combined(baseline: Baseline, state: State, coefficients: Floats, waves: float) -> Signature:
    """One swing for the whole wave: a small deviation's signature is linear in it."""
    groups = coefficients.reshape(-1, 2 * _N_HARMONICS)
    weights = _weights(state, len(groups))
    total = sum(weight * group for weight, group in zip(weights, groups, strict=True))
    deviation = np.tensordot(np.asarray(total), _waves(state.angle_rad), axes=1) / (2.0 * baseline.radius_m)
    # `swing` is linear in the wave; a unit wave keeps its difference quotient where it was tested.
    size = float(np.abs(deviation).max())
    if size == 0.0:
        return {}
    return {name: size * wave for name, wave in swing(baseline, state, deviation / size).items()}


def _weights(state: State, n_groups: int) -> tuple[float, ...]:
    """In air and under load its own wave; each may change with speed, and that under load with the stock."""
    if n_groups == 1:
        return (1.0,)
    air, load = (1.0, 0.0) if state.setting.is_idle else (0.0, 1.0)
    if n_groups == 2:
        return (air, load)
    faster = float(np.mean(state.speed_rad_s)) / _SPEED_RAD_S - 1.0
    harder = state.k_guess_n_s_per_m / _STIFFNESS_N_S_PER_M - 1.0
    return (air, load, air * faster, load * faster, load * harder)


def apparent_gap(coefficients: Floats) -> float:
    """How far the plunger leaves the pin, peak to peak, over the typical gap: in air and under load, geometric mean.

    The read angle is off by gap / (2 r) times the wave, so the plunger by that times the lever, here of a yoke: a rod
    makes it up to r/l larger. In air play is crossed in part only, and under load the contact gives as well. Right to a
    factor of two: a wave that also changes with the stock or the speed is badly known at any one, and the larger swing
    counts up to four times the smaller. A campaign without idle runs, or without cuts, leaves that wave at 0, which
    says nothing of the gap.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
    groups = coefficients.reshape(-1, 2 * _N_HARMONICS)[:2]
    away = _UNIT_YOKE.lever(angle) * (groups @ _waves(angle))
    gaps = np.ptp(away, axis=1)
    shown = gaps[gaps >= _SHOWN * gaps.max()]
    return float(np.sqrt(shown.min() * min(shown.max(), _LARGER * shown.min())))


def swing(baseline: Baseline, state: State, deviation_rad: Floats, *, of_sensor: bool = False) -> Signature:
    """Change of the residuals for an angle that is read too large by a periodic wave, rad, per unit of the wave.

    The wave has the angle's shape, or is one row for all units. The plunger is where the sensor sees it, and the cut
    goes with its velocity: no gap of the cutting law. Where it is the sensor that swings (`of_sensor`), the cut goes
    with another velocity than the one read.
    """
    read_larger, read_smaller = turned(state, deviation_rad, (_STEP, -_STEP))
    up, down = (residuals(baseline, read, _SWINGING) for read in (read_larger, read_smaller))
    found: Signature = {name: (up[name] - down[name]) / (2.0 * _STEP) for name in up}
    if of_sensor and not state.setting.is_idle:
        expected_n = baseline.expected_force(read_smaller) - baseline.expected_force(read_larger)
        found["cutting"] = expected_n / (2.0 * _STEP)
    return found


def swings(baseline: Baseline, state: State, waves_rad: Floats, *, of_sensor: bool = False) -> list[Signature]:
    """`swing` for each of many waves, shape (n, n_units or 1, n_points).

    At once, as rows of rows; with known effects, which take states of their own shape only, one by one.
    """
    if baseline.known:
        return [swing(baseline, state, wave, of_sensor=of_sensor) for wave in waves_rad]
    found = swing(baseline, state, waves_rad, of_sensor=of_sensor)
    return [{name: rows[k] for name, rows in found.items()} for k in range(len(waves_rad))]


def _axis_signature(
    axis: AxisBaseline, state: AxisState, gap: float, spring: float = 0.0, before: float = 0.0
) -> tuple[Signature, ...]:
    """Between the flanks nothing is carried: what is required is missing until the gap is crossed.

    Without a spring that is the force of the rigid axis. With one the play is in series with the dry friction, which
    `before` is taken to turn round over that share of the stroke.
    """
    gap_m = gap * axis.stroke_m
    if spring == 0.0:
        crossed = np.abs(direction(state, gap_m) - np.sign(state.velocity_m_s))
        return ({"mechanical": -axis.required_force(state) * (crossed > 2.0 * np.exp(-1.0))},)
    felt = through_play(state, gap_m, spring * axis.stroke_m)
    return ({"mechanical": axis.friction_n * (felt - direction(state, before * axis.stroke_m))},)


def _axis_form(axis: AxisBaseline, gap: float, spring: float = 0.0, before: float = 0.0) -> str:
    del gap, before
    return f"in series with a spring of {plain(spring * axis.stroke_m, 'm')}" if spring > 0.0 else ""


def _on_axis(axis: AxisBaseline) -> Effect:
    return replace(
        EFFECT,
        equation="nothing carried across a gap after each reversal: no force, or none of a friction behind a spring",
        strength=replace(EFFECT.strength, typical=1.0, low=0.7, high=1.4),
        signature=_axis_signature,
        n_signatures=lambda shape: 1,
        shapes=(
            *({"gap": g} for g in (0.005, 0.01, 0.02, 0.05)),
            *(
                {"gap": g, "spring": s, "before": b}
                for g in (0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.33)
                for s in (0.02, 0.05, 0.1, 0.2)
                for b in (0.0, 0.06, 0.1)
            ),
        ),
        scales=("stroke_m", "friction_n"),
        shape_strength=lambda amplitude, shape: amplitude * shape["gap"] * axis.stroke_m,
        carries=("gap",),
        form_words=lambda shape: _axis_form(axis, **shape),
        needs=(),
        confused_with=("guide_friction",),
        told_apart_by="a load that does not change its sign: it closes the gap",
        size_of=None,
        combine=None,
        background=None,
    )


_AXIS_WORDS = Words(
    name="backlash",
    happens="there is play between drive and load: after each reversal the force stands still across it",
    measure="the free travel of the load with a dial gauge, drive held",
    mend="measure the play; take it up, or renew the worn joint",
)
EFFECT = Effect(
    name="yoke_backlash",
    place="mechanical",
    equation="plunger free within a gap around the crank pin",
    words=Words(
        happens="there is play between crank pin and yoke",
        measure="the free travel of the plunger with a dial gauge, crank held",
        mend="measure the play; renew pin or yoke",
    ),
    words_on={"linear_axis": _AXIS_WORDS},
    parts=("joint",),
    silent_in=("start_up",),
    strength=Strength(name="gap_m", unit="m", typical=2.5e-4, low=0.3, high=3.0, source="assumed"),
    signature=Prepared(_prepared),
    n_signatures=lambda shape: 2 * _N_HARMONICS * int(shape["waves"]),
    shapes=({"waves": 2.0}, {"waves": 5.0}),
    is_pointwise=False,
    moves_blade=True,
    needs=("motor_current_a",),
    grows_with=("position",),
    confused_with=("gear_eccentricity", "engagement_delay", "guide_friction"),
    told_apart_by="idle against cutting: fixed in angle, not in time, and the displacement itself is bent",
    size_of=apparent_gap,
    combine=_combined,
    background=(({"waves": 2.0}, BACKGROUND_SHARE),),
    variants={"linear_axis": _on_axis},
)
