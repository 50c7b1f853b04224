"""Pins and bearings between crank and plunger: they yield, and run in their fits with some play.

The plunger is behind the pin of the crank by the force between them over a stiffness, and by half of the clearance, on
the side that the pin pushes from. Where that force changes its sign, the plunger flies across the clearance before the
other side takes it. The angle of the crank is told from the plunger, so that the motor seems to turn unevenly: by the
wave that the regression of the displacement finds in what the plunger is behind by (`processing.stroke_ripple`). Its
edges lie where the force begins, ends, or has changed its sign, and the torque of inertia shows them. Some hundredths
of a millimetre are ordinary, and no gap of the saw. What is far more is play of the yoke or a shaft that twists
(`diagnosis.inference.beyond.drive`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.modeling.residuals import Baseline, Signature, is_angle_known, motor_ahead, plunger_acceleration
from sawbench.modeling.state import State, angle_derivative
from sawbench.processing.stroke_ripple import N_RIPPLE, wave_seen

# Assumed: 5 N a micrometre, of pin, bearings and guide one behind the other.
_YIELDS_M_PER_N: Final = 2e-7
# Clearance of a running fit of 6 to 10 mm: 13 to 50 um by ISO 286-2, H8/f7. A smaller one is crossed sooner.
_FIT_M: Final = 3e-5
_CROSSED_M: Final = (1e-5, 3e-5)
# Harmonics of the angle that a noisy displacement shows, and a quiet one, which the tracker follows itself.
SHOWN_HARMONICS: Final = (N_RIPPLE, 2 * N_RIPPLE)
# Parts of a cell in which a flight is followed.
_FINE: Final = 8

# Of baseline, state and the mean force by which the pin pushes, (n_points,): how far the plunger is behind.
_Behind = Callable[[Baseline, State, Floats], Floats]


def plunger_drive_nuisances() -> Iterator[Nuisance]:
    """List what the drive of the plunger may take off the balances.

    Yields
    ------
    Nuisance
        Its compliance in m/N, and the clearance of its fits in m, in few harmonics of the angle and in more.
    """
    behind: dict[str, tuple[float, _Behind]] = {"compliance": (_YIELDS_M_PER_N, lambda baseline, state, pushed: pushed)}
    for crossed_m in _CROSSED_M:
        std = _FIT_M / np.sqrt(len(_CROSSED_M))
        behind[f"clearance near {1e6 * crossed_m:g} um"] = (std, partial(_across, clearance_m=crossed_m))
    for (name, (std, of)), n_harmonics in product(behind.items(), SHOWN_HARMONICS):
        yield Nuisance(
            name=f"{name} of the plunger's drive in {n_harmonics} harmonics", std=std / np.sqrt(len(SHOWN_HARMONICS)),
            signature=partial(_seen, behind=of, n_harmonics=n_harmonics),
        )  # fmt: skip


def _seen(baseline: Baseline, state: State, *, behind: _Behind, n_harmonics: int) -> Signature:
    """By a plunger that is behind by that for the mean force with which the pin pushes it up the angle."""
    pushed_n = pushing_force(baseline, state)
    if pushed_n is None:
        return {}
    off_m = behind(baseline, state, np.mean(pushed_n, axis=0))
    ahead_rad = wave_seen(baseline.mechanism, state.angle_rad[0], off_m, n_harmonics)
    speed = baseline.gear * state.speed_rad_s * angle_derivative(ahead_rad)
    return motor_ahead(baseline, speed, state.speed_rad_s * angle_derivative(speed))


def pushing_force(baseline: Baseline, state: State) -> Floats | None:
    """Force with which the pin pushes the plunger up the angle, N, (n_units, n_points); None where it is not known."""
    if state.kind != "running" or state.force_n is None or not is_angle_known(state):
        return None
    inertia_n = baseline.plant.reciprocating_mass_kg.nominal * plunger_acceleration(baseline.mechanism, state)
    return inertia_n + baseline.cutting_sign * state.force_n


def _across(baseline: Baseline, state: State, pushed_n: Floats, *, clearance_m: float) -> Floats:
    """By half of the clearance, over it; after each change of sign the plunger is left behind until it is crossed."""
    n = _FINE * len(pushed_n)
    middles = (np.arange(n) + 0.5) / _FINE - 0.5
    force_n = np.interp(middles, np.arange(len(pushed_n)), pushed_n, period=len(pushed_n))
    side = np.where(force_n < 0.0, -0.5, 0.5)
    # Pin and plunger part by the double integral, over the angle, of the force that the pin lacks.
    speed_rad_s = float(np.mean(state.speed_rad_s))
    step = 2.0 * np.pi / n / speed_rad_s
    parting = step**2 * force_n / (baseline.plant.reciprocating_mass_kg.nominal * clearance_m)
    behind = side.copy()
    changes = np.flatnonzero(side != np.roll(side, 1))
    for change, after in zip(changes, np.roll(changes, -1), strict=True):
        at = (change + np.arange((after - change) % n)) % n
        crossed = np.cumsum(np.cumsum(np.abs(parting[at])))
        behind[at] = side[change] * np.minimum(2.0 * crossed - 1.0, 1.0)
    return behind.reshape(-1, _FINE).mean(axis=1)
