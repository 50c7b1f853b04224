"""The numbers on which the diagnosis rests and that no equation gives, each with where it comes from.

`fitted` numbers were chosen for what they do to the answers on development campaigns; each is held by a principle that
half of it and twice of it break (`python -m tests.rigs.principles` prints them). `measured` ones were read off data,
`convention` ones are a choice that a reader may make otherwise. Grids, tolerances and sizes of arrays stay beside the
functions that use them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Final, Literal

# Half the 95 % interval of a normal distribution over its standard deviation: the level of every claim, by convention.
Z95: Final = 1.959964
Mark = Literal["fitted", "measured", "convention"]
_CALIBRATED = "`benchmarks.calibrate_diagnosis fit`, seeds 1 to 999"
_BY_HAND = "answers to development campaigns, seeds 1 to 999, by hand"


def _number(value: Any, mark: Mark, source: str) -> Any:
    return field(default=value, metadata={"mark": mark, "source": source})


@dataclass(frozen=True, kw_only=True, slots=True)
class Weights:
    """From log evidences to probabilities.

    Attributes
    ----------
    temperature : float
        Divides log evidences where the noise is as modelled.
    quiet : float
        Whitened misfit over features that an intact machine leaves on a quiet bench.
    pair_gain : float
        Log odds of two effects against the stronger one alone, per e-fold of the log evidence that the second adds.
    pair_least, pair_share : float
        That log evidence at which they are even: the first plus the second times the root of the log evidence of
        the stronger effect alone, because the form of a strong effect misses more.
    open_gain, open_share : float
        Log odds of "unknown" against the best claim per e-fold of the share of the gap that this leaves, and the
        share at which they are even.
    left_by_an_intact_machine : float
        Times `quiet`: what is left below that is no share of the gap.
    prior_no_gap, prior_parameters, prior_unknown : float
        The rest belongs to the effects, evenly.
    """

    temperature: float = _number(3.0, "fitted", f"{_CALIBRATED}; set above its fit, to claim less")
    quiet: float = _number(0.15, "fitted", _BY_HAND)
    pair_gain: float = _number(1.4, "fitted", _CALIBRATED)
    pair_least: float = _number(11.0, "fitted", _CALIBRATED)
    pair_share: float = _number(0.7, "fitted", _CALIBRATED)
    open_gain: float = _number(2.6, "fitted", _CALIBRATED)
    open_share: float = _number(0.47, "fitted", _CALIBRATED)
    left_by_an_intact_machine: float = _number(1.7, "fitted", _BY_HAND)
    prior_no_gap: float = _number(0.45, "fitted", f"{_CALIBRATED}; moved: a parameter 5 sigma off is called so")
    prior_parameters: float = _number(0.15, "fitted", "as prior_no_gap")
    prior_unknown: float = _number(0.06, "fitted", _CALIBRATED)


@dataclass(frozen=True, kw_only=True, slots=True)
class Noise:
    """What the features scatter by.

    Attributes
    ----------
    correlation_factor : float
        Scatter of the units is correlated from block to block: the variance of a block's mean is that much larger.
    quiet_share : float
        Times what the scatter predicts: what an intact machine leaves on this bench.
    wide : float
        Factor on the prior of the plant's numbers where they are re-tuned freely.
    """

    correlation_factor: float = _number(1.5, "fitted", _BY_HAND)
    quiet_share: float = _number(1.25, "fitted", _BY_HAND)
    wide: float = _number(5.0, "convention", "re-tuning by five stated standard deviations is still the same machine")


@dataclass(frozen=True, kw_only=True, slots=True)
class Forms:
    """How far nature's form may be from the catalogue's, and when that is looked at.

    Attributes
    ----------
    shares : tuple of float
        Standard deviation of each part of the smooth factor on a signature, as a share of it: all are tried.
    steady_share : float
        Of an effect that does not depend on time, the part that does.
    harmonic_factor : float
        Each harmonic may also be larger and turned on its own, as another filter or a sharper corner would have it.
    screen_share : float
        Share that the first effect of a pair may miss while the second one is screened.
    n_formed, n_first, n_pairs : int
        Effects, firsts of a pair and pairs that are weighed with what their forms may miss.
    worth_forming : float
        Log evidence of a second effect below which its form does not matter.
    size_temperature : float
        Divides what the features say of the size of an effect: no form is nature's, and sizes miss more by that than
        causes.
    """

    shares: tuple[float, ...] = _number((0.0, 0.03, 0.1, 0.25), "convention", "none, and three sizes a factor 3 apart")
    steady_share: float = _number(0.1, "fitted", _BY_HAND)
    harmonic_factor: float = _number(1.5, "fitted", _BY_HAND)
    screen_share: float = _number(0.05, "convention", "the middle of the shares that are tried, of their logarithm")
    n_formed: int = _number(12, "convention", "time: each costs 0.1 s")
    n_first: int = _number(5, "convention", "time: each costs a pass over the catalogue")
    n_pairs: int = _number(8, "convention", "time: each costs 0.2 s")
    worth_forming: float = _number(6.0, "convention", "time: below, no pair reaches even odds (`Weights.pair_least`)")
    size_temperature: float = _number(6.0, "fitted", _BY_HAND)


@dataclass(frozen=True, kw_only=True, slots=True)
class Strokes:
    """How single strokes count beside mean strokes.

    Attributes
    ----------
    weight : float
        Strokes are independent and their spectrum is fitted: one nat of theirs counts as that many of whitened
        features. The same alone, beside another effect and for a wave in time: else a second name would make the
        strokes speak louder.
    price : float
        Taken off a trend for which strokes speak: with a dozen pieces of wood luck looks like one.
    against : float
        Log evidence of the strokes below which they speak against an effect.
    depth_step : float
        Relative standard uncertainty of a wave's depth, as the depths that are tried are spaced.
    free_std, little_std : float
        Standard deviation of the powers of speed and feed with which the hardness goes: where another effect of the
        cut or of a sensor may act, and where none does.
    """

    weight: float = _number(4.0, "fitted", _BY_HAND)
    price: float = _number(7.0, "fitted", _BY_HAND)
    against: float = _number(-1.0, "convention", "odds of e to one against")
    depth_step: float = _number(0.5, "convention", "depths that are tried are a factor 1.5 apart")
    free_std: float = _number(0.5, "convention", "the speed exponents and edge forces that occur, as a power")
    little_std: float = _number(0.03, "convention", "background effects, 5 % of its typical size, as a power")


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """All of them, by topic."""

    weights: Weights = field(default_factory=Weights)
    noise: Noise = field(default_factory=Noise)
    forms: Forms = field(default_factory=Forms)
    strokes: Strokes = field(default_factory=Strokes)

    def moved(self, name: str, factor: float) -> Settings:
        """Return the same settings with one number multiplied.

        Parameters
        ----------
        name : str
            "topic.number".
        factor : float

        Examples
        --------
        >>> SETTINGS.moved("strokes.price", 2.0).strokes.price
        14.0
        """
        topic, number = name.split(".")
        part = getattr(self, topic)
        value = getattr(part, number)
        moved = tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value
        return replace(self, **{topic: replace(part, **{number: moved})})


SETTINGS = Settings()


def marks() -> Iterator[tuple[str, Mark, str]]:
    """Name ("topic.number"), mark and source of every number."""
    for topic in fields(Settings):
        part = getattr(SETTINGS, topic.name)
        assert is_dataclass(part)
        for number in fields(part):
            yield f"{topic.name}.{number.name}", number.metadata["mark"], number.metadata["source"]
