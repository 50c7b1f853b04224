"""`sawbench runtime --sweep`: the runtime over k_Fc, duty and capacity."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
from sawbench.bench.errors import InputError
from sawbench.commands.options import refuse_unwritable
from sawbench.commands.terminal import emit, progress, table

if TYPE_CHECKING:
    from sawbench.bench.config import BatteryConfig, LoadedConfig
    from sawbench.modeling.battery_range import BatteryUse
    from sawbench.modeling.runtime_sweep import RuntimeSweep

MOST_CASES = 20_000


@dataclass(frozen=True, kw_only=True, slots=True)
class SweepChoice:
    """What the options of a sweep say; None where they say nothing."""

    k_fc_range: tuple[float, float, int] | None = None
    duties: str | None = None
    capacities: str | None = None
    csv_path: Path | None = None
    plot_path: Path | None = None


def sweep(
    loaded: LoadedConfig,
    choice: SweepChoice,
    *,
    k_fc: float,
    duty: float | None,
    use: BatteryUse,
    force: bool,
    as_json: bool,
) -> int:
    """Run the sweep, print it, write what was asked for; 0 where any case has a runtime."""
    from sawbench.reporting.runtime_sweep import FORMATS, sweep_rows, write_sweep_picture
    from sawbench.storage.output import write_whole

    if loaded.config.converter.mode == "held_voltage":
        raise InputError(
            "[converter] controls the motor voltage, so there is no duty to sweep",
            where=loaded.path,
            remedy='set [converter] mode = "fixed_duty"',
        )
    k_values = _coefficients(choice.k_fc_range, k_fc)
    duty = loaded.config.converter.default_duty if duty is None else duty
    duties = _numbers("--duties", choice.duties, [0.75 * duty, duty, min(1.25 * duty, 1.0)], most=1.0)
    capacity_ah = loaded.battery().capacity_ah
    capacities = _numbers("--capacities", choice.capacities, [capacity_ah, 4 / 3 * capacity_ah, 8 / 3 * capacity_ah])
    if len(k_values) * len(duties) * len(capacities) > MOST_CASES:
        raise click.UsageError(f"the sweep has more than {MOST_CASES} cases: give fewer values")
    for path in (choice.csv_path, choice.plot_path):
        if path is not None:
            refuse_unwritable(path, force=force)
    if choice.plot_path is not None and choice.plot_path.suffix.lower() not in FORMATS:
        raise click.UsageError(f"--plot must end in {' or '.join(FORMATS)}, got {str(choice.plot_path)!r}")
    found = _swept(loaded, use, k_fc_values=k_values, duties=duties, capacities_ah=capacities)
    rows = sweep_rows(found)
    if choice.csv_path is not None:
        write_whole(choice.csv_path, _csv(rows), overwrite=force)
    if choice.plot_path is not None:
        write_sweep_picture(choice.plot_path, found, overwrite=force)
    written = [str(path) for path in (choice.csv_path, choice.plot_path) if path is not None]
    emit(rows, "\n".join([describe(found, loaded.battery()), *written]), as_json=as_json)
    return 0 if (found.status == "ok").any() else 1


def _swept(loaded: LoadedConfig, use: BatteryUse, **cases: list[float]) -> RuntimeSweep:
    """Run the cases by the model that the configuration describes, its known effects and fitted battery included."""
    from sawbench.model_setup import battery_of, parameters_of
    from sawbench.modeling.machines.saw_baseline import baseline_of
    from sawbench.modeling.runtime_sweep import sweep_runtime, sweep_runtime_with_effects, with_battery_range

    battery, baseline = loaded.battery(), baseline_of(loaded)
    steps = partial(progress, description="sweeping")
    if baseline.known:
        found = sweep_runtime_with_effects(baseline, **cases, steps=steps)
    else:
        found = sweep_runtime(
            parameters_of(loaded),
            battery=battery_of(loaded),
            **cases,
            cutting_half=loaded.config.cutting.cutting_half,
            cutoff_soc=battery.cutoff_soc,
            cutoff_voltage_v=battery.cutoff_voltage_v,
            steps=steps,
        )
    return with_battery_range(found, battery, use)


def describe(found: RuntimeSweep, battery: BatteryConfig) -> str:
    """One table a capacity, then what is known of the uncertainty."""
    from sawbench.modeling.battery_range import basis_of
    from sawbench.reporting.runtime_sweep import sweep_cells

    parts = []
    for c, capacity_ah in enumerate(found.capacity_ah):
        headers, rows = sweep_cells(found, c)
        parts.append(f"runtime with {capacity_ah:g} Ah\n{table(headers, rows)}\n")
    if found.effects_std_s is not None:
        share = 100.0 * found.effects_std_s / found.runtime_s
        parts.append(f"u(runtime) from [effects]: {np.nanmin(share):.2g} to {np.nanmax(share):.2g} %")
    if battery.fitted is not None:
        parts.append(basis_of(battery.fitted))
    if found.notes:
        parts.append("* outside the fitted range (extrapolated); details for each case: --json, --csv")
    return "\n".join(parts)


def _coefficients(asked: tuple[float, float, int] | None, k_fc: float) -> list[float]:
    low, high, n_values = asked or (0.5 * k_fc, 2.0 * k_fc, 7)
    if not (math.isfinite(low) and math.isfinite(high) and 0 <= low < high and n_values >= 2):
        raise click.UsageError(
            f"--k-fc-range is {low:g} {high:g} {n_values}: it needs 0 <= LOW < HIGH in N*s/m and N >= 2"
        )
    return np.linspace(low, high, n_values).tolist()


def _numbers(option: str, text: str | None, default: list[float], *, most: float = math.inf) -> list[float]:
    """Read numbers with commas between; in order, each once."""
    if text is None:
        return sorted(set(default))
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise click.UsageError(f"{option} is {text!r}: expected numbers separated by commas") from None
    if not all(math.isfinite(value) and 0 < value <= most for value in values):
        allowed = "above 0" if math.isinf(most) else f"above 0 and up to {most:g}"
        raise click.UsageError(f"{option} is {text!r}: allowed are numbers {allowed}")
    return sorted(set(values))


def _csv(rows: list[dict[str, object]]) -> str:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, fieldnames=list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
