"""A term that was learned from residuals: a smooth table over one to three measured quantities, in one equation.

    r = s(q_1, ..., q_k)        in the equation's unit, k = 1, 2 or 3

with s a tensor product of cubic splines through the values at the nodes of the table. It has no name and no physics:
it says what a campaign's machine did within the range of the nodes. Outside of it the value at the edge is kept, which
is a guess: `out_of_range` says where that happens.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, GrowsWith, Place, Strength, Words
from sawbench.modeling.effects.heat import COPPER_HEAT, SPIN_HEAT
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.transfer import force_error
from sawbench.modeling.residuals import UNITS, Baseline, Signature
from sawbench.modeling.state import TWO_PI, Memory, State

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

NAME: Final = "learned"
MOST_QUANTITIES: Final = 3
# A cubic spline needs as many.
LEAST_NODES: Final = 4
# Beyond the range by less than this share of it counts as within.
_TOLERATED: Final = 0.05
_HEAT_S: Final = 100.0

Site = Literal["electrical", "mechanical", "cutting", "supply", "converter", "force_reading"]
SITES: Final[Mapping[Site, tuple[Place, str, str]]] = MappingProxyType(
    {
        "electrical": ("electrical", UNITS["electrical"], "motor_current_a"),
        "mechanical": ("mechanical", UNITS["mechanical"], "motor_current_a"),
        "cutting": ("cutting", UNITS["cutting"], "force_n"),
        "supply": ("supply", UNITS["supply"], "battery_voltage_v"),
        "converter": ("supply", UNITS["converter"], "battery_current_a"),
        # What the load cell shows too much: the cutting and the mechanical equation read it.
        "force_reading": ("sensing", "N", "force_n"),
    }
)
"""Where a term may stand: its place in the report, its unit, the channel that shows it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Quantity:
    """A measured quantity that a term may depend on.

    Attributes
    ----------
    words, unit : str
    of : callable
        (baseline, state) -> values that broadcast to the state's shape; None where it was not measured.
    is_periodic : bool
        Over one turn.
    grows_with : tuple of str
        As an effect says it.
    memories : tuple of Memory
        Slow states that it reads.
    """

    words: str
    unit: str
    of: Callable[[Baseline, State], Floats | None]
    is_periodic: bool = False
    grows_with: tuple[GrowsWith, ...] = ()
    memories: tuple[Memory, ...] = ()


QUANTITIES: Final[Mapping[str, Quantity]] = MappingProxyType(
    {
        "crank_angle_rad": Quantity(
            words="crank angle", unit="rad", of=lambda _, s: np.mod(s.angle_rad, TWO_PI), is_periodic=True,
            grows_with=("position",),
        ),
        "blade_position_m": Quantity(
            words="blade position", unit="m", of=lambda b, s: b.mechanism.displacement(s.angle_rad),
            grows_with=("position",),
        ),
        "blade_speed_m_s": Quantity(
            words="blade speed (positive as it cuts)", unit="m/s",
            of=lambda b, s: b.cutting_sign * b.blade_velocity(s), grows_with=("speed",),
        ),
        "crank_speed_rad_s": Quantity(
            words="crank speed", unit="rad/s", of=lambda _, s: s.speed_rad_s, grows_with=("speed",)
        ),
        "force_n": Quantity(words="force", unit="N", of=lambda _, s: s.force_n, grows_with=("load",)),
        "motor_current_a": Quantity(words="motor current", unit="A", of=lambda _, s: s.current_a, grows_with=("load",)),
        "time_s": Quantity(words="time in the trial", unit="s", of=lambda _, s: s.time_s, grows_with=("time",)),
        "cut_distance_m": Quantity(
            words="blade travel in the wood", unit="m", of=lambda _, s: s.cut_distance_m, grows_with=("time",)
        ),
        "motor_heat_a2": Quantity(
            words=f"motor heat (mean square of the current, memory of {_HEAT_S:.0f} s)", unit="A^2",
            of=lambda _, s: s.slow.get(COPPER_HEAT[_HEAT_S]), grows_with=("time", "load"),
            memories=(COPPER_HEAT[_HEAT_S],),
        ),
        "friction_heat_rad2_s2": Quantity(
            words=f"friction heat (mean square of the crank speed, memory of {_HEAT_S:.0f} s)", unit="rad^2/s^2",
            of=lambda _, s: s.slow.get(SPIN_HEAT[_HEAT_S]), grows_with=("time", "speed"),
            memories=(SPIN_HEAT[_HEAT_S],),
        ),
    }
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class LearnedTerm:
    """A table; called with a baseline and a state it is the signature of an effect.

    Attributes
    ----------
    site : Site
    quantities : tuple of str
        Keys of `QUANTITIES`, one to three.
    nodes : tuple of tuple of float
        Of each quantity, evenly spaced and increasing; of the crank angle from 0 on, one turn without its end.
    values, stds : ndarray, shape (len(nodes[0]), ...)
        Of the term at the nodes and their standard uncertainty, in the unit of the site.
    is_cutting_only : bool
        It is absent while the blade runs in air.

    Examples
    --------
    >>> term = LearnedTerm(
    ...     site="mechanical", quantities=("crank_speed_rad_s",), nodes=((60.0, 80.0, 100.0, 120.0),),
    ...     values=np.array([0.0, 1.0, 2.0, 3.0]), stds=np.full(4, 0.1),
    ... )
    >>> term.at([np.array([50.0, 90.0, 105.0])]).round(6).tolist()
    [0.0, 1.5, 2.25]
    """

    site: Site
    quantities: tuple[str, ...]
    nodes: tuple[tuple[float, ...], ...]
    values: Floats
    stds: Floats
    is_cutting_only: bool = False

    def __call__(self, baseline: Baseline, state: State) -> tuple[Signature, ...]:
        """Signature at a scale of 1; empty where a quantity was not measured."""
        found = [QUANTITIES[name].of(baseline, state) for name in self.quantities]
        measured = [np.broadcast_to(values, state.angle_rad.shape) for values in found if values is not None]
        if len(measured) < len(self.quantities):
            return ({},)
        return (placed(baseline, state, self.site, self.at(measured)),)

    def at(self, measured: list[Floats]) -> Floats:
        """Value at measured quantities, one array each, all of one shape; the edge's value outside of the range."""
        total: Floats = self.values
        shape = measured[0].shape
        for k, (name, nodes, values) in enumerate(zip(self.quantities, self.nodes, measured, strict=True)):
            weights = node_weights(nodes, values.ravel(), is_periodic=QUANTITIES[name].is_periodic)
            total = weights @ total.reshape(len(nodes), -1) if k == 0 else np.einsum("na,na...->n...", weights, total)
            total = total.reshape(len(weights), *self.values.shape[k + 1 :])
        return total.reshape(shape)

    @property
    def range(self) -> dict[str, tuple[float, float]]:
        """First and last node of each quantity; a whole turn of the crank angle."""
        ends = {name: (nodes[0], nodes[-1]) for name, nodes in zip(self.quantities, self.nodes, strict=True)}
        return {name: (0.0, TWO_PI) if QUANTITIES[name].is_periodic else end for name, end in ends.items()}


def placed(baseline: Baseline, state: State, site: Site, wave: Floats) -> Signature:
    """Change of the residuals for a wave that stands at a site, shape of the state."""
    return force_error(baseline, state, wave) if site == "force_reading" else {site: wave}


def node_weights(nodes: tuple[float, ...], values: Floats, *, is_periodic: bool) -> Floats:
    """What each node's value counts at some places, shape (len(values), len(nodes)); clamped to the range."""
    values = np.mod(values, TWO_PI) if is_periodic else np.clip(values, nodes[0], nodes[-1])
    return np.asarray(_cardinal(nodes, is_periodic)(values), dtype=np.float64)


@lru_cache(maxsize=64)
def _cardinal(nodes: tuple[float, ...], is_periodic: bool) -> BSpline:
    """Spline through 1 at one node and 0 at all others, for each node."""
    from scipy.interpolate import make_interp_spline

    ones = np.eye(len(nodes))
    if is_periodic:
        return make_interp_spline(np.append(nodes, nodes[0] + TWO_PI), np.vstack([ones, ones[:1]]), bc_type="periodic")
    return make_interp_spline(np.array(nodes), ones)


def learned_effect(term: LearnedTerm) -> Effect:
    """Build the effect that a table is, of the magnitude 1."""
    place, _, channel = SITES[term.site]
    quantities = [QUANTITIES[name] for name in term.quantities]
    return Effect(
        name=NAME,
        place=place,
        equation=f"a table over {', '.join(q.words for q in quantities)}",
        words=Words(
            happens="something without a name depends on " + " and ".join(q.words for q in quantities),
            measure="the same again, at other values of these quantities",
            mend="",
        ),
        strength=Strength(
            name="scale", unit="1", typical=1.0, low=0.1, high=10.0, source="learned from the residuals of a campaign"
        ),
        signature=term,
        silent_in=("start_up", "air") if term.is_cutting_only else ("start_up",),
        needs=(channel,),
        grows_with=tuple(dict.fromkeys(g for q in quantities for g in q.grows_with)),
        memories=tuple(dict.fromkeys(m for q in quantities for m in q.memories)),
    )


def out_of_range(known: Sequence[Any], baseline: Baseline, states: Sequence[State]) -> tuple[str, ...]:
    """Say where learned terms are used outside of the range that they were learned in, one sentence a quantity.

    Parameters
    ----------
    known : sequence of KnownEffect
        Others than learned ones are passed over.
    baseline : Baseline
    states : sequence of State
        At which they are evaluated; start-ups are passed over.
    """
    said = []
    for one in known:
        if not isinstance(one, KnownEffect) or not isinstance(one.effect.signature, LearnedTerm):
            continue
        term = one.effect.signature
        acting = [s for s in states if s.kind != "start_up" and not (term.is_cutting_only and s.setting.is_idle)]
        for name, (low, high) in term.range.items():
            quantity = QUANTITIES[name]
            found = [] if quantity.is_periodic else [quantity.of(baseline, state) for state in acting]
            values = [part.ravel() for part in found if part is not None]
            if not values:
                continue
            least, most = float(np.min(np.concatenate(values))), float(np.max(np.concatenate(values)))
            slack = _TOLERATED * (high - low)
            if least < low - slack or most > high + slack:
                said.append(
                    f"[effects] {NAME} holds for {quantity.words} from {low:.4g} to {high:.4g} {quantity.unit}; here it"
                    f" is used from {least:.4g} to {most:.4g} {quantity.unit}: beyond the range the value at its edge"
                    " is taken"
                )
    return tuple(said)
