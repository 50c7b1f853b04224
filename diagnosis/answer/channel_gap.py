"""The gap per channel, in its unit: what models predict for operating points that they were not fitted to."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.answer.hold_out import HoldOut
from sawbench.diagnosis.answer.ladder import RUNGS, Fit, Ladder, Rungs
from sawbench.diagnosis.inference.battery_curve import SeenCurve
from sawbench.diagnosis.inference.columns import Column
from sawbench.diagnosis.inference.common_filter import filtered
from sawbench.diagnosis.inference.features import up_to_harmonic
from sawbench.diagnosis.inference.linear_problem import Part
from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.diagnosis.inference.nuisances import further_batteries
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State
from sawbench.modeling.stroke import Prediction, Term, mean_stroke, predict

CHANNELS: Final = (
    ("force_n", "force_n", "N"),
    ("motor_current_a", "current_a", "A"),
    ("crank_speed_rad_s", "speed_rad_s", "rad/s"),
    ("battery_voltage_v", "battery_voltage_v", "V"),
    ("battery_current_a", "battery_current_a", "A"),
)
MODELS: Final = ("nominal", "retuned", "with_effect")
# States of charge, as shares of what may be used, at which a stroke is predicted for the runtime.
_RUNTIME_NODES, _RUNTIME_WEIGHTS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True, kw_only=True, slots=True)
class Cycle:
    """The mean stroke of one trial, measured and predicted by models that were fitted without it.

    Attributes
    ----------
    label, operating_point : str
    is_idle : bool
    measured : dict of str to ndarray, shape (n_points,)
        By channel, those that were measured; over the crank angle, up to the highest harmonic that is compared.
    predicted : dict of str to dict
        The same by model ("nominal", "retuned", "with_effect").
    scatter : dict of str to float
        Standard uncertainty of the mean stroke, root mean square over the crank angle; what harder or softer wood
        does within the trial is taken out, as its mean is fitted.
    """

    label: str
    operating_point: str
    is_idle: bool
    measured: dict[str, Floats]
    predicted: dict[str, dict[str, Floats]]
    scatter: dict[str, float]

    def error(self, model: str, channel: str) -> Floats:
        """Measured minus predicted, shape (n_points,)."""
        return self.measured[channel] - self.predicted[model][channel]


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelGap:
    """The ladder in units.

    Attributes
    ----------
    by_channel : dict of str to (Rungs, unit)
        Root mean square of measured minus predicted mean stroke, over all operating points.
    cycles : tuple of Cycle
    runtime_s : dict of str to float
        "nominal", "retuned", "with_effect", "measured"; empty where it cannot be said.
    runtime_of : str
        Operating point whose runtime it is.
    warnings : tuple of str
    """

    by_channel: dict[str, tuple[Rungs, str]]
    cycles: tuple[Cycle, ...]
    runtime_s: dict[str, float]
    runtime_of: str
    warnings: tuple[str, ...]

    def harm(self, unseen: Collection[str] = ()) -> Floats:
        """What the cause adds to the squared error of the re-tuned model, as a share of that or of the noise.

        In squares over the noise of each channel, summed. Points that no model was fitted to are missed by several
        times the noise: a few per cent more of that say nothing.

        Parameters
        ----------
        unseen : collection of str
            Channels whose equation could not be evaluated: no model was fitted to them.

        Returns
        -------
        ndarray, shape (n_points,)
            By operating point.
        """
        known = {name: r for name, (r, _) in self.by_channel.items() if r.noise_floor > 0.0 and name not in unseen}
        before = sum(max((rungs.retuned / rungs.noise_floor) ** 2, 1.0) for rungs in known.values())
        added = {
            cycle.label: sum(
                float(np.mean(cycle.error("with_effect", name) ** 2 - cycle.error("retuned", name) ** 2))
                / rungs.noise_floor**2
                for name, rungs in known.items()
                if name in cycle.measured
            )
            for cycle in self.cycles
        }
        by_point = _by_point(self.cycles, added)
        return np.array(list(by_point.values())) / (max(before, 1.0) * len(by_point))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Strokes:
    """The mean stroke of one trial, and what each model predicts of it."""

    stroke: State
    found: dict[str, Prediction]

    @property
    def unsettled(self) -> list[str]:
        """Models that find no steady stroke."""
        return [name for name, prediction in self.found.items() if not prediction.is_settled]


def forecast(hold_out: HoldOut, ladder: Ladder, forms: Sequence[Sequence[Column]]) -> ChannelGap | None:
    """Predict every trial with the models that were fitted without its operating point.

    Parameters
    ----------
    hold_out : HoldOut
    ladder : Ladder
        Of the cause.
    forms : sequence of sequence of Column
        For each alternative of the ladder, the columns it was made of, one an effect; empty where there is no cause.

    Returns
    -------
    ChannelGap or None
        None for a plant whose equations do not close to a periodic stroke of battery, motor and blade, and where
        no trial has a crank angle.
    """
    problem = hold_out.problem
    baseline = problem.campaign.baseline
    if not isinstance(baseline, Baseline) or problem.campaign.angle_is_assumed:
        return None
    running = [part for part in problem.parts if part.state.kind == "running"]

    def models(part: Part) -> dict[str, list[Term]]:
        return _models(hold_out, ladder.fits[hold_out.group_of(part)], forms)

    def strokes(part: Part) -> _Strokes:
        stroke = mean_stroke(part.state)
        return _Strokes(stroke=stroke, found=_predict_all(baseline, stroke, models(part)))

    predicted = list(zip(running, on_two_cores(strokes, running), strict=True))
    settled = [(part, found) for part, found in predicted if not found.unsettled]
    cycles = tuple(_cycle(baseline, part, found) for part, found in settled)
    warnings = []
    if len(settled) < len(predicted):
        names = [f"{part.setting.label} ({', '.join(f.unsettled)})" for part, f in predicted if f.unsettled]
        warnings.append(f"the model finds no steady stroke at {'; '.join(names)}: not in the gap by channel")
    runtime, where, problems = _runtime(baseline, settled, models)
    return ChannelGap(
        by_channel=_by_channel(cycles), cycles=cycles, runtime_s=runtime, runtime_of=where,
        warnings=(*warnings, *problems),
    )  # fmt: skip


def _models(hold_out: HoldOut, fit: Fit, forms: Sequence[Sequence[Column]]) -> dict[str, list[Term]]:
    """Terms of the three models, from what was fitted."""
    problem = hold_out.problem
    baseline = problem.campaign.baseline
    of_batteries = further_batteries(baseline, [part.setting for part in problem.parts])
    known = {n.name: n for n in (*problem.campaign.plant.nuisances(), *of_batteries)}
    width = hold_out.scale * problem.prior_std
    effects: list[Term] = []
    amplitudes = list(fit.amplitudes)
    for column in forms[fit.alternative] if forms else ():
        size = column.effect.strength.typical * column.effect.strength.high
        count = column.columns.shape[1]
        taken, amplitudes = size * np.array(amplitudes[:count]), amplitudes[count:]
        effects.append(Term(amplitude=1.0, signature=lambda s, c=column, a=taken: c.combined(baseline, s, a)))

    seen = SeenCurve.of([part.state for part in problem.parts])

    def signature(nuisance: Nuisance) -> Callable[[State], Signature]:
        if nuisance.is_curve:
            return lambda state: nuisance.signature(baseline, seen.within(state))
        return lambda state: nuisance.signature(baseline, state)

    def nuisances(values: Floats) -> list[Term]:
        sized = [
            (known[name], float(value * unit))
            for name, value, unit in zip(problem.names, values, width, strict=True)
            if name in known
        ]
        filters = [(size, nuisance.transfer) for nuisance, size in sized if nuisance.transfer is not None]
        others = [(nuisance, size) for nuisance, size in sized if nuisance.transfer is None]
        terms = [Term(amplitude=size, signature=signature(nuisance)) for nuisance, size in others]
        by_filters = partial(filtered(filters), baseline)
        return [*terms, Term(amplitude=1.0, signature=by_filters)] if filters else terms

    return {"nominal": [], "retuned": nuisances(fit.retuned), "with_effect": [*nuisances(fit.nuisances), *effects]}


def _predict_all(baseline: Baseline, stroke: State, models: dict[str, list[Term]]) -> dict[str, Prediction]:
    found: dict[str, Prediction] = {}
    last: Prediction | None = None
    for name, terms in models.items():
        found[name] = predict(baseline, stroke, terms, start=last)
        last = found[name] if found[name].is_settled else last
    return found


def _cycle(baseline: Baseline, part: Part, strokes: _Strokes) -> Cycle:
    """Mean stroke of a trial as far as models are fitted to it: up to the highest harmonic compared and resolved.

    What a form goes on to do beyond that was compared with nothing.
    """
    state, measured, scatter = part.state, {}, {}
    explained = _explained(baseline, state)
    predicted: dict[str, dict[str, Floats]] = {name: {} for name in strokes.found}
    compared = max(part.layout.n_harmonics[equation] for equation in part.layout.equations)
    for channel, attribute, _ in CHANNELS:
        units = getattr(state, attribute)
        if units is None:
            continue
        highest = int(min(compared, state.resolved_orders.get(attribute, np.inf)))
        measured[channel] = up_to_harmonic(getattr(strokes.stroke, attribute)[0], highest)
        scatter[channel] = _std_of_mean(up_to_harmonic(units, highest), explained)
        for name, prediction in strokes.found.items():
            predicted[name][channel] = up_to_harmonic(getattr(prediction.state, attribute)[0], highest)
    return Cycle(
        label=state.setting.label, operating_point=state.setting.operating_point, is_idle=state.setting.is_idle,
        measured=measured, predicted=predicted, scatter=scatter,
    )  # fmt: skip


def _explained(baseline: Baseline, state: State) -> Floats:
    """What units of a trial differ by without being noise, shape (n_units, k).

    A straight line in time, and the cutting coefficient in this unit and in the one before: its mean is fitted, and the
    machine follows it with a lag.
    """
    n = len(state.speed_rad_s)
    columns = [np.ones(n), np.arange(n) - 0.5 * (n - 1)]
    if state.force_n is not None and not state.setting.is_idle:
        work = np.sum(state.force_n * baseline.cutting_speed(state), axis=1)
        columns += [work - work.mean(), np.concatenate([[0.0], work[:-1] - work.mean()])]
    return np.array(columns).T


def _std_of_mean(units: Floats, explained: Floats) -> float:
    """Standard uncertainty of the mean of rows about what is explained, with their autocorrelation."""
    n = len(units)
    free = n - explained.shape[1]
    if free < 2:
        return 0.0
    rest = units - explained @ np.linalg.lstsq(explained, units, rcond=None)[0]
    variance = float(np.sum(rest**2)) / free / units.shape[1]
    if variance <= 0.0:
        return 0.0
    neighbours = float(np.sum(rest[1:] * rest[:-1]) / np.sum(rest**2))
    rho = float(np.clip(neighbours, 0.0, SETTINGS.ladder.most_autocorrelation))
    return float(np.sqrt(variance / n * (1.0 + rho) / (1.0 - rho)))


def _by_channel(cycles: Sequence[Cycle]) -> dict[str, tuple[Rungs, str]]:
    out = {}
    for channel, _, unit in CHANNELS:
        having = [c for c in cycles if channel in c.measured]
        if not having:
            continue
        errors = {name: {c.label: c.error(name, channel) for c in having} for name in MODELS}
        squares = {
            name: _over_points(having, {label: float(np.mean(e**2)) for label, e in by_label.items()})
            for name, by_label in errors.items()
        }
        within = _over_points(having, {c.label: c.scatter[channel] ** 2 for c in having})
        squares["noise_floor"] = max(within, _between(having, errors["with_effect"]))
        out[channel] = (Rungs(**{name: float(np.sqrt(squares[name])) for name in RUNGS}), unit)
    return out


def _by_point(cycles: Sequence[Cycle], values: Mapping[str, float]) -> dict[str, float]:
    """Mean over the repeats of each operating point."""
    points: dict[str, list[float]] = {}
    for cycle in cycles:
        points.setdefault(cycle.operating_point, []).append(values[cycle.label])
    return {point: float(np.mean(repeats)) for point, repeats in points.items()}


def _over_points(cycles: Sequence[Cycle], values: Mapping[str, float]) -> float:
    """Mean over operating points of the mean over their repeats."""
    return float(np.mean(list(_by_point(cycles, values).values())))


def _between(cycles: Sequence[Cycle], errors: dict[str, Floats]) -> float:
    """Variance among repeats of one operating point, pooled; 0 where nothing was repeated."""
    points: dict[str, list[Floats]] = {}
    for cycle in cycles:
        points.setdefault(cycle.operating_point, []).append(errors[cycle.label])
    total, free = 0.0, 0
    for repeats in points.values():
        if len(repeats) > 1:
            deviation = np.array(repeats) - np.mean(repeats, axis=0)
            total += float(np.mean(deviation**2) * len(repeats))
            free += len(repeats) - 1
    return total / free if free else 0.0


def _runtime(
    baseline: Baseline, settled: Sequence[tuple[Part, _Strokes]], models: Callable[[Part], dict[str, list[Term]]]
) -> tuple[dict[str, float], str, list[str]]:
    """How long a full battery lasts at the operating point of the longest cutting trial.

    Integral of the charge over the predicted mean battery current, at three states of charge (Gauss). "Measured" is
    the nominal course scaled by the current that the trial drew.
    """
    battery = baseline.battery
    cutting = [(part, strokes) for part, strokes in settled if not part.setting.is_idle]
    if battery is None:
        return {}, "", ["no runtime: the configuration has no battery"]
    if not cutting:
        return {}, "", ["no runtime: no trial cuts"]
    part, strokes = max(cutting, key=lambda one: _seconds(one[0].state))
    stroke, found, terms = strokes.stroke, strokes.found, models(part)
    if stroke.battery_current_a is None:
        return {}, "", [f"no runtime: battery_current_a is missing in {part.setting.label}"]
    usable_as = 3600.0 * battery.capacity_ah * (1.0 - battery.cutoff_soc)

    def runtime_s(name: str) -> float:
        times, near = [], found[name]
        for node in 0.5 * (_RUNTIME_NODES + 1.0):
            there = replace(stroke, charge_used_as=np.full((1, 1), node * usable_as))
            near = predict(baseline, there, terms[name], wood_n_s_per_m=found[name].wood_n_s_per_m, start=near)
            current_a = _mean_over_time(near.state)
            if not near.is_settled or current_a <= 0.0:
                return float("nan")
            times.append(usable_as / current_a)
        return float(np.dot(0.5 * _RUNTIME_WEIGHTS, times))

    runtime: dict[str, float] = dict(zip(MODELS, on_two_cores(runtime_s, MODELS), strict=True))
    if any(np.isnan(seconds) for seconds in runtime.values()):
        return {}, "", ["no runtime: the model does not run to the end of the battery's charge"]
    drawn_a = _mean_over_time(stroke)
    if drawn_a <= 0.0:
        return {}, "", [f"no runtime: {part.setting.label} draws no battery current"]
    runtime["measured"] = runtime["nominal"] * _mean_over_time(found["nominal"].state) / drawn_a
    return runtime, part.setting.operating_point, []


def _seconds(state: State) -> float:
    return float(np.sum(state.n_strokes * np.mean(2.0 * np.pi / state.speed_rad_s, axis=1)))


def _mean_over_time(stroke: State) -> float:
    """Mean battery current over the time of a stroke, not over its angle."""
    assert stroke.battery_current_a is not None
    slowness = 1.0 / stroke.speed_rad_s
    return float(np.sum(stroke.battery_current_a * slowness) / np.sum(slowness))
