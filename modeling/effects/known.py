"""An effect whose magnitude is known: it belongs to the model, and its uncertainty to that of the prediction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, TransferFunction
from sawbench.modeling.residuals import Signature
from sawbench.modeling.state import State

# An effect without a stated uncertainty is as well known as a plant constant without one, relative.
_LEAST_REL_STD: Final = 1e-3
_LEAST_CARRIED, _MOST_CARRIED = 1e-9, 1e9


@dataclass(frozen=True, kw_only=True, slots=True)
class KnownEffect:
    """One effect of the machine, in one form and at one magnitude.

    Attributes
    ----------
    effect : Effect
        As the machine has it.
    value, std : float
        Of the effect's parameter, in its unit; `std` is one standard uncertainty.
    form : mapping of str to float
        Numbers of the form, without the one that the parameter itself is.
    direction : tuple of float, optional
        Coefficients of the signatures in proportion, where there are several (phases): only their ratio counts.
    scales : mapping of str to float
        What the form is stated relative to (`Effect.scales`); without an entry that of the campaign at hand.

    Examples
    --------
    >>> from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
    >>> known = KnownEffect(effect=EFFECT_BY_NAME["force_sensor_lag"], value=2e-3, form={"damping": 0.0})
    >>> known.shape, known.coefficients.tolist()
    ({'damping': 0.0, 'tau_s': 0.002}, [1.0])
    """

    effect: Effect
    value: float
    std: float = 0.0
    form: Mapping[str, float] = field(default_factory=dict)
    direction: tuple[float, ...] = (1.0,)
    scales: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Parameter with its effect, as in `guide_friction.force_n`."""
        return f"{self.effect.name}.{self.effect.strength.name}"

    @property
    def shape(self) -> dict[str, float]:
        """Numbers of the form; the parameter among them where it is one."""
        key = self.effect.carried_by(self.form)
        return dict(self.form) if key is None else {**self.form, key: carried(self.effect, self.form, key, self.value)}

    @property
    def coefficients(self) -> Floats:
        """Of the signatures, in units of the parameter, shape (n_signatures,)."""
        if self.effect.carried_by(self.form) is not None:
            return np.array(self.direction)
        direction = np.array(self.direction)
        one = self.effect.amplitude(direction) if len(direction) > 1 else float(direction[0])
        return direction * (self.value / self.effect.reported_strength(one, dict(self.form)))

    def signature(self, model: Any, state: State) -> Signature:
        """Change of the residuals that it makes, in the equations that the state's channels allow."""
        if self.value == 0.0 and self.effect.carried_by(self.form) is None:
            return {}
        model = replace(model, known=(), **{k: v for k, v in self.scales.items() if hasattr(model, k)})
        # Known effects are taken off the force before the coefficient is regressed.
        scales = {k: v for k, v in self.scales.items() if hasattr(state, k)}
        state = replace(state, regressed_at_rad_s=0.0, **scales)
        return self.effect.combined(model, state, self.shape, self.coefficients)

    def transfers(self, state: State) -> Mapping[str, TransferFunction]:
        """Of a sensor: how it shows what other effects add, by equation; none where it does not distort."""
        distorts = self.effect.distorts
        return {} if distorts is None else distorts(state, self.coefficients, **self.shape)

    def uncertainty(self, model: Any, state: State) -> Signature:
        """Change of the residuals for one standard uncertainty of the parameter, by central difference."""
        std = max(self.std, _LEAST_REL_STD * abs(self.value))
        step = min(std, 0.5 * abs(self.value)) if self.value else std
        up, down = (self.at(self.value + sign * step).signature(model, state) for sign in (1.0, -1.0))
        return {name: (up[name] - down.get(name, 0.0)) * (0.5 * std / step) for name in up}

    def at(self, value: float) -> KnownEffect:
        """Return the same form at another magnitude."""
        return replace(self, value=value)


def carried(effect: Effect, form: Mapping[str, float], key: str, value: float) -> float:
    """Number of the form, under `key`, at which an amplitude of one is `value` of the parameter.

    Raises
    ------
    ValueError
        If no number of the form gives that value.
    """
    from scipy.optimize import root_scalar

    def reported(number: float) -> float:
        return effect.reported_strength(1.0, {**form, key: number})

    if reported(value) == value:
        return value
    low, high = np.log(_LEAST_CARRIED), np.log(_MOST_CARRIED)
    if (reported(_LEAST_CARRIED) - value) * (reported(_MOST_CARRIED) - value) > 0.0:
        raise ValueError(f"no {key} of this form results in {value!r}")
    found = root_scalar(
        lambda log: reported(float(np.exp(log))) - value, method="brentq", bracket=(low, high), xtol=1e-14
    )
    return float(np.exp(found.root))
