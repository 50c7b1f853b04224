"""What each fitted number of the diagnosis is held to, apart from any report: a principle that half and twice break.

    python -m tests.rigs.principles

prints for every fitted number the principle, the quantity that it bounds, and that quantity with the number as it is,
with half of it and with twice of it. Where a principle rests on campaigns, these are development campaigns (seeds 1 to
999, `development_evidence.json`, written by `benchmarks.calibrate_diagnosis sample`).
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from sawbench.bench.config import PlantConfig
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.evidence import Column, Explanation
from sawbench.diagnosis.inference.form_error import form_modes
from sawbench.diagnosis.inference.hypothesis import AND, OTHERS, named
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Marginal, build_problem
from sawbench.diagnosis.inference.settings import SETTINGS, Settings
from sawbench.diagnosis.inference.stroke_evidence import StrokesSay, with_strokes
from sawbench.diagnosis.inference.weighing import weigh
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.diagnosis.screening import doubted_duties
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME, EFFECTS
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import TWO_PI, State, TrialSetting

from benchmarks.calibrate_diagnosis import log_loss, truth

_DEVELOPMENT = Path(__file__).parents[1] / "diagnosis" / "development_evidence.json"


@dataclass(frozen=True, kw_only=True, slots=True)
class Principle:
    """What a fitted number must keep.

    Attributes
    ----------
    number : str
        "topic.number" of `Settings`.
    says : str
    value : callable
        Settings -> the quantity that it bounds.
    low, high : float
    """

    number: str
    says: str
    value: Callable[[Settings], float]
    low: float
    high: float

    def holds(self, settings: Settings) -> bool:
        """Whether the quantity lies within its bounds."""
        return self.low <= self.value(settings) <= self.high


@cache
def development() -> tuple[dict, ...]:
    """Evidence of development campaigns."""
    return tuple(json.loads(_DEVELOPMENT.read_text(encoding="utf-8")))


# --- the weighing ---------------------------------------------------------------------------------------------------


def _probabilities(settings: Settings, evidence: dict[str, float], left: dict[str, float], shared: float = 1.0):
    hypotheses = [
        named(name, value, left_over=left.get(name, settings.weights.quiet), shared=shared)
        for name, value in evidence.items()
    ]
    weighed = weigh(hypotheses, n_effects=len(EFFECTS), quiet=settings.weights.quiet, weights=settings.weights)
    return {h.name: h.probability for h in weighed}


def _even(odds: Callable[[float], float], low: float, high: float) -> float:
    """Where rising log odds pass zero, by bisection."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if odds(middle) > 0.0 else (middle, high)
    return middle


def _worse(settings: Settings) -> float:
    """Mean loss of log probability on development campaigns against the numbers as they stand."""
    rows = list(development())
    return log_loss(rows, settings.weights) - log_loss(rows, SETTINGS.weights)


def _five_sigma(settings: Settings) -> float:
    """Odds of "parameters" against "no_gap" where one number, known to 1 sigma beforehand, is surely off by 5."""
    wide = settings.noise.wide
    evidence = (-0.5 * (5.0 / wide) ** 2 - np.log(wide)) - (-0.5 * 5.0**2)
    found = _probabilities(settings, {"no_gap": 0.0, "parameters": float(evidence), "unknown": -1e3}, {})
    return found["parameters"] / found["no_gap"]


def _named_to_unnamed(settings: Settings) -> float:
    """Odds of all causes of the catalogue against an unnamed one, before anything was measured."""
    evidence = dict.fromkeys(("no_gap", "parameters", "unknown", *EFFECT_BY_NAME), 0.0)
    found = _probabilities(settings, evidence, {})
    return sum(found[name] for name in EFFECT_BY_NAME) / found["unknown"]


def _left_by_intact(settings: Settings) -> float:
    """Median of what intact benches leave, over what is held for quiet."""
    return float(np.median([r["left_over"]["no_gap"] for r in development() if r["kind"] == "none"])) / (
        settings.weights.quiet
    )


def _nothing_left(settings: Settings) -> float:
    """Share of campaigns in which the right cause leaves no share of the gap."""
    rows = [r for r in development() if r["kind"] in ("effect", "pair")]
    weights = settings.weights
    least = weights.left_by_an_intact_machine
    return float(np.mean([r["left_over"][truth(r)] <= least * max(weights.quiet, r["quiet"]) for r in rows]))


def _second_log_odds(settings: Settings, added: float, first: float, shared: float) -> float:
    """Log odds of two effects against the first alone."""
    evidence = {"no_gap": 0.0, "parameters": 0.0, "unknown": -1e4, "edge_force": first, "blade_wear": 0.0}
    pair = "blade_wear + edge_force"
    found = _probabilities(settings, evidence | {pair: first + added}, {"no_gap": 10.0}, shared)
    return float(np.log(found[pair] / found["edge_force"]))


def _even_second(settings: Settings, first: float, shared: float) -> float:
    """Log evidence that a second effect must add to be as likely there as not."""
    return _even(lambda added: _second_log_odds(settings, added, first, shared), 0.0, 1e3)


def _price_of_choice(settings: Settings) -> float:
    """The same where the first one's form plays no part, over that of a choice among all other effects."""
    return _even_second(settings, 500.0, 0.0) / (SETTINGS.weights.temperature * np.log(len(EFFECTS) - 1))


def _price_of_form(settings: Settings) -> float:
    """What more it must add where the first has a log evidence of 1000 nats, over the scatter of that."""
    return (_even_second(settings, 1000.0, 1.0) - _even_second(settings, 1000.0, 0.0)) / np.sqrt(2.0 * 1000.0)


def _clear_second(settings: Settings) -> float:
    """Probability of a second effect that adds three times the evidence at which it is even."""
    even = _even_second(settings, 500.0, 0.0)
    return float(1.0 / (1.0 + np.exp(-_second_log_odds(settings, 3.0 * even, 500.0, 0.0))))


def _misjudged(settings: Settings) -> float:
    """Development campaigns in which a second effect that is there stays below even, or one that is not passes it."""
    wrong, w = 0, settings.weights
    for row in development():
        if row["kind"] not in ("effect", "pair"):
            continue
        evidence, right = row["log_evidence"], truth(row)
        first = max(right.split(AND), key=lambda name: evidence[name])
        alone = evidence[first]
        for name, value in evidence.items():
            if AND in name and first in name.split(AND):
                even = w.pair_least + w.pair_share * np.sqrt(row["shared"].get(name, 1.0) * alone)
                wrong += (value - alone > even) != (name == right) and (name == right or row["kind"] == "effect")
    return float(wrong)


def _even_share(settings: Settings) -> float:
    """Share of the gap that a sure effect may leave before "unknown" is as likely."""

    def odds(share: float) -> float:
        evidence = {"no_gap": 0.0, "parameters": 0.0, "unknown": -1e4, "edge_force": 1e3}
        left = {"edge_force": share * 100.0, "no_gap": 100.0, "parameters": 100.0}
        found = _probabilities(settings, evidence, left)
        return float(np.log(found["unknown"] / found["edge_force"]))

    return _even(odds, 0.01, 0.99)


# --- single strokes -------------------------------------------------------------------------------------------------


def _with_trend(settings: Settings, nats: float) -> float:
    """Log odds of a worn blade against no gap where the evidence is in single strokes alone."""
    said = StrokesSay(
        effect=EFFECT_BY_NAME["blade_wear"], alone=nats, beside_cutting=nats, size=0.1, size_std=0.01, is_whole=True
    )
    none = [named(other, -1e3 if other == "unknown" else 0.0, left_over=settings.weights.quiet) for other in OTHERS]
    alone = named("blade_wear", 0.0, left_over=settings.weights.quiet)
    joined = with_strokes([*none, alone], said, EFFECT_BY_NAME, settings)
    found = weigh(joined, n_effects=len(EFFECTS), quiet=settings.weights.quiet, weights=settings.weights)
    by_name = {h.name: h.probability for h in found}
    return float(np.log(by_name["blade_wear"] / by_name["no_gap"]))


def _worth_of_a_nat(settings: Settings) -> float:
    """Log odds that one nat of the strokes' likelihood, which is that of their own scatter, is worth."""
    return 0.1 * (_with_trend(settings, 20.0) - _with_trend(settings, 10.0))


def _false_trends(settings: Settings) -> float:
    """Largest share of woods without a trend in which one is as likely as none (Markov: exp(-nats))."""
    return float(np.exp(-_even(lambda nats: _with_trend(settings, nats), 0.0, 30.0)))


# --- the noise, and what forms miss, on strokes of constant speed -----------------------------------------------------

_N_POINTS, _N_UNITS, _STROKES_A_UNIT, _RATE_HZ = 128, 24, 16, 13.0
_K_N_S_PER_M = 240.0


def _baseline() -> Baseline:
    plant = PlantConfig.model_validate(
        {
            "resistance_ohm": 0.176, "inductance_h": 0.00321, "back_emf_constant_v_s_per_rad": 0.007383,
            "torque_constant_n_m_per_a": 0.005632, "rotor_inertia_kg_m2": 2.4e-05, "yoke_inertia_kg_m2": 2.38e-05,
            "reciprocating_mass_kg": 0.239, "crank_radius_m": 0.01, "motor_damping_n_m_s_per_rad": 3.4274e-06,
            "gear_ratio": 9.333333333333334,
        }
    )  # fmt: skip
    return Baseline(plant=plant, battery=None, cutting_sign=-1)


def _remembering_wood(n: int, memory: float, rng: np.random.Generator) -> np.ndarray:
    """Hardness of strokes about 1, each remembering the one before."""
    hardness = rng.standard_normal(n)
    for k in range(1, n):
        hardness[k] = memory * hardness[k - 1] + np.sqrt(1.0 - memory**2) * hardness[k]
    return 1.0 + 0.2 * hardness


def _trial(index: int, hardness: np.ndarray, noise_n: float, rng: np.random.Generator) -> State:
    """One trial at constant speed whose force alone was measured, averaged over units."""
    shape = (_N_UNITS, _N_POINTS)
    angle = np.broadcast_to((np.arange(_N_POINTS) + 0.5) * TWO_PI / _N_POINTS, shape)
    speed = np.full(shape, TWO_PI * _RATE_HZ)
    into_wood = np.maximum(-0.01 * speed * np.sin(angle), 0.0)
    units = hardness.reshape(_N_UNITS, _STROKES_A_UNIT).mean(axis=1, keepdims=True)
    force = _K_N_S_PER_M * units * into_wood + noise_n * rng.standard_normal(shape) / np.sqrt(_STROKES_A_UNIT)
    at_s = (np.arange(_N_UNITS)[:, None] + 0.5) * _STROKES_A_UNIT / _RATE_HZ
    setting = TrialSetting(
        label=f"t{index}", index=index, duty=0.44, is_idle=False, stock="oak", feed_m_s=0.004, thickness_m=0.02,
        operating_point="duty 0.44", session_s=120.0 * index,
    )  # fmt: skip
    zeros = np.zeros((_N_UNITS, 1))
    return State(
        kind="running", setting=setting, angle_rad=angle, speed_rad_s=speed, acceleration_rad_s2=np.zeros(shape),
        current_a=None, current_rate_a_s=None, force_n=force, force_rate_n_s=None, battery_voltage_v=None,
        battery_current_a=None, motor_voltage_v=np.zeros(shape), time_s=at_s, cut_distance_m=zeros,
        charge_used_as=zeros, k_guess_n_s_per_m=_K_N_S_PER_M, peak_force_n=200.0,
        n_strokes=np.full(_N_UNITS, float(_STROKES_A_UNIT)),
    )  # fmt: skip


def _problem(settings: Settings, *, memory: float, noise_n: float, seed: int) -> LinearProblem:
    rng = np.random.default_rng(seed)
    n_strokes = _N_UNITS * _STROKES_A_UNIT
    states = tuple(_trial(k, _remembering_wood(n_strokes, memory, rng), noise_n, rng) for k in range(12))
    campaign = Campaign(plant=Jigsaw(baseline=_baseline()), states=states, k_guess_n_s_per_m={}, warnings=())
    return build_problem(campaign, settings=settings)


def _block_variance(settings: Settings) -> float:
    """Variance of a block's mean force over the stated one, for wood that remembers eight strokes in ten."""
    found = []
    for seed in range(6):
        problem = _problem(settings, memory=0.8, noise_n=0.5, seed=seed)
        for part in problem.parts:
            whitened = problem.data[part.place].reshape(-1, part.layout.size)
            # Hardness is one direction: that of the mean stroke, whitened.
            direction = part.whitener @ part.layout.place({"cutting": part.state.force_n.mean(axis=0)[None]}, 1)[0]
            found.append(whitened @ direction / np.linalg.norm(direction))
    return float(np.var(np.array(found)))


def _quiet_over_left(settings: Settings) -> float:
    """What is held for quiet on a noisy bench, over what noise alone leaves there."""
    loud = [_problem(settings, memory=0.0, noise_n=8.0, seed=seed) for seed in range(3)]
    return float(np.mean([p.quiet / (Marginal(p).misfit / len(p.data)) for p in loud]))


def _form_problem(settings: Settings) -> tuple[LinearProblem, np.ndarray, np.ndarray]:
    """A problem, a force at the seventh harmonic, and the same turned by a right angle."""
    problem = _problem(settings, memory=0.0, noise_n=0.5, seed=1)
    plain, turned = (
        problem.project(lambda s, wave=wave: {"cutting": wave(7.0 * s.angle_rad)}) for wave in (np.cos, np.sin)
    )
    return problem, plain, turned


def _along(modes: np.ndarray, direction: np.ndarray) -> np.ndarray:
    return modes.T @ direction / float(direction @ direction)


def _turned_rad(settings: Settings) -> float:
    """How far the form of an effect may turn a harmonic at most, over what a corner of twice the frequency turns."""
    problem, plain, turned = _form_problem(settings)
    largest = settings.forms.shares[-1] * np.linalg.norm(_along(form_modes(problem, plain), turned))
    return float(largest / (np.arctan(np.sqrt(2.0)) - np.arctan(np.sqrt(0.5))))


def _steady_drift(settings: Settings) -> float:
    """Relative change from first to last trial that a steady effect has, where forms miss a tenth: one sigma."""
    problem, plain, _ = _form_problem(settings)
    modes = form_modes(problem, plain, in_time=False)
    first, last = problem.parts[0].place, problem.parts[-1].place
    change = _along(modes[last], plain[last]) - _along(modes[first], plain[first])
    return 0.1 * float(np.linalg.norm(change))


def _size_temperature(settings: Settings) -> float:
    """Variance of a stated size over that of least squares, by how much the temperature raises that of a cause."""
    effect = EFFECT_BY_NAME["guide_friction"]
    column = Column(effect=effect, shape=effect.shapes[0], columns=np.ones((3, 1)))
    size = Explanation(
        effect=effect, log_evidence=1.0, column=column, amplitude=1.0, amplitude_std=0.01, gain=1.0,
        contribution=np.ones(3), size_temperature=settings.forms.size_temperature,
    )  # fmt: skip
    return float((size.strength_std / (0.01 * size.strength)) ** 2 / SETTINGS.weights.temperature)


def _found_slip(settings: Settings) -> float:
    """Smallest slip of one duty of 24 that is found where all other trials are exact."""
    stated = np.tile([0.375, 0.4375, 0.5, 0.5625], 6)
    asked, current = 0.9 * stated, np.linspace(4.0, 9.0, len(stated))
    least = SETTINGS.screening.duty_deviation

    def is_found(slip: float) -> float:
        wrong = stated.copy()
        wrong[10] += slip
        # The peak of the start-up goes with the true duty.
        numbers = settings.screening
        return 1.0 if np.isfinite(doubted_duties(wrong, asked, current, 100.0 * stated, numbers)[10]) else -1.0

    return _even(is_found, 0.1 * least, 10.0 * least)


def _five(number: str) -> Principle:
    return Principle(
        number=number, says="a parameter five of its sigmas off is called so, at odds of about ten to one",
        value=_five_sigma, low=7.0, high=15.0,
    )  # fmt: skip


PRINCIPLES = (
    Principle(
        number="weights.temperature", says="log loss on development campaigns is least near it", value=_worse,
        low=-np.inf, high=0.0,
    ),
    Principle(
        number="weights.open_gain", says="log loss on development campaigns is least near it", value=_worse,
        low=-np.inf, high=0.0,
    ),
    Principle(
        number="weights.quiet", says="an intact machine leaves at least half of what is held for quiet, and no more",
        value=_left_by_intact, low=0.5, high=1.0,
    ),
    Principle(
        number="weights.left_by_an_intact_machine",
        says="most right causes leave no share of the gap; those whose form misses do", value=_nothing_left, low=0.7,
        high=0.9,
    ),
    Principle(
        number="weights.pair_gain", says="three times the even evidence makes a second effect likely, not certain",
        value=_clear_second, low=0.75, high=0.9,
    ),
    Principle(
        number="weights.pair_least", says="a second effect pays for the choice among all others: T log 28",
        value=_price_of_choice, low=2.0 / 3.0, high=1.5,
    ),
    Principle(
        number="weights.pair_least", says="on development campaigns no second effect is misjudged", value=_misjudged,
        low=0.0, high=0.0,
    ),
    Principle(
        number="weights.pair_share",
        says="and for half a standard deviation, sqrt(2 L), of the first one's log evidence", value=_price_of_form,
        low=1.0 / 3.0, high=3.0 / 4.0,
    ),
    Principle(
        number="weights.open_share", says="a cause that leaves a third of the gap is believed, one that leaves two not",
        value=_even_share, low=1.0 / 3.0, high=2.0 / 3.0,
    ),
    _five("weights.prior_no_gap"),
    _five("weights.prior_parameters"),
    Principle(
        number="weights.prior_unknown",
        says="for each cause that the catalogue does not hold, three to nine that it does",
        value=_named_to_unnamed, low=3.0, high=9.0,
    ),
    Principle(
        number="noise.correlation_factor", says="blocks of a wood that remembers scatter as stated",
        value=_block_variance, low=0.75, high=1.5,
    ),
    Principle(
        number="noise.quiet_share", says="noise alone stays below what is held for quiet, and not far below",
        value=_quiet_over_left, low=1.0, high=2.0,
    ),
    Principle(
        number="forms.steady_share", says="an effect that knows no time changes by 2 to 5 % over a session",
        value=_steady_drift, low=0.02, high=0.05,
    ),
    Principle(
        number="forms.harmonic_factor",
        says="another filter turns a harmonic as far as a corner of twice the frequency", value=_turned_rad,
        low=2.0 / 3.0, high=1.5,
    ),
    Principle(
        number="forms.size_temperature", says="sizes miss by more than causes: about twice the variance",
        value=_size_temperature, low=1.5, high=3.0,
    ),
    Principle(
        number="strokes.weight", says="a nat of the strokes' own likelihood counts about one nat",
        value=_worth_of_a_nat, low=0.75, high=1.5,
    ),
    Principle(
        number="strokes.price", says="one wood in a hundred without a trend may be called worn: 0.5 to 2 %",
        value=_false_trends, low=0.005, high=0.02,
    ),
    Principle(
        number="screening.duty_deviation",
        says="a duty that is stated one sixteenth off is found, and nothing is looked for below a thirtieth",
        value=_found_slip, low=1.0 / 30.0, high=1.0 / 16.0,
    ),
)  # fmt: skip


def table() -> str:
    """For every principle its quantity with the number as it is, half and twice."""
    lines = [f"{'number':34} {'bounds':>18}  {'as it is':>9} {'half':>9} {'twice':>9}  principle"]
    for p in PRINCIPLES:
        values = [p.value(SETTINGS), *(p.value(SETTINGS.moved(p.number, factor)) for factor in (0.5, 2.0))]
        bounds = f"{p.low:.3g} to {p.high:.3g}"
        lines.append(f"{p.number:34} {bounds:>18}  {' '.join(f'{v:9.4g}' for v in values)}  {p.says}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(table() + "\n")
