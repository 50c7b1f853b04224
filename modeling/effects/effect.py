"""What every entry of the catalogue states."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.strokes import Strokes
from sawbench.modeling.load import OAK, Load
from sawbench.modeling.residuals import Signature
from sawbench.modeling.state import Memory, State

Place = Literal["electrical", "mechanical", "cutting", "supply", "sensing"]
GrowsWith = Literal["speed", "load", "time", "position", "feed"]
# What a machine may be made of, as far as an effect asks for it. `drive` is whatever moves the machine, `load` what it
# moves against, `joint` a joint between the two that can have play; `drive_sensor` reads the drive's current or force.
Part = Literal[
    "motor", "gear", "crank", "scotch_yoke", "slider_crank", "guide", "joint", "drive", "load", "blade", "converter",
    "battery", "carriage", "load_cell", "drive_sensor", "clocks", "linear_drive", "moving_mass",
]  # fmt: skip
Phase = Literal["air", "start_up"]
# (baseline, state, shape) -> one Signature, or two where a phase is free (sine and cosine part).
SignatureFunction = Callable[..., tuple[Signature, ...]]
# Frequency in Hz -> complex gain, both of shapes that broadcast.
TransferFunction = Callable[[Floats], NDArray[np.complexfloating]]


@dataclass(frozen=True, slots=True)
class Prepared:
    """A signature function whose forms share work: `on` does it once a state and gives the function of the shape."""

    on: Callable[[Any, State], SignatureFunction]

    def __call__(self, baseline: Any, state: State, **shape: float) -> tuple[Signature, ...]:
        """Evaluate one shape."""
        return self.on(baseline, state)(**shape)


@dataclass(frozen=True, slots=True)
class Together:
    """A signature function that takes many forms at once: a state and the shapes -> their signatures."""

    of: Callable[[Any, State, Sequence[dict[str, float]]], list[tuple[Signature, ...]]]

    def __call__(self, baseline: Any, state: State, **shape: float) -> tuple[Signature, ...]:
        """Evaluate one shape."""
        return self.of(baseline, state, [shape])[0]


# Every effect of the catalogue may be there a little without being "the" cause: one standard deviation of that, as a
# share of its typical size.
BACKGROUND_SHARE = 0.05
# Of the typical size: hardly any effect. A number that is this many times larger without effect grows without end.
_HARDLY, _ENDLESS = 1e-6, 2.0


FloatOrFloats = TypeVar("FloatOrFloats", float, Floats)


@dataclass(frozen=True, kw_only=True, slots=True)
class Strength:
    """The parameter that says how strong the effect is.

    Attributes
    ----------
    name, unit : str
        As in the report.
    typical : float
        A usual size, in `unit`.
    low, high : float
        Sizes that occur, as multiples of `typical`; the prior is log-normal about `typical` itself, cut off there and
        four standard deviations wide. Where the strength is a number inside a nonlinear form (see `Effect.shapes`),
        both are near 1.
    source : str
        Where range and typical size come from; "assumed" where nobody measured it.
    follows : callable, optional
        `Load` of a saw -> what the typical size is in proportion to; `typical` is that at `load.OAK`. Without it the
        typical size is the same on every machine.
    usual : float, optional
        Of a strength that is a number inside a nonlinear form: a usual one, in `unit`, where smaller ones are a smaller
        effect, or larger ones.
    is_less_if_larger : bool
        Whether larger ones are a smaller effect: a stiffness.
    """

    name: str
    unit: str
    typical: float
    low: float
    high: float
    source: str
    follows: Callable[[Load], float] | None = None
    usual: float | None = None
    is_less_if_larger: bool = False

    def over_usual(self, strength: FloatOrFloats) -> FloatOrFloats:
        """Size of the effect at some strengths, in multiples of that at the usual one, which must be stated."""
        assert self.usual is not None
        return self.usual / strength if self.is_less_if_larger else strength / self.usual

    def at(self, load: Load) -> Strength:
        """Strength as it is typical of a saw that carries another load than `load.OAK`."""
        if self.follows is None:
            return self
        return replace(self, typical=self.typical * self.follows(load) / self.follows(OAK))


@dataclass(frozen=True, kw_only=True, slots=True)
class Words:
    """The effect for a technician.

    Attributes
    ----------
    happens : str
        Continues "the model leaves out that".
    measure : str
        What to measure at the machine itself, apart from any trial, that shows it.
    mend : str
        What to do about it.
    name : str
        What the effect is called, where its id says it in the words of another machine.
    """

    happens: str
    measure: str
    mend: str
    name: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Effect:
    """One unmodelled effect: what it adds to the residuals of the baseline.

    Attributes
    ----------
    name : str
        The id of the catalogue.
    place : Place
        Equation of the report that it violates.
    equation : str
        The term it adds, in words and symbols.
    words : Words, optional
        Every entry of the catalogue has them.
    words_on : mapping of str to Words
        Frame of a machine (`modeling.machines`) -> the words there, where those of a saw do not fit.
    parts : tuple of Part
        Parts that a machine must have to show it.
    silent_in : tuple of {"air", "start_up"}
        Phases in which it adds nothing, in whatever form.
    strength : Strength
    signature : callable
        (baseline, state, **shape) -> the change of the residuals, "measured minus baseline", per unit of
        `strength` (1 for shapes that carry the strength themselves). Several of them where a phase is free.
    n_signatures : callable
        Shape -> how many signatures it has.
    shapes : tuple of dict
        Functional forms and nonlinear parameters to marginalise over; all equally likely.
    continuous : tuple of str
        Numbers of a form that may lie anywhere between those of `shapes`; all others are choices.
    shape_strength : callable, optional
        (amplitude, shape) -> value of the reported parameter, where it is not the amplitude itself.
    carries : tuple of str
        Numbers of a form that are the strength itself; the amplitude is then 1 or near it.
    moves_blade : bool
        The blade does not follow the crank: what it does beyond is measured and stands in the cutting law, not in the
        signature.
    form_names : mapping of str to dict
        Names that the field has for some of the forms.
    scales : tuple of str
        Attributes of the state or of the model that a form is stated relative to.
    form_words : callable
        Shape -> what its numbers mean on the machine, with units; empty where the magnitude says all.
    is_pointwise : bool
        What it adds at one instant follows from that instant (and from slow states); else it takes a whole stroke.
    memories : tuple of Memory
        Slow states that its forms read.
    needs : tuple of str
        Channels without which it cannot be seen at all.
    grows_with : tuple of str
    confused_with : tuple of str
        Ids it is easily taken for.
    told_apart_by : str
        What an experiment must vary to tell it from those.
    background : tuple of (shape, float), optional
        Shapes that stand for a little of it, each with its standard deviation as a multiple of the typical size;
        without them `background_share` of it, in any of its shapes.
    background_share : float
        One standard deviation of that, over the typical size; 1 of what every bench has.
    is_at_one_place : bool
        A machine has it at one place of a wide range, such as a frequency: a little of it is a little of one shape.
    combine : callable, optional
        (baseline, state, coefficients, **shape) -> the sum of the signatures times coefficients, where that is cheaper
        than signature by signature.
    size_of : callable, optional
        Coefficients of the columns, in multiples of the typical size -> size of the effect; without it the one
        coefficient, or the root of the sum of squares of the first two (sine and cosine); the first alone where
        `leading` is 1.
    leading : int
        Signatures of each shape that must have the least size for the further ones, overtones, to count; 0 where all
        are alike.
    variants : mapping of str to callable
        Frame of a machine whose equations are others than a saw's (`modeling.machines`) -> the effect there, made for
        the sizes of the machine's model.
    same_as : tuple of str
        Ids whose equation on this plant is the very same term: no campaign can tell them apart.
    strokes : StrokeWave, StrokeTrend or ZeroTrend, optional
        How single strokes bear on it, where they do.
    keeps_hardness : bool
        Of an effect of a sensor: the cutting coefficient, the slope of force over cutting speed, stays as it is.
    distorts : callable, optional
        Of a linear effect of a sensor: (state, coefficients of the signatures, **shape) -> by equation, the transfer
        function through which it shows what other effects add there.
    """

    name: str
    place: Place
    equation: str
    strength: Strength
    signature: SignatureFunction
    words: Words | None = None
    words_on: Mapping[str, Words] = field(default_factory=dict)
    parts: tuple[Part, ...] = ()
    silent_in: tuple[Phase, ...] = ()
    n_signatures: Callable[[dict[str, float]], int] = lambda shape: 1
    shapes: tuple[dict[str, float], ...] = field(default=({},))
    continuous: tuple[str, ...] = ()
    shape_strength: Callable[[float, dict[str, float]], float] | None = None
    carries: tuple[str, ...] = ()
    form_names: Mapping[str, dict[str, float]] = field(default_factory=dict)
    scales: tuple[str, ...] = ()
    form_words: Callable[[dict[str, float]], str] = lambda shape: ""
    is_pointwise: bool = True
    moves_blade: bool = False
    memories: tuple[Memory, ...] = ()
    needs: tuple[str, ...] = ()
    grows_with: tuple[GrowsWith, ...] = ()
    confused_with: tuple[str, ...] = ()
    told_apart_by: str = ""
    background: tuple[tuple[dict[str, float], float], ...] | None = None
    background_share: float = BACKGROUND_SHARE
    is_at_one_place: bool = False
    combine: Callable[..., Signature] | None = None
    size_of: Callable[[Floats], float] | None = None
    leading: int = 0
    same_as: tuple[str, ...] = ()
    variants: Mapping[str, Callable[[Any], Effect]] = field(default_factory=dict)
    strokes: Strokes | None = None
    keeps_hardness: bool = False
    distorts: Callable[..., Mapping[str, TransferFunction]] | None = None

    def signatures(self, baseline: Any, state: State, shape: dict[str, float] | None = None) -> tuple[Signature, ...]:
        """Evaluate the signature for one shape (default: the first).

        Returns
        -------
        tuple of dict
            Arrays of the state's shape; only equations that the measured channels allow.
        """
        return self.signatures_of(baseline, state, [self.shapes[0] if shape is None else shape])[0]

    def signatures_of(
        self, baseline: Any, state: State, shapes: Sequence[dict[str, float]]
    ) -> list[tuple[Signature, ...]]:
        """`signatures` for many shapes; what they share is worked out once."""
        if self._is_silent(state):
            return [tuple({} for _ in range(self.n_signatures(shape))) for shape in shapes]
        kept, grid = baseline.evaluable_equations(state), state.angle_rad.shape
        return [
            tuple(
                {
                    name: wave if np.shape(wave) == grid else np.broadcast_to(wave, grid)
                    for name, wave in part.items()
                    if name in kept
                }
                for part in parts
            )
            for parts in self._of_shapes(baseline, state, shapes)
        ]

    def _of_shapes(
        self, baseline: Any, state: State, shapes: Sequence[dict[str, float]]
    ) -> Iterable[tuple[Signature, ...]]:
        signature = self.signature
        if isinstance(signature, Together):
            return signature.of(baseline, state, shapes)
        found_for = (
            signature.on(baseline, state) if isinstance(signature, Prepared) else partial(signature, baseline, state)
        )
        return (found_for(**shape) for shape in shapes)

    def _is_silent(self, state: State) -> bool:
        return ("air" in self.silent_in and state.setting.is_idle) or state.kind in self.silent_in

    @property
    def bends_hardness(self) -> bool:
        """Whether it may make the cutting coefficient depend on speed, by the cut itself or by a sensor."""
        return self.place == "cutting" or (self.place == "sensing" and not self.keeps_hardness)

    def carried_by(self, form: Mapping[str, float]) -> str | None:
        """Name of the number that is the strength, of the form that has these other numbers; None where none is."""
        named = (key for key in self.carries if any(shape.keys() == {*form, key} for shape in self.shapes))
        return next(named, None)

    def amplitude(self, coefficients: Floats) -> float:
        """Size, in multiples of the typical one, that goes with the fitted coefficients of one shape."""
        if self.size_of is not None:
            return self.size_of(coefficients)
        leading = min(self.leading or 2, len(coefficients))
        return float(coefficients[0] if leading == 1 else np.hypot(*coefficients[:2]))

    def combined(self, baseline: Any, state: State, shape: dict[str, float], coefficients: Floats) -> Signature:
        """Sum of the signatures of one shape times coefficients, in units of `strength`."""
        if self._is_silent(state):
            return {}
        if self.combine is not None:
            kept = baseline.evaluable_equations(state)
            found = self.combine(baseline, state, coefficients, **shape)
            return {name: wave for name, wave in found.items() if name in kept}
        total: Signature = {}
        for part, coefficient in zip(self.signatures(baseline, state, shape), coefficients, strict=False):
            for name, wave in part.items():
                total[name] = total.get(name, 0.0) + coefficient * wave
        return total

    def reported_strength(self, amplitude: float, shape: dict[str, float]) -> float:
        """Value of `strength` that goes with an amplitude of one shape."""
        return amplitude if self.shape_strength is None else self.shape_strength(amplitude, shape)

    def strength_without(self, shape: dict[str, float]) -> float | None:
        """Value of `strength` where there is no effect: 0, but 1 of the exponent of the speed; None if it has no end.

        A number that belongs to the shape alone (a frequency) is the same without effect.
        """
        none, hardly = (self.reported_strength(part * self.strength.typical, shape) for part in (0.0, _HARDLY))
        return None if abs(none) > _ENDLESS * abs(hardly) else none
