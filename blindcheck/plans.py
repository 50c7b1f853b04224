"""Which trials a campaign holds: the plan of the paper's bench, or what any operator may do."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from sawbench.blindcheck.bench import Bench
from sawbench.blindcheck.draws import between
from sawbench.blindcheck.plant import MATERIALS

_MOST_ROWS = 1_500_000
_LEAST_TRIAL_S = 2.5
# Of a battery, what the trials up to a swap may draw by estimate.
_CHARGE_USED = 0.5


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialPlan:
    """Settings of one trial.

    Attributes
    ----------
    duty : float
    workpiece : str
    thickness_mm, feed_mm_s : float
    seconds : float
        From switching on to the end of the recording.
    rest_s : float
        Pause before the trial.
    late_s : float
        Time at rest that the operator lets pass beyond the usual fraction of a second.
    off_s : float
        Time before the end of the recording at which the tool is switched off.
    in_air_s, out_s : float
        Time that the tool runs before the blade goes into the wood, and after it has come out.
    battery : str
    """

    duty: float
    workpiece: str
    thickness_mm: float
    feed_mm_s: float
    seconds: float
    rest_s: float
    late_s: float = 0.0
    off_s: float = 0.0
    in_air_s: float = 0.0
    out_s: float = 0.0
    battery: str = "P1"


def own_plan(
    rng: np.random.Generator, material: str, bench: Bench, length: float, of_session: np.random.Generator
) -> tuple[TrialPlan, ...]:
    """Plan 18 trials: three duties, idle, repeats, two feeds, two thicknesses, a long one, idle again.

    Pauses and order are drawn from `of_session`, which may be `rng`.
    """
    feed = float(rng.choice([3.0, 4.0, 5.0]))
    other_feed = feed * float(rng.choice([0.6, 1.5]))
    thick = float(rng.choice([12.0, 30.0]))
    middle = bench.duties[1]

    def trial(
        duty: float, seconds: float, *, cuts: bool = True, feed_mm_s: float = feed, mm: float = 20.0
    ) -> TrialPlan:
        return TrialPlan(
            duty=duty,
            workpiece=material if cuts else "none",
            thickness_mm=mm if cuts else 0.0,
            feed_mm_s=feed_mm_s if cuts else 0.0,
            seconds=length * seconds,
            rest_s=float(of_session.uniform(40.0, 150.0)),
        )

    idle = [trial(duty, 5.0, cuts=False) for duty in bench.duties]
    cuts = [trial(duty, 7.7) for duty in bench.duties for _ in range(3)]
    cuts += [trial(middle, 7.7, feed_mm_s=other_feed) for _ in range(2)]
    cuts += [trial(middle, 7.7, mm=thick) for _ in range(2)]
    mixed = [cuts[k] for k in of_session.permutation(len(cuts))]
    return (*idle, *mixed, trial(middle, 30.0), trial(middle, 5.0, cuts=False))


def any_plan(
    rng: np.random.Generator, material: str, bench: Bench, length: float, of_session: np.random.Generator
) -> tuple[TrialPlan, ...]:
    """Plan 6 to 40 trials: one to three duties, feeds, thicknesses and materials, repeats of some, idle runs or none.

    Trials are as long as their number and the sample rate leave room for. Pauses and order are drawn from
    `of_session`, which may be `rng`.
    """
    n = round(between(rng, 6.0, 40.0))
    n_idle = 0 if rng.random() < 0.15 else max(1, round(n * rng.uniform(0.08, 0.25)))
    seconds = min(between(rng, 3.5, 12.0), max(_MOST_ROWS / bench.rate_hz / n, _LEAST_TRIAL_S))
    n_cut = n - n_idle
    points = _points(rng, material, bench)[: max(1, round(n_cut * rng.uniform(0.3, 0.9)))]
    # Every point once, then repeats of some: others stay without one.
    chosen = [points[k] if k < len(points) else points[int(rng.integers(len(points)))] for k in range(n_cut)]
    plans = [_trial(point, length * seconds * float(rng.uniform(0.8, 1.2)), of_session) for point in chosen]
    idle_points = [(float(rng.choice(bench.duties)), 0.0, 0.0, "none") for _ in range(n_idle)]
    idle = [_trial(point, length * seconds * float(rng.uniform(0.6, 1.0)), of_session) for point in idle_points]
    mixed = [plans[k] for k in of_session.permutation(len(plans))]
    n_first = (n_idle + 1) // 2
    return (*idle[:n_first], *mixed, *idle[n_first:])


def _points(rng: np.random.Generator, material: str, bench: Bench) -> list[tuple[float, float, float, str]]:
    """Draw operating points: duty, feed in mm/s, thickness in mm and workpiece; the usual one first."""
    duties = [bench.duties[k] for k in (1, 0, 2)][: int(rng.choice([1, 2, 3], p=[0.15, 0.35, 0.5]))]
    feed = round(float(rng.uniform(2.0, 6.0)), 1)
    usual = (duties[0], feed, 20.0, material)
    others = [name for name in MATERIALS if name not in {material, "none"}]
    more = [
        [
            (usual[0], round(feed * float(factor), 1), *usual[2:])
            for factor in (rng.uniform(0.5, 0.8), rng.uniform(1.3, 1.8))
        ],
        [(*usual[:2], float(mm), material) for mm in rng.choice([8.0, 12.0, 16.0, 26.0, 30.0], size=2, replace=False)],
        [(*usual[:3], str(name)) for name in rng.choice(others, size=2, replace=False)],
    ]
    points = [(duty, *usual[1:]) for duty in duties]
    for kind in rng.permutation(len(more))[: int(rng.integers(0, len(more) + 1))]:
        points += more[kind][: int(rng.integers(1, 3))]
    return points


def _trial(point: tuple[float, float, float, str], seconds: float, of_session: np.random.Generator) -> TrialPlan:
    duty, feed_mm_s, thickness_mm, workpiece = point
    return TrialPlan(
        duty=duty,
        workpiece=workpiece,
        thickness_mm=thickness_mm,
        feed_mm_s=feed_mm_s,
        seconds=seconds,
        rest_s=between(of_session, 15.0, 300.0),
    )


def as_operated(plans: tuple[TrialPlan, ...], rng: np.random.Generator) -> tuple[TrialPlan, ...]:
    """Let the operator start late, end a recording early, or switch off before its end, each now and then.

    And start the tool in air and take it out of the wood before switching off.
    """
    of_wood = rng.spawn(1)[0]
    habit, habit_of_wood = rng.uniform(0.0, 0.3, size=3), of_wood.uniform(0.0, 0.5, size=2)
    done = []
    for plan in plans:
        happens = rng.random(3) < habit
        late_s, cut, off_s = rng.uniform(0.2, 2.0), rng.uniform(0.4, 0.8), rng.uniform(0.2, 1.0)
        seconds = max(plan.seconds * cut, min(plan.seconds, _LEAST_TRIAL_S)) if happens[1] else plan.seconds
        is_in_air = (of_wood.random(2) < habit_of_wood) & (plan.feed_mm_s > 0.0)
        in_air_s, out_s = np.minimum(of_wood.uniform(0.3, 1.8, size=2), 0.2 * seconds) * is_in_air
        done.append(
            replace(
                plan,
                late_s=float(late_s) if happens[0] else 0.0,
                seconds=float(seconds),
                off_s=float(min(off_s, 0.2 * seconds)) if happens[2] else 0.0,
                in_air_s=float(in_air_s),
                out_s=float(out_s),
            )
        )
    return tuple(done)


def with_batteries(
    plans: tuple[TrialPlan, ...],
    *,
    usual_current_a: float,
    capacity_ah: float,
    swap_share: float,
    rng: np.random.Generator,
) -> tuple[TrialPlan, ...]:
    """Number the batteries: a fresh one where half of a battery is used by estimate, and by chance.

    Parameters
    ----------
    plans : tuple of TrialPlan
    usual_current_a : float
        Battery current of a usual cut.
    capacity_ah : float
    swap_share : float
        Probability of a swap before a trial.
    rng : Generator
    """
    number, used_as = 1, 0.0
    done = []
    for k, plan in enumerate(plans):
        wants_as = plan.seconds * usual_current_a * max(plan.thickness_mm, 20.0) / 20.0
        is_used = used_as + wants_as > _CHARGE_USED * capacity_ah * 3600.0
        if k > 0 and (is_used or rng.random() < swap_share):
            number, used_as = number + 1, 0.0
        used_as += wants_as
        done.append(replace(plan, battery=f"P{number}"))
    return tuple(done)
