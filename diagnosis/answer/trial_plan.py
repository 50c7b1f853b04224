"""Which trials next: those that raise the expected probability of the right answer most for the time they take.

Were hypothesis h right, a trial would add to the log odds of h against r half the whitened square of what of h's
signature neither r, of any magnitude, in any of its forms and with their model discrepancy, nor re-tuned parameters,
nor background effects can take up. All of these are linear, so one matrix of inner products a trial says it all;
what a trial does not share with the others (its piece of wood, its zero, its clocks) is integrated out of that matrix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sawbench.bench.recording import Floats, Trial
from sawbench.diagnosis.answer.candidate_trials import Candidate, candidates
from sawbench.diagnosis.inference.columns import Column, catalogue_columns, columns_in, little_of_each
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.form_error import form_modes
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.linear_problem import (
    FORM_OF_KNOWN,
    LinearProblem,
    Part,
    missed_by_form,
    zero_modes,
)
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.modeling.residuals import Baseline

_MOST_ANSWERS = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class Chosen:
    """A proposed trial.

    Attributes
    ----------
    trial : Candidate
    between : (str, str)
        Hypotheses that it tells apart most.
    log_odds : float
        That it adds between them on average.
    expected_probability : float
        Of the right answer after this trial and those before it, on average.
    minutes : float
        That it takes, with rest and handling.
    """

    trial: Candidate
    between: tuple[str, str]
    log_odds: float
    expected_probability: float
    minutes: float


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialPlan:
    """What to run next.

    Attributes
    ----------
    chosen : tuple of Chosen
        In their order; empty where no trial is worth its while.
    considered : tuple of (str, float)
        Hypotheses that are told apart, with their probabilities.
    expected_probability : float
        Of the right answer as things are.
    inseparable : tuple of (str, str, float)
        Pairs of causes between which no single trial adds the least log odds, and what the best one adds.
    n_candidates : int
    """

    chosen: tuple[Chosen, ...]
    considered: tuple[tuple[str, float], ...]
    expected_probability: float
    inseparable: tuple[tuple[str, str, float], ...]
    n_candidates: int


def trial_plan(
    problem: LinearProblem, posterior: Posterior, n_trials: int, materials: Mapping[str, str]
) -> TrialPlan | None:
    """Propose the next trials, one after the other.

    Parameters
    ----------
    problem : LinearProblem
    posterior : Posterior
        Held to its predictions.
    n_trials : int
    materials : mapping of str to str
        Label of a trial -> its material.

    Returns
    -------
    TrialPlan or None
        None where no stroke can be predicted: no saw, or no crank angle.

    Notes
    -----
    Signatures are those of nominal strokes, and trials of one plan do not warm or wear each other. What single strokes
    alone show (wear, chip, grain) is not counted.
    """
    if not isinstance(problem.campaign.plant.model, Baseline) or problem.campaign.angle_is_assumed:
        return None
    answers = _considered(posterior, problem.settings.planning.least_probability)
    trials = candidates(problem, materials)
    campaign, each = _inner_products(problem, posterior, answers, trials)
    return _greedy(problem, answers, trials, campaign, each, n_trials)


def plan_report(problem: LinearProblem, posterior: Posterior, n_trials: int, trials: Sequence[Trial]) -> dict[str, Any]:
    """Plan as the report has it.

    Parameters
    ----------
    problem : LinearProblem
    posterior : Posterior
    n_trials : int
    trials : sequence of Trial
        Of the recordings.

    Returns
    -------
    dict
        "trials", with the keys of a planned trial of a series and what each is worth; "considered",
        "expected_probability", "inseparable", "least_log_odds", "n_candidates", and "reason" why nothing is proposed.
    """
    found = trial_plan(problem, posterior, n_trials, {t.trial_id: t.material for t in trials if t.material})
    least = problem.settings.report.worth
    if found is None:
        return {
            "trials": [],
            "reason": "without displacement no stroke can be predicted: record it, and diagnose again",
        }
    reason = "" if found.chosen else f"no single trial adds log odds of {least:g} between the remaining hypotheses"
    ended = problem.campaign.states[-1].setting.label
    last = next((t for t in trials if t.trial_id == ended), trials[-1])
    return {
        "trials": [_row(one, f"next-{len(trials) + k:02d}", last) for k, one in enumerate(found.chosen, start=1)],
        "reason": reason,
        "considered": [{"answer": name, "probability": p} for name, p in found.considered],
        "expected_probability": found.expected_probability,
        "inseparable": [{"causes": [one, other], "log_odds": worth} for one, other, worth in found.inseparable],
        "least_log_odds": least,
        "n_candidates": found.n_candidates,
    }


def _row(one: Chosen, name: str, last: Trial) -> dict[str, Any]:
    trial = one.trial
    return {
        "id": name, "material": trial.material, "duty": trial.duty, "feed_mm_s": trial.feed_mm_s,
        "thickness_mm": trial.thickness_mm, "seconds": trial.seconds, "rest_s": trial.rest_s, "blade": last.blade,
        "battery": last.battery, "is_new": trial.is_new, "minutes": one.minutes, "between": list(one.between),
        "log_odds": one.log_odds, "expected_probability": one.expected_probability,
    }  # fmt: skip


def _considered(posterior: Posterior, least: float) -> list[Hypothesis]:
    """Likeliest answers that predict something; two at least, one of which names effects."""
    known = [h for h in posterior.hypotheses if h.other != "unknown" and (not h.effects or h.members)]
    chosen = [h for h in known if h.probability > least][:_MOST_ANSWERS]
    chosen = chosen if len(chosen) > 1 else known[:2]
    return chosen if any(h.effects for h in chosen) else [chosen[0], next(h for h in known if h.effects)]


@dataclass(frozen=True, kw_only=True, slots=True)
class Products:
    """Inner products of whitened columns: nuisances first, then those that `truths` and `alternatives` count.

    Attributes
    ----------
    gram : ndarray, shape (q, q)
    n_nuisances : int
    truths : list of int or None
        Column of what each hypothesis adds; None where it adds nothing.
    missed : list of ndarray of int
        Columns for what the forms of each hypothesis may leave.
    alternatives : list of list of ndarray of int
        Columns of any size of each hypothesis, one entry for each combination of its forms.
    """

    gram: Floats
    n_nuisances: int
    truths: list[int | None]
    missed: list[np.ndarray]
    alternatives: list[list[np.ndarray]]

    def log_odds(self) -> Floats:
        """Expected log odds of every hypothesis, were it right, against every other one, shape (n, n)."""
        p, n = self.n_nuisances, len(self.truths)
        rest = _without(self.gram, np.arange(p))[p:, p:]
        found = np.zeros((n, n))
        for wrong, forms in enumerate(self.alternatives):
            own = np.concatenate([self.missed[wrong], *forms])
            right = [k for k in range(n) if k != wrong and self.truths[k] is not None]
            truths = [self.truths[k] for k in right]
            kept = np.array([*dict.fromkeys([*own.tolist(), *truths])], dtype=int)
            place = np.zeros(len(rest), dtype=int)
            place[kept] = np.arange(len(kept))
            left = _without(rest[np.ix_(kept, kept)], place[self.missed[wrong]])
            for k, truth in zip(right, truths, strict=True):
                found[k, wrong] = 0.5 * min(_left(left, int(place[truth]), place[form]) for form in forms)
        return found


def _without(gram: Floats, taken: np.ndarray) -> Floats:
    """Inner products of what columns of standard deviation 1, of the same matrix, leave."""
    from scipy.linalg import solve_triangular

    root = np.linalg.cholesky(np.eye(len(taken)) + gram[np.ix_(taken, taken)])
    half = solve_triangular(root, gram[taken], lower=True)
    return gram - half.T @ half


def _left(rest: Floats, truth: int, form: np.ndarray) -> float:
    """Square of one column that others, of standard deviation 1, leave."""
    inner = rest[form, truth]
    taken = inner @ np.linalg.solve(np.eye(len(form)) + rest[np.ix_(form, form)], inner)
    return max(float(rest[truth, truth] - taken), 0.0)


def _inner_products(
    problem: LinearProblem, posterior: Posterior, answers: Sequence[Hypothesis], trials: Sequence[Candidate]
) -> tuple[Products, list[Floats]]:
    """Inner products over the campaign, and what each candidate adds to them."""
    n = len(problem.data)
    wide, dispersion, local = _extended(problem, posterior.dispersion, trials)
    share = 1.0 / np.sqrt(dispersion)[:, None]
    members = {(h.name, m.effect.name): m for h in answers for m in h.members}
    columns = _every_form(wide, list(members.values()))
    fitted = {key: _contribution(m, columns[m.effect.name], n) for key, m in members.items()}
    small = little_of_each(wide, catalogue_columns(wide, problem.campaign.plant.effects))
    nuisances = [wide.nuisance, *(share * found for found in small.values())]
    extra, truths, missed, alternatives = _answers(wide, answers, columns, fitted)
    stacked = share * np.hstack([*nuisances, *extra])
    rows = np.cumsum([n, *(trial.n_rows for trial in trials)])
    each = []
    for start, stop, columns_of_trial in zip(rows[:-1], rows[1:], local, strict=True):
        part, own = stacked[start:stop], share[start:stop] * columns_of_trial
        inner = own.T @ part
        each.append(part.T @ part - inner.T @ np.linalg.solve(np.eye(own.shape[1]) + own.T @ own, inner))
    campaign = Products(
        gram=stacked[:n].T @ stacked[:n], n_nuisances=sum(found.shape[1] for found in nuisances), truths=truths,
        missed=missed, alternatives=alternatives,
    )  # fmt: skip
    return campaign, each


def _every_form(wide: LinearProblem, members: Sequence[Explanation]) -> dict[str, list[Column]]:
    """Columns of each effect in the forms of the catalogue, and in those between them that were found."""
    shapes: dict[str, list[dict[str, float]]] = {m.effect.name: list(m.effect.shapes) for m in members}
    for member in members:
        if member.column.shape not in shapes[member.effect.name]:
            shapes[member.effect.name].append(member.column.shape)
    effects = {m.effect.name: m.effect for m in members}
    return {name: columns_in(wide, effect, shapes[name]) for name, effect in effects.items()}


def _extended(
    problem: LinearProblem, dispersion: Floats, trials: Sequence[Candidate]
) -> tuple[LinearProblem, Floats, list[Floats]]:
    """The problem with the candidates behind its trials, its noise, and each candidate's own nuisance columns."""
    plant, start = problem.campaign.plant, len(problem.data)
    factor = {key: float(dispersion[rows[0]]) for key, rows in problem.rows_by_equation().items()}
    bare = problem.only(lambda name: not name.startswith(FORM_OF_KNOWN))
    names = list(bare.names)
    shared, noise, parts, local = [bare.nuisance], [dispersion], list(problem.parts), []
    for trial in trials:
        rows, own = _nuisances(problem, trial, names)
        shared.append(rows)
        local.append(own)
        for part in trial.parts:
            parts.append(replace(part, place=slice(start + part.place.start, start + part.place.stop)))
            noise.append(_noise_of(part, factor))
        start += trial.n_rows
    nothing = np.zeros(start - len(problem.data))
    wide = replace(
        bare, parts=tuple(parts), data=np.concatenate([problem.data, nothing]),
        known=np.concatenate([problem.known, nothing]), nuisance=np.concatenate(shared),
    )  # fmt: skip
    forms = [problem.settings.forms.screen_share * missed_by_form(wide, known) for known in plant.known]
    named = (f"{FORM_OF_KNOWN}{k}" for k in range(sum(found.shape[1] for found in forms)))
    nuisance = np.hstack([wide.nuisance, *forms])
    stds = np.concatenate([wide.prior_std, np.ones(nuisance.shape[1] - len(names))])
    return replace(wide, nuisance=nuisance, names=(*names, *named), prior_std=stds), np.concatenate(noise), local


def _noise_of(part: Part, factor: Mapping[Any, float]) -> Floats:
    row = np.ones(part.layout.size)
    for equation, place in part.layout.slices.items():
        row[place] = factor[(equation, part.state.kind)]
    return np.tile(row, len(part.blocks))


def _nuisances(problem: LinearProblem, trial: Candidate, names: Sequence[str]) -> tuple[Floats, Floats]:
    """Rows of the nuisances that a candidate shares with the campaign, and columns of its own."""
    plant, place = problem.campaign.plant, {name: k for k, name in enumerate(names)}
    std = dict(zip(problem.names, problem.prior_std, strict=True))
    shared, own = np.zeros((trial.n_rows, len(names))), []
    for nuisance in (*plant.nuisances(), *plant.trial_nuisances([part.state for part in trial.parts])):
        column = np.zeros(trial.n_rows)
        for part in trial.parts:
            found = nuisance.signature(plant.model, part.smooth)
            if any(equation in part.layout.equations for equation in found):
                column[part.place] = part.whiten(found)
        if nuisance.name in place:
            shared[:, place[nuisance.name]] = std[nuisance.name] * column
        else:
            own.append(nuisance.std * column)
    if problem.wander is not None:
        alone = replace(problem, parts=trial.parts, data=np.zeros(trial.n_rows))
        own += zero_modes(alone, problem.wander)
    return shared, np.array(own).reshape(-1, trial.n_rows).T


def _contribution(member: Explanation, columns: Sequence[Column], n: int) -> Floats:
    """What an effect adds at its fitted magnitude and form, over the campaign and all candidates."""
    same = next(column for column in columns if column.shape == member.column.shape)
    size, *_ = np.linalg.lstsq(same.columns[:n], member.contribution, rcond=None)
    return same.columns @ size


def _answers(
    wide: LinearProblem, answers: Sequence[Hypothesis], columns: Mapping[str, Sequence[Column]],
    fitted: Mapping[tuple[str, str], Floats],
) -> tuple[list[Floats], list[int | None], list[np.ndarray], list[list[np.ndarray]]]:  # fmt: skip
    """Columns of every hypothesis: what it adds if it is right, and what it may take up if it is wrong."""
    extra: list[Floats] = []
    truths: list[int | None] = []
    missed: list[np.ndarray] = []
    alternatives: list[list[np.ndarray]] = []
    share = wide.settings.forms.screen_share

    def placed(found: Floats) -> np.ndarray:
        start = sum(one.shape[1] for one in extra)
        extra.append(found)
        return np.arange(start, start + found.shape[1])

    for h in answers:
        truth = [fitted[h.name, m.effect.name] for m in h.members]
        truths.append(int(placed(np.sum(truth, axis=0)[:, None])[0]) if truth else None)
        modes = [form_modes(wide, wave) for m, wave in zip(h.members, truth, strict=True)]
        missed.append(placed(share * np.hstack(modes)) if modes else np.zeros(0, dtype=int))
        if h.other == "parameters":
            alternatives.append([placed(wide.nuisance * np.sqrt(wide.wide_scale**2 - 1.0))])
            continue
        shapes = {}
        for m in h.members:
            own = [(c.shape, placed(c.of_any_size)) for c in columns[m.effect.name]]
            best = next(place for shape, place in own if shape == m.column.shape)
            shapes[m.effect.name] = (best, [place for _, place in own])
        forms = []
        for name, (_, own) in shapes.items():
            others = [best for other, (best, _) in shapes.items() if other != name]
            forms += [np.concatenate([place, *others]) for place in own]
        alternatives.append(forms or [np.zeros(0, dtype=int)])
    return extra, truths, missed, alternatives


def _greedy(
    problem: LinearProblem, answers: Sequence[Hypothesis], trials: Sequence[Candidate], campaign: Products,
    each: Sequence[Floats], n_trials: int,
) -> TrialPlan:  # fmt: skip
    """Choose trial after trial, of those worth it the one that makes a wrong answer least probable for its time."""
    settings = problem.settings
    minutes = np.array([t.seconds + t.rest_s + settings.planning.handling_s for t in trials]) / 60.0
    probability = np.array([h.probability for h in answers])
    probability = probability / probability.sum()
    base = campaign.log_odds()

    def with_one_more(products: Products) -> list[Floats]:
        more = (replace(products, gram=products.gram + one).log_odds() for one in each)
        return [log_odds - base for log_odds in more]

    offered = with_one_more(campaign)
    most = np.max([np.zeros_like(base), *offered], axis=0)
    gained, products, chosen = np.zeros_like(base), campaign, []
    while trials and len(chosen) < n_trials:
        told_apart = [_told_apart(probability, gained, one) for one in offered]
        worth = np.array([one[pair] - gained[pair] for one, pair in zip(offered, told_apart, strict=True)])
        falls = np.array([_wrong(probability, gained) - _wrong(probability, one) for one in offered]) / minutes
        best = int(np.argmax(np.where(worth >= settings.report.worth, falls, -np.inf)))
        if worth[best] < settings.report.worth:
            break
        right, wrong = told_apart[best]
        chosen.append(
            Chosen(
                trial=trials[best], between=(answers[right].name, answers[wrong].name), log_odds=float(worth[best]),
                expected_probability=expected_probability(probability, offered[best]), minutes=float(minutes[best]),
            )
        )  # fmt: skip
        gained, products = offered[best], replace(products, gram=products.gram + each[best])
        offered = with_one_more(products) if len(chosen) < n_trials else offered
    return TrialPlan(
        chosen=tuple(chosen), considered=tuple((h.name, h.probability) for h in answers),
        expected_probability=expected_probability(probability, np.zeros_like(base)),
        inseparable=_inseparable(answers, most, settings.report.worth), n_candidates=len(trials),
    )  # fmt: skip


def expected_probability(probability: Floats, log_odds: Floats) -> float:
    """Probability of the right answer, on average over which one is right, once log odds were added.

    Parameters
    ----------
    probability : ndarray, shape (n,)
        Of each answer before.
    log_odds : ndarray, shape (n, n)
        Added to the odds of each answer, were it right, against each other one.

    Examples
    --------
    >>> round(expected_probability(np.array([0.5, 0.5]), np.log([[1.0, 9.0], [9.0, 1.0]])), 6)
    0.9
    """
    return 1.0 - _wrong(probability, log_odds)


def _wrong(probability: Floats, log_odds: Floats) -> float:
    """Probability of the wrong answers, on average; exact where it is tiny."""
    others = np.where(np.eye(len(probability), dtype=bool), 0.0, np.exp(-log_odds)) @ probability
    return float(np.sum(probability * others / (probability + others)))


def _told_apart(probability: Floats, before: Floats, after: Floats) -> tuple[int, int]:
    """Right and wrong answer of which a trial tells most."""
    n = len(probability)
    settled = probability[:, None] * probability * (np.exp(-before) - np.exp(-after))
    settled[np.eye(n, dtype=bool)] = -np.inf
    right, wrong = np.unravel_index(int(np.argmax(settled)), (n, n))
    return int(right), int(wrong)


def _inseparable(answers: Sequence[Hypothesis], most: Floats, least: float) -> tuple[tuple[str, str, float], ...]:
    """Causes that no candidate tells from the likeliest one, whichever of the two is right."""
    first = next(k for k, h in enumerate(answers) if h.effects)
    worth = {k: float(max(most[first, k], most[k, first])) for k, h in enumerate(answers) if h.effects and k != first}
    return tuple((answers[first].name, answers[k].name, log_odds) for k, log_odds in worth.items() if log_odds < least)
