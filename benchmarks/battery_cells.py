"""Withhold real discharges from the battery models, write the page with all rates and temperatures.

python -m benchmarks.battery_cells --cells DIR --out docs/battery_cells.md
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from sawbench.batteries import read_discharges
from sawbench.bench.errors import InputError, UntrustedResult
from sawbench.modeling.battery_choice import BatteryChoice, choose_battery
from sawbench.modeling.measured_discharge import MeasuredDischarge
from sawbench.reporting.battery_page import MODEL_HEAD, battery_text
from sawbench.storage.importers import ColumnRule, TableMap

FILE = "LGM50_5Ah_RateTest.mat"
COLUMNS = {
    "time_s": "timeVec",
    "battery_current_a": "currVec",
    "battery_voltage_v": "volVec",
    "temperature_c": "cellTemp_mid",
}
STAR_MAP = TableMap(columns={name: ColumnRule(column=f"*.*.{column}") for name, column in COLUMNS.items()})
HEAD = """# Real cells against the battery models

LG M50 cells (5 Ah), constant current down to 2.5 V. Written by `benchmarks/battery_cells.py`: every rate and
temperature that was measured, the bad ones too. How a model is chosen, and what the columns are: `docs/battery.md`.
"Own fit" is the runtime error of the fit to all discharges of the table.
"""
WHY = """In the cold the models err more: the cell heats itself by up to 42 K at 2C, which they do not know, and its
resistance falls by half.
"""


def read_cells(directory: Path) -> dict[str, dict[str, MeasuredDischarge]]:
    """Discharges by temperature and rate: `cells["25"]["0.5C"]`."""
    path = directory / FILE
    if not path.exists():
        raise InputError("no such file", where=path, remedy="name the folder of the LG M50 rate tests with --cells")
    cells: dict[str, dict[str, MeasuredDischarge]] = {}
    for discharge in read_discharges([path], STAR_MAP)[0]:
        temperature, rate = discharge.label.split()[-2:]
        temperature, rate = temperature.removeprefix("T"), rate.removeprefix("cRate_").replace("p", ".")
        cells.setdefault(temperature, {})[rate] = replace(discharge, label=rate)
    return cells


def choices(cells: dict[str, dict[str, MeasuredDischarge]]) -> dict[str, BatteryChoice]:
    """Choose the model of each temperature."""
    return {temperature: choose_battery(list(rates.values())) for temperature, rates in cells.items()}


def refused_together(cells: dict[str, dict[str, MeasuredDischarge]]) -> str:
    """Say what fitting all temperatures at once is answered with."""
    together = [
        replace(discharge, label=f"{rate} at {temperature} degC")
        for temperature, rates in cells.items()
        for rate, discharge in rates.items()
    ]
    try:
        choose_battery(together)
    except UntrustedResult as error:
        return str(error)
    raise AssertionError("all temperatures together are no longer refused: say so on the page")


def page(chosen: dict[str, BatteryChoice], refusal: str) -> str:
    """Return the page as Markdown."""
    lines = [HEAD]
    for temperature, choice in chosen.items():
        text = battery_text(choice)
        lines += [f"## {temperature} degC", ""]
        lines += _table(MODEL_HEAD, text.models)
        lines += [f"Withheld from `{choice.chosen.model}`:", ""]
        head = ("rate", "measured", "predicted", "runtime error", "voltage error", "own fit")
        lines += _table(head, [[row[0], *row[3:]] for row in text.discharges])
    lines += [WHY, "## All temperatures in one fit", "", "It is refused:", "", "```", refusal, "```"]
    return "\n".join(lines) + "\n"


def _table(head: tuple[str, ...], rows: list[list[str]]) -> list[str]:
    marks = "|".join(["---"] * len(head))
    return [f"| {' | '.join(head)} |", f"|{marks}|", *(f"| {' | '.join(row)} |" for row in rows), ""]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=Path, required=True, help="folder with the LG M50 rate tests")
    parser.add_argument("--out", type=Path, help="page to write; printed without it")
    options = parser.parse_args()
    cells = read_cells(options.cells)
    text = page(choices(cells), refused_together(cells))
    if options.out is None:
        print(text, end="")
    else:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
