"""From the tables of battery testers to a `[battery]` table."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sawbench.bench.errors import InputError

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.modeling.battery_choice import BatteryChoice
    from sawbench.modeling.battery_fit import BatteryModel
    from sawbench.modeling.measured_discharge import MeasuredDischarge
    from sawbench.storage.importers import TableMap


@dataclass(frozen=True, kw_only=True, slots=True)
class Pack:
    """How the measured cells make up the battery of the tool.

    Attributes
    ----------
    series, parallel : int
        Of what was measured: 5 and 1 for five measured cells in a row, 1 and 1 where the battery itself was measured.
    """

    series: int = 1
    parallel: int = 1

    def of(self, discharge: MeasuredDischarge) -> MeasuredDischarge:
        """Return the discharge of the battery whose cells behave as measured."""
        return replace(
            discharge, current_a=self.parallel * discharge.current_a, voltage_v=self.series * discharge.voltage_v
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class FittedBattery:
    """A battery fitted to measured discharges.

    Attributes
    ----------
    choice : BatteryChoice
    pack : Pack
    table : dict
        The `[battery]` table.
    files : tuple of str
    notes : tuple of str
        How the tables were read.
    """

    choice: BatteryChoice
    pack: Pack
    table: dict[str, Any]
    files: tuple[str, ...]
    notes: tuple[str, ...]

    def as_toml(self, base: LoadedConfig | None = None) -> str:
        """Return the table as TOML; with `base`, that whole configuration with its `[battery]` replaced."""
        from sawbench.bench.toml_writing import toml_text

        tables = {} if base is None else tomllib.loads(base.text.removeprefix("\ufeff"))
        pack = self.pack
        comments = {
            ("battery",): (
                f"Written by `sawbench battery fit` from {len(self.choice.discharges)} discharges of "
                + ", ".join(self.files),
                *([f"Measured cells: {pack.series} in series, {pack.parallel} in parallel."] if pack != Pack() else []),
                "`fitted` states the range of validity; runtime_rel_std and std are one standard uncertainty.",
            )
        }
        return toml_text({**tables, "battery": self.table}, comments)


def read_discharges(
    paths: Sequence[Path], table_map: TableMap | None, *, temperature_c: float | None = None
) -> tuple[list[MeasuredDischarge], list[str]]:
    """Read the whole discharges of battery testers' tables.

    Parameters
    ----------
    paths : sequence of Path
    table_map : TableMap, optional
    temperature_c : float, optional
        Of the surroundings, where the tables hold no temperature.

    Returns
    -------
    discharges : list of MeasuredDischarge
    notes : list of str

    Raises
    ------
    InputError
        If a table cannot be read or has no discharge.
    """
    from sawbench.modeling.measured_discharge import BatteryLog, discharges_in
    from sawbench.storage.importers.discharge_tables import read_discharge_tables

    found: list[MeasuredDischarge] = []
    notes: list[str] = []
    for path in paths:
        tables = read_discharge_tables(path, table_map)
        for table in tables:
            log = BatteryLog(
                time_s=table.time_s, current_a=table.current_a, voltage_v=table.voltage_v, label=table.label,
                temperature_c=table.temperature_c, cycle=table.cycle,
            )  # fmt: skip
            discharges, said = discharges_in(log)
            found += [
                replace(d, start_temperature_c=temperature_c) if d.start_temperature_c is None else d
                for d in discharges
            ]
            notes += said
            if table is tables[0]:
                notes += [f"warning: {path.name}: {text}" for text in table.warnings]
                notes += [f"{path.name}: {channel} <- {words}" for channel, words in table.taken.items()]
    return found, notes


# Size: options by name, those of `sawbench battery fit`.
def fit_battery_tables(
    paths: Sequence[Path],
    *,
    table_map: TableMap | None = None,
    pack: Pack | None = None,
    temperature_c: float | None = None,
    cutoff_voltage_v: float | None = None,
    cutoff_soc: float | None = None,
    models: Sequence[BatteryModel] | None = None,
    largest_own_miss: float | None = None,
    on_model: Callable[[int, int, str], None] | None = None,
) -> FittedBattery:
    """Fit a battery to measured discharges, each from full charge.

    Parameters
    ----------
    paths : sequence of Path
    table_map : TableMap, optional
    pack : Pack, optional
        Default: the battery itself was measured.
    temperature_c : float, optional
        Of the surroundings, where the tables hold no temperature.
    cutoff_voltage_v : float, optional
        Of the battery; default: the highest voltage that all discharges fall to.
    cutoff_soc : float, optional
        Of the tool; default: the voltage alone ends a run.
    models, largest_own_miss, on_model
        As in `choose_battery`.

    Raises
    ------
    InputError
        If a table is wrong, or there are fewer than two discharges.
    UntrustedResult
        If every model contradicts the discharges it was fitted to, or predicts none of the withheld ones.
    """
    from sawbench.modeling.battery_choice import LARGEST_OWN_MISS, MODELS, battery_config, choose_battery

    repeated = [str(path) for path in paths if list(paths).count(path) > 1]
    if repeated:
        raise InputError("is given more than once", where=repeated[0], remedy="give every table once")
    pack = pack or Pack()
    discharges, notes = read_discharges(paths, table_map, temperature_c=temperature_c)
    choice = choose_battery(
        [pack.of(discharge) for discharge in discharges],
        cutoff_voltage_v=cutoff_voltage_v,
        models=models or MODELS,
        largest_own_miss=LARGEST_OWN_MISS if largest_own_miss is None else largest_own_miss,
        on_model=on_model,
    )
    return FittedBattery(
        choice=choice,
        pack=pack,
        table=battery_config(choice, cutoff_soc=cutoff_soc),
        files=tuple(path.name for path in paths),
        notes=tuple(notes),
    )
