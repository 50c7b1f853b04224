"""Settings of the diagnosis, part three: what is claimed, shown and advised once causes are weighed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sawbench.diagnosis.inference.marked_number import marked


@dataclass(frozen=True, kw_only=True, slots=True)
class Learning:
    """How a term without a name is learned, and when it is kept.

    Attributes
    ----------
    smooth, rough : float
        Lengths over which a term's values are alike, as a share of the range of its quantity.
    turn_share : float
        Times these, of a turn, for the crank angle.
    generous : float
        Prior standard deviation of a term, times the root mean square of what it is to explain.
    level : float
        Variance of a common level beside that of a bend: products of kernels then hold sums of functions as well.
    least_excess, most_sites : float, int
        Share of what parameters leave that an equation must hold to be looked at, and how many are.
    beam : int
        How many of the best candidates go on to one quantity more.
    least_range : float
        A quantity that varies by less than that share of its size does not vary.
    least_taken : float
        Share of the sum of squares at withheld operating points that a term must take away to be kept.
    resembles : float
        Correlation from which it resembles an effect.
    one_way : float
        Share of the change over the whole range that goes one way, from which a curve rises or falls.
    """

    smooth: float = marked(0.4, "convention", "a bend or two over the range")
    rough: float = marked(0.2, "convention", "half of it")
    turn_share: float = marked(0.25, "convention", "a quarter of a turn is the length of one bend of a sine")
    generous: float = marked(3.0, "convention", "free: three times what is to be explained")
    level: float = marked(1.0, "convention", "as much as the bend")
    least_excess: float = marked(0.1, "convention", "less cannot close what a claim must close")
    most_sites: int = marked(3, "convention", "time: each costs a pass over all candidates")
    beam: int = marked(4, "convention", "time: each costs a pass over the quantities")
    least_range: float = marked(1e-3, "convention", "the linearity of a sensor")
    least_taken: float = marked(0.1, "convention", "what a correct claim may leave of what can be closed")
    resembles: float = marked(0.8, "convention", "two thirds of the variance are common")
    one_way: float = marked(0.8, "convention", "nine parts up for one down")


@dataclass(frozen=True, kw_only=True, slots=True)
class Ladder:
    """How withheld trials are predicted, and what is called closed.

    Attributes
    ----------
    least_rest : float
        Share of the noise energy below which no cause can be shown to leave less.
    by_chance : float
        Sum of squares over the noise by which one number that is fitted elsewhere makes a withheld group worse.
    least_blocks, least_groups : int
        Time blocks of a trial that give a scatter about a straight line; withheld groups that give an interval.
    farthest : float
        Numbers of the machine that are re-tuned freely stay within this many widened standard deviations: farther off
        it is not the same machine.
    farthest_stated : float
        Zeros and gains of sensors stay within this many stated ones, for nobody re-tunes them; in the improved model
        numbers of the machine beside a cause do, too.
    solved_forms : int
        Forms of a cause that are solved with these bounds.
    most_autocorrelation : float
        Of neighbouring units of a trial, as far as it raises the noise of their mean.
    left_by_the_right : float
        Of what re-tuned parameters leave: nine of ten right causes leave less than that, because no form is nature's.
    left_by_an_intact : float
        Of the noise at withheld points: what a machine without a fault leaves in addition.
    least_added : float
        Of what the other effects of a cause leave above the noise: a further one that takes away less is not named.
    most_of_a_gap : float
        Of what would be hardly a gap without an effect: that must remove more than this share.
    most_harm : float
        Of the squared error of the predicted channels without a cause: by how much it may raise that.
    """

    least_rest: float = marked(0.02, "convention", "a closed gap is stated to 2 %")
    by_chance: float = marked(1.0, "convention", "the expectation of chi-square with one degree of freedom")
    least_blocks: int = marked(3, "convention", "a straight line takes two")
    least_groups: int = marked(3, "convention", "a standard error from leaving out one in turn")
    farthest: float = marked(2.0, "convention", "95 %, as every interval")
    farthest_stated: float = marked(3.0, "convention", "one number in 400 is further off than it is stated to be")
    solved_forms: int = marked(3, "convention", "time: each costs a bounded least-squares problem")
    most_autocorrelation: float = marked(0.9, "convention", "keeps the noise finite: a factor of 4.4")
    left_by_the_right: float = marked(0.1, "convention", "what a correct claim may leave of what can be closed")
    left_by_an_intact: float = marked(2.0, "measured", "24 of 25 intact campaigns of three simulators: less")
    least_added: float = marked(0.1, "convention", "one direction of ten smooth ones takes up as much by chance")
    most_of_a_gap: float = marked(0.5, "convention", "what most of it means")
    most_harm: float = marked(1.0, "convention", "a factor of two")


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """What the report says, and from when on.

    Attributes
    ----------
    odds : float
        Of the leading cause against one that is called indistinguishable from it.
    false_discovery_rate : float
        Of the parts of the crank angle and the spectrum that are called significant.
    grows_with : float
        Rank correlation of a gap with speed, load, time, position or feed from which it grows with it.
    shown_share : float
        Of the gap: a place with less is not named.
    shown_probability : float
        Causes with less are not listed.
    high_square : float
        Times the average square of the mean gap over the turn, from which a part of the turn is named.
    mains_tolerance : float
        Relative difference of a line from a multiple of the mains frequency.
    least_move : float
        Of its standard uncertainty: a parameter that moves by less stays as stated in the improved model.
    shown_log_odds : float
        Log odds against no gap below which an effect of typical magnitude would probably not be named.
    settled : float
        Probability from which the next trial is to confirm, not to decide.
    worth : float
        Log odds that one more trial must be worth to be advised.
    wander_stds : float
        Significance of a zero that wanders.
    least_fault : mapping of str to float
        Below these a fault of a sensor costs nothing: share of samples missing, jitter in sample periods, spikes a
        second, wander, jumps at restarts and level of the zero in N, drift of a gain.
    """

    odds: float = marked(20.0, "convention", "95 %, as every interval")
    false_discovery_rate: float = marked(0.05, "convention", "95 %")
    grows_with: float = marked(0.6, "convention", "a third of the variance of the ranks")
    shown_share: float = marked(0.02, "convention", "less than what any form leaves")
    shown_probability: float = marked(0.001, "convention", "a thousand to one against")
    high_square: float = marked(1.5, "convention", "half again the average")
    mains_tolerance: float = marked(0.005, "convention", "grids stay within 0.4 %, clocks within less")
    least_move: float = marked(0.05, "convention", "a twentieth changes nothing")
    shown_log_odds: float = marked(9.2, "convention", "prior odds of 24 against it, and twice 20 to 1")
    settled: float = marked(0.95, "convention", "95 %")
    worth: float = marked(1.0, "convention", "odds of e")
    wander_stds: float = marked(3.0, "convention", "three standard deviations")
    least_fault: Mapping[str, float] = marked(
        {
            "missing": 1e-3, "jitter": 0.05, "spikes_hz": 0.05, "wander_n": 0.1, "restart_n": 0.5, "gain_drift": 1e-3,
            "vibration_n": 0.1, "level_n": 2.0,
        },
        "convention",
        "less than the floors of `Sensors`",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class Closing:
    """Causes one by one: how the model that holds some causes is weighed again.

    Attributes
    ----------
    most_passes : int
        Weighings of one campaign.
    least_rel_std : float
        Relative standard uncertainty, at least, of a magnitude that later causes may correct.
    least_probability : float
        Below it an alternative of a pass is not carried along.
    within_noise : float
        Share of the energy of the noise that nobody can close.
    left_on_trial : float
        Share of the gap that causes which were followed although "unknown" was likelier may leave.
    rounds : int
        In which the form of each cause is chosen beside the others.
    """

    most_passes: int = marked(6, "convention", "time: a pass costs as much as the first weighing")
    least_rel_std: float = marked(0.25, "convention", "a second cause moves the first by half at most")
    least_probability: float = marked(0.02, "convention", "odds of fifty to one against")
    within_noise: float = marked(0.02, "convention", "as the ladder: less cannot be shown")
    left_on_trial: float = marked(0.1, "convention", "what a correct claim leaves of what can be closed")
    rounds: int = marked(3, "convention", "time: most forms stay from the second one on")


@dataclass(frozen=True, kw_only=True, slots=True)
class Planning:
    """Which trials are proposed next.

    Attributes
    ----------
    handling_s : float
        What a trial takes beside its duration: to clamp, to zero, to look.
    rest_s : float
        Rest before a trial that is to begin with a cold machine.
    longer : float
        Duration of a long trial over the usual one of the campaign.
    least_probability : float
        Below it an answer is not separated from the others, unless there are fewer than two.
    """

    handling_s: float = marked(60.0, "convention", "a minute")
    rest_s: float = marked(900.0, "convention", "a motor's winding has cooled by then")
    longer: float = marked(3.0, "convention", "what grows with time is three times as large")
    least_probability: float = marked(0.001, "convention", "as the report lists causes")
