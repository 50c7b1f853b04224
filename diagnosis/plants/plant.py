"""What the diagnosis must know of a machine: the rest (evidence, posterior, ladder, places) asks nothing else.

A plant is a set of balance equations that are evaluated on measured signals. What does not cancel is the gap;
what may merely be mistuned (`nuisances`) and what may be missing (`effects`) are both stated as changes of
these residuals. What the machine is made of, its equations and its effects stand in `modeling.machines`; here is what
inference needs besides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from sawbench.bench.recording import Floats
from sawbench.modeling.residuals import Equation, Signature
from sawbench.modeling.state import State

if TYPE_CHECKING:
    from sawbench.diagnosis.inference.features import Layout
    from sawbench.diagnosis.inference.nuisance import Nuisance, Reading
    from sawbench.diagnosis.inference.zero_wander import ZeroWander
    from sawbench.modeling.effects.effect import Effect, Place
    from sawbench.modeling.effects.known import KnownEffect
    from sawbench.modeling.machines.machine import Machine


@dataclass(frozen=True, kw_only=True, slots=True)
class EquationForm:
    """How one balance equation of a plant is compared and reported.

    Attributes
    ----------
    unit : str
        Of its residual.
    place : Place
        Its name in the report.
    channel : str
        Channel in which its gap is seen first.
    channel_unit : str
    to_channel : float or None
        Residual times this is the misprediction of `channel`; None where the residual predicts no channel of
        its own.
    n_harmonics : int
        Harmonics of the cycle that are compared.
    noise_bands : tuple of int
        Harmonics from which on the noise may be larger than below, each on its own: what rings in the machine is no
        noise of its slow forces. Empty where one factor holds for all.
    """

    unit: str
    place: Place
    channel: str
    channel_unit: str
    to_channel: float | None
    n_harmonics: int
    noise_bands: tuple[int, ...] = ()


class Plant(Protocol):
    """A machine with a cyclic load.

    Attributes
    ----------
    machine : Machine
        What it is made of.
    model : object
        Handed to the signatures of effects and nuisances: the numbers of the baseline.
    equations : mapping of Equation to EquationForm
        In the order in which they stand in a feature vector.
    known : tuple of KnownEffect
        Effects that belong to this machine's model already.
    effects : tuple of Effect
        What may be missing from it.
    beyond_catalogue : tuple of Effect
        Forms that count as "unknown" where they win.
    expected_rest : float
        Whitened misfit over features that is no sign of more noise.
    turns_a_cycle : float or None
        Of a motor with a commutator; None where none is modelled.
    scale_rel_std : float
        Relative uncertainty that every strength found shares, because the equations fix sizes only up to it.
    """

    @property
    def machine(self) -> Machine:
        """What it is made of."""
        ...

    @property
    def model(self) -> Any:
        """Numbers of the baseline, as effects and nuisances take them."""
        ...

    @property
    def equations(self) -> Mapping[Equation, EquationForm]:
        """Balance equations, in the order of the feature vector."""
        ...

    @property
    def effects(self) -> tuple[Effect, ...]:
        """What may be missing from the model."""
        ...

    @property
    def known(self) -> tuple[KnownEffect, ...]:
        """What the model holds beside its equations."""
        ...

    @property
    def beyond_catalogue(self) -> tuple[Effect, ...]:
        """Forms of causes that nobody claims."""
        ...

    @property
    def turns_a_cycle(self) -> float | None:
        """Turns of a motor with a commutator."""
        ...

    @property
    def scale_rel_std(self) -> float:
        """Relative uncertainty that all strengths share."""
        ...

    @property
    def expected_rest(self) -> float:
        """Whitened misfit over features that its `model_error` makes ordinary, of 1; 0 where it is a floor only."""
        ...

    def with_known(self, known: Sequence[KnownEffect]) -> Plant:
        """Return the same machine with exactly these effects in its model."""
        ...

    def residuals(self, state: State) -> Signature:
        """Evaluate every equation that the measured channels allow, shape of the state, in the equation's unit.

        Without what known effects make of it, which is taken off as a signature, free of the noise of single units.
        """
        ...

    def smooth(self, state: State, blocks: Floats) -> State:
        """State to compute signatures from, one row a time block, without the noise that the residual holds too."""
        ...

    def model_error(self, layout: Layout, state: State) -> Floats:
        """Covariance of the features that no repetition shows, shape (layout.size, layout.size), positive definite."""
        ...

    def nuisances(self) -> tuple[Nuisance, ...]:
        """List parameters, gains and offsets that all trials share."""
        ...

    def readings(self) -> Mapping[str, Reading]:
        """Channels whose faults reach the equations, and how."""
        ...

    def trial_nuisances(self, states: Sequence[State]) -> tuple[Nuisance, ...]:
        """List what differs from stock to stock or trial to trial without being a gap."""
        ...

    def zero_wander(self, states: Sequence[State]) -> ZeroWander | None:
        """How far the zero of the force wanders; None where the states cannot tell."""
        ...

    def zero_signature(self, state: State) -> Signature:
        """Change of the residuals for one newton more on the zero of the force."""
        ...

    def force_beyond_crank(self, state: State) -> Signature:
        """What the motion of the blade beyond that of the crank adds to the expected force."""
        ...

    def measured_rms(self, states: Sequence[State]) -> Mapping[str, float]:
        """How much channels of `equations` vary by themselves, in their unit, over the harmonics that are compared.

        By channel; a model that mispredicts a channel by that much explains nothing of it. Empty where the channels of
        a machine are judged before.
        """
        ...

    def weaknesses(self, states: Sequence[State]) -> list[str]:
        """Say which missing channels weaken the answer."""
        ...

    def asymmetry(
        self, states: Sequence[State], effects: Sequence[str], parameters: Mapping[str, float]
    ) -> tuple[dict[str, Any], str]:
        """How effects of a cause differ by direction, as numbers and in words; empty where they have none.

        `parameters` are those that were re-tuned, by name.
        """
        ...

    def next_trial(self, states: Sequence[State], *, has_gap: bool) -> str | None:
        """Name the trial that this campaign lacks most, whether it shows a gap or not; None where it lacks none."""
        ...
