"""The baseline of a saw as it is configured; the catalogue of effects is loaded only where some are known."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sawbench.modeling.residuals import Baseline

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.modeling.effects.known import KnownEffect


def baseline_of(loaded: LoadedConfig) -> Baseline:
    """Compose the baseline of a saw, with the effects that its configuration states as known.

    Raises
    ------
    ConfigError
        If it describes no saw, or its `[effects]` table is wrong.
    """
    plant = loaded.plant()
    known: tuple[KnownEffect, ...] = ()
    if loaded.config.effects:
        from sawbench.modeling.machines.known_effects import known_effects

        known = known_effects(loaded.config, path=loaded.path)
    return Baseline(
        plant=plant,
        battery=loaded.config.battery,
        cutting_sign=-1 if loaded.config.cutting.cutting_half == "pi_to_2pi" else 1,
        known=known,
    )
