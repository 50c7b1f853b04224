"""What known effects change in strokes and in a discharge, over k_Fc: a live estimate only looks up.

As in a fit, the share of the effects in the time means of a stroke is the difference of two periodic strokes, with and
without them, at the battery voltage of that stroke; what is left is a stroke of the saw without effects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from sawbench.bench.config import ConverterConfig
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.modeling.effect_discharge import discharge_with_effects
from sawbench.modeling.effect_fit import by_one_std
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.operating_point import OperatingPoint, check_scales, mean_over_time, periodic_stroke
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import TWO_PI
from sawbench.modeling.stroke_tables import K_GRID, StrokeTables, with_draw

# Strokes with effects are solved at every fifth k_Fc of the grid and at its end; between them a smooth curve is taken.
_NODES: Final = np.array([*range(1, len(K_GRID) - 1, 5), len(K_GRID) - 1])
_FEWEST_NODES: Final = 2
# Of terminal voltages, from this share of the open-circuit voltage at the cut-off up to that of a full battery.
_N_VOLTAGES: Final = 3
_LOWEST_SHARE: Final = 0.9
# States of charge at which the strokes of a discharge are solved.
_DISCHARGE_NODES: Final = 5


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialEffects:
    """Known effects, and what they depend on in a trial.

    Attributes
    ----------
    known : sequence of KnownEffect
    feed_m_s, thickness_m : float
        NaN where nobody said.
    """

    known: Sequence[KnownEffect]
    feed_m_s: float = np.nan
    thickness_m: float = np.nan

    def point(self, converter: ConverterConfig | None, duty: float | None) -> OperatingPoint:
        """Operating point of the trial, its k_Fc still open."""
        held_v = converter.voltage_v if converter is not None and converter.mode == "held_voltage" else None
        return OperatingPoint(
            k_fc_n_s_per_m=0.0,
            duty=None if held_v is not None else duty,
            held_voltage_v=held_v,
            feed_m_s=self.feed_m_s,
            thickness_m=self.thickness_m,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class EffectTables:
    """The model of a live estimate with known effects.

    Attributes
    ----------
    tables : StrokeTables
        Battery current and remaining runtime are those with the effects; k_Fc from a current is that without.
    voltage_v : ndarray, shape (n_voltages,)
        At the battery's terminals, rising.
    period_s, force_n, current_a : ndarray, shape (n_k, n_voltages)
        What the effects add to the period of a stroke and to its time means, over `K_GRID`.
    largest_k_fc : float
        Beyond this, N*s/m, the saw does not run, or not down to the cut-off; the tables go on as they are there.
    """

    tables: StrokeTables
    voltage_v: Floats
    period_s: Floats
    force_n: Floats
    current_a: Floats
    largest_k_fc: float

    def share(self, k_fc_n_s_per_m: float, voltage_v: float) -> tuple[float, float, float]:
        """Period (s), mean force (N) and mean current (A) that the effects add at a k_Fc and a battery voltage."""
        period_s, force_n, current_a = (
            float(np.interp(voltage_v, self.voltage_v, [np.interp(k_fc_n_s_per_m, K_GRID, row) for row in table.T]))
            for table in (self.period_s, self.force_n, self.current_a)
        )
        return period_s, force_n, current_a


def models_of(bare: StrokeTables, baseline: Baseline, point: OperatingPoint) -> tuple[EffectTables, ...]:
    """`effect_tables` of the model, then of those with one uncertain effect each larger by its standard uncertainty."""
    return tuple(effect_tables(bare, model, point) for model in (baseline, *by_one_std(baseline)))


def effect_tables(bare: StrokeTables, baseline: Baseline, point: OperatingPoint) -> EffectTables:
    """Solve strokes and discharges with known effects at some k_Fc, as far up as the saw runs.

    Parameters
    ----------
    bare : StrokeTables
        Without the effects, with a battery.
    baseline : Baseline
        With the effects.
    point : OperatingPoint
        Duty or held voltage, feed and thickness; its k_Fc does not count.

    Raises
    ------
    InputError
        Without a battery, where an effect needs what the point does not say, or if the model with the effects has
        hardly any steady stroke.
    """
    battery = baseline.battery
    if battery is None or bare.soc is None:
        raise InputError("a live estimate with [effects] needs a battery", remedy="fill in [battery]")
    check_scales(baseline)
    open_v = baseline.open_circuit_voltage(3600.0 * battery.capacity_ah * (1.0 - np.array([battery.cutoff_soc, 1.0])))
    voltage_v = np.linspace(_LOWEST_SHARE * open_v[0], open_v[1], _N_VOLTAGES)

    def solved(node: int) -> tuple[Floats, Floats] | None:
        at_node = replace(point, k_fc_n_s_per_m=float(K_GRID[node]))
        changes = [_added(baseline, replace(at_node, battery_voltage_v=float(volt))) for volt in voltage_v]
        drawn = None if None in changes else _drawn(bare, baseline, at_node, node)
        return None if drawn is None else (np.array(changes), drawn)

    nodes, rows = _up_to_stall(solved)
    if len(nodes) < _FEWEST_NODES:
        raise InputError(
            "the model with its [effects] has no steady stroke in most of the range",
            remedy="check [effects], [plant] and the duty",
        )
    added, drawn = (_over_grid(nodes, np.array(values)) for values in zip(*rows, strict=True))
    period_s, force_n, current_a = np.moveaxis(added, -1, 0)
    ratio, drop_v = np.moveaxis(drawn, 1, 0)
    assert bare.battery_current_a is not None and bare.battery_voltage_v is not None
    return EffectTables(
        tables=with_draw(bare, battery, ratio * bare.battery_current_a, bare.battery_voltage_v + drop_v),
        voltage_v=voltage_v,
        period_s=period_s,
        force_n=force_n,
        current_a=current_a,
        largest_k_fc=float(K_GRID[nodes[-1]]),
    )


def _up_to_stall(
    solved: Callable[[int], tuple[Floats, Floats] | None],
) -> tuple[list[int], list[tuple[Floats, Floats]]]:
    """Solve node after node; where the saw no longer runs, the last k_Fc of the grid at which it does."""
    nodes: list[int] = []
    rows: list[tuple[Floats, Floats]] = []
    for node in _NODES.tolist():
        last = nodes[-1] if nodes else node - 1
        for nearer in range(node, last, -1):
            found = solved(nearer)
            if found is not None:
                nodes.append(nearer)
                rows.append(found)
                break
        if not nodes or nodes[-1] != node:
            break
    return nodes, rows


def _added(baseline: Baseline, point: OperatingPoint) -> tuple[float, float, float] | None:
    """Period, mean force and mean current that the effects add to a stroke; None where the saw does not run."""
    bare = periodic_stroke(replace(baseline, known=()), point)
    full = periodic_stroke(baseline, point, start=bare if bare.is_settled else None)
    if not (bare.is_settled and full.is_settled):
        return None
    means = [
        (
            float(np.mean(TWO_PI / one.state.speed_rad_s)),
            mean_over_time(one.state, one.state.force_n),
            mean_over_time(one.state, one.state.current_a),
        )
        for one in (full, bare)
    ]
    period_s, force_n, current_a = (float(with_it - without) for with_it, without in zip(*means, strict=True))
    return period_s, force_n, current_a


def _drawn(bare: StrokeTables, baseline: Baseline, point: OperatingPoint, node: int) -> Floats | None:
    """Battery current as a ratio to that without effects, and change of its voltage, shape (2, n_soc)."""
    battery = baseline.battery
    assert battery is not None and bare.soc is not None
    assert bare.battery_current_a is not None and bare.battery_voltage_v is not None
    found = discharge_with_effects(baseline, point, cutoff_soc=battery.cutoff_soc, n_nodes=_DISCHARGE_NODES)
    if found.status != "ok":
        return None
    curves = found.curves
    current_a, voltage_v = (
        np.interp(bare.soc, curves.soc[::-1], wave[::-1])
        for wave in (curves.battery_current_a, curves.battery_voltage_v)
    )
    return np.array([current_a / bare.battery_current_a[node], voltage_v - bare.battery_voltage_v[node]])


def _over_grid(nodes: list[int], values: Floats) -> Floats:
    """Values at the nodes, shape (n_nodes, ...), over the whole of `K_GRID`; beyond them those at the end."""
    from scipy.interpolate import PchipInterpolator

    known_k = K_GRID[nodes]
    return PchipInterpolator(np.log(known_k), values, axis=0)(np.log(np.clip(K_GRID, known_k[0], known_k[-1])))
