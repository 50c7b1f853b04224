"""What the page shows beyond the contract: strokes before and after, the map of the gap, how alike causes look."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from sawbench.bench.plain_digits import rounded
from sawbench.bench.recording import Floats
from sawbench.diagnosis.answer.channel_gap import CHANNELS, MODELS, ChannelGap, Cycle
from sawbench.diagnosis.answer.standing_out import Cell, find_cells
from sawbench.diagnosis.answer.where import gap_of
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.features import wave_of
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.state import TWO_PI

_SHOWN_CHANNELS = ("force_n", "motor_current_a", "crank_speed_rad_s")
_N_STROKES = 3
_N_POINTS = 64
_N_SECTORS = 36
_N_ALIKE, _N_EVIDENCE = 10, 20


def detail(problem: LinearProblem, posterior: Posterior, channels: ChannelGap | None) -> dict[str, Any]:
    """Collect the curves and tables of the page.

    Parameters
    ----------
    problem : LinearProblem
    posterior : Posterior
    channels : ChannelGap or None

    Returns
    -------
    dict
        "frame" of a machine that is no saw, "strokes", "map", "standing_out", "probabilities", "log_evidence",
        "resembles", "alike", "runtime_of", "known_effects" (magnitudes of those that the model as configured has,
        but for those of sensors alone, which are in `signals`);
        plain values, some 80 kB as JSON.
    """
    frame = problem.campaign.plant.machine.frame
    return {
        **({} if frame == "crank" else {"frame": frame}),
        "strokes": [] if channels is None else [_stroke(cycle) for cycle in _telling(channels.cycles)],
        "map": _map(problem, posterior),
        "standing_out": _standing_out(problem, posterior.small),
        "probabilities": {h.name: h.probability for h in posterior.hypotheses if h.probability > 1e-6},
        "log_evidence": {
            h.name: h.log_evidence for h in sorted(posterior.hypotheses, key=lambda h: -h.log_evidence)[:_N_EVIDENCE]
        },
        "resembles": posterior.resembles,
        "alike": _alike_matrix(problem, posterior.explanations[:_N_ALIKE]),
        "runtime_of": "" if channels is None else channels.runtime_of,
        "known_effects": {
            known.name: {"value": known.value, "std": known.std, "unit": known.effect.strength.unit}
            for known in problem.campaign.plant.known
            if known.effect not in problem.campaign.plant.machine.sensor_properties
        },
    }


def _telling(cycles: Sequence[Cycle]) -> list[Cycle]:
    """The stroke on which models differ most, one at another operating point that cuts, one in air."""
    chosen: list[Cycle] = []
    for wanted in (False, False, True):
        left = [
            c for c in cycles
            if c.is_idle == wanted and c.operating_point not in {k.operating_point for k in chosen}
        ]  # fmt: skip
        if left:
            chosen.append(max(left, key=_change))
    rest = [c for c in cycles if c.operating_point not in {k.operating_point for k in chosen}]
    while len(chosen) < _N_STROKES and rest:
        chosen.append(rest.pop(0))
        rest = [c for c in rest if c.operating_point != chosen[-1].operating_point]
    return chosen


def _change(cycle: Cycle) -> float:
    """How far the nominal model misses, relative to the size of each channel."""
    return sum(
        float(np.sqrt(np.mean((wave - cycle.predicted["nominal"][name]) ** 2)) / max(np.abs(wave).max(), 1e-9))
        for name, wave in cycle.measured.items()
        if name in _SHOWN_CHANNELS
    )


def _stroke(cycle: Cycle) -> dict[str, Any]:
    units = {name: unit for name, _, unit in CHANNELS}
    return {
        "trial": cycle.label,
        "operating_point": cycle.operating_point,
        "channels": {
            name: {
                "unit": units[name],
                "measured": _curve(cycle.measured[name]),
                **{model: _curve(cycle.predicted[model][name]) for model in MODELS},
            }
            for name in _SHOWN_CHANNELS
            if name in cycle.measured
        },
    }


def _curve(wave: Floats) -> list[float]:
    pairs = wave.reshape(_N_POINTS, -1).mean(axis=1)
    return [rounded(value) for value in pairs]


def _map(problem: LinearProblem, posterior: Posterior) -> dict[str, Any]:
    """Mean gap of the model as configured, by equation, operating point and crank angle; see `where`."""
    gap, _ = gap_of(problem, posterior)
    angle = (np.arange(_N_SECTORS) + 0.5) * TWO_PI / _N_SECTORS
    found: dict[str, dict[str, list[Floats]]] = {}
    for part in problem.parts:
        if part.state.kind != "running":
            continue
        features = part.unwhiten(gap).mean(axis=0)
        for equation, place in part.layout.slices.items():
            wave = wave_of(features[place], angle)
            found.setdefault(equation, {}).setdefault(part.setting.operating_point, []).append(wave)
    points = list(dict.fromkeys(part.setting.operating_point for part in problem.parts))
    forms = problem.campaign.plant.equations
    return {
        "operating_points": points,
        "equations": {
            equation: {
                "unit": forms[equation].unit,  # type: ignore[index]
                "values": [
                    [rounded(v) for v in np.mean(by_point[point], axis=0)] if point in by_point else None
                    for point in points
                ],
            }
            for equation, by_point in found.items()
        },
    }


def _standing_out(problem: LinearProblem, small: Floats) -> dict[str, Any]:
    """Significant regions: for each partition a table of equations by places, None where there is no such cell."""
    cells = find_cells(problem, small)
    forms = problem.campaign.plant.equations
    partitions: dict[str, Any] = {}
    for partition in dict.fromkeys(cell.partition for cell in cells):
        members = [cell for cell in cells if cell.partition == partition]
        places = sorted({cell.place: None for cell in members}, key=_first_number)
        by_place = {(cell.equation, cell.place): cell for cell in members}
        equations = dict.fromkeys(cell.equation for cell in members)
        partitions[partition] = {
            "places": places,
            "equations": {
                equation: _row([by_place.get((equation, place)) for place in places]) for equation in equations
            },
        }
    found = {cell.equation: forms[cell.equation] for cell in cells if cell.stands_out}
    return {
        "false_discovery_rate": SETTINGS.report.false_discovery_rate,
        "n_cells": len(cells),
        "n_found": sum(cell.stands_out for cell in cells),
        "found_in": [{"equation": form.place, "channel": form.channel} for form in found.values()],
        "partitions": partitions,
    }


def _row(cells: Sequence[Cell | None]) -> dict[str, list[float | None]]:
    """One equation of a partition. q is not rounded: what is read off against the rate must agree with `n_found`."""
    return {
        "times_expected": [None if cell is None else float(f"{cell.misfit / cell.expected:.3g}") for cell in cells],
        "q_value": [None if cell is None else cell.q_value for cell in cells],
    }


def _first_number(place: str) -> float:
    """Order of places by the number that they begin with; others stay as they come."""
    start = place.split(" ", 1)[0]
    return float(start) if start.isdecimal() else -1.0


def _alike_matrix(problem: LinearProblem, explanations: Sequence[Explanation]) -> dict[str, Any]:
    """Cosine between the best signatures once everything that may be mistuned is taken out."""
    if not explanations:
        return {"effects": [], "cosine": []}
    marginal = Marginal(problem)
    gram, _ = marginal.gram(np.hstack([e.column.columns[:, :1] for e in explanations]))
    size = np.sqrt(np.maximum(np.diag(gram), 1e-12))
    cosine = np.clip(gram / np.outer(size, size), -1.0, 1.0)
    return {
        "effects": [e.effect.name for e in explanations],
        "cosine": [[round(float(v), 2) for v in row] for row in cosine],
    }
