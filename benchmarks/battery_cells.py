"""Fit real cells on slow discharges, predict the fast ones, write the page with all rates and temperatures.

python -m benchmarks.battery_cells --cells DIR --out docs/battery.md
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.modeling.battery_fit import BatteryModel, MeasuredDischarge, fit_battery, predict_discharge

FILE = "LGM50_5Ah_RateTest.mat"
CUTOFF_V = 2.5
SLOW = ("0.1C", "0.5C")
# model, rates it is fitted on, how the page calls it
VARIANTS: tuple[tuple[BatteryModel, tuple[str, ...], str], ...] = (
    ("eq16", ("0.5C",), "Eq. 16, capacity as delivered"),
    ("eq16_free", ("0.5C",), "Eq. 16, capacity free"),
    ("eq16_free_r", SLOW, "Eq. 16, capacity free, and R"),
    ("ocv_r", SLOW, "table of the 0.1C curve, and R"),
)
CHOSEN = "eq16_free"


def read_cells(directory: Path) -> dict[str, dict[str, MeasuredDischarge]]:
    """Discharges by temperature and rate: `cells["25"]["0.5C"]`."""
    from scipy.io import loadmat

    path = directory / FILE
    if not path.exists():
        raise InputError("no such file", where=path, remedy="name the folder of the LG M50 rate tests with --cells")
    table = loadmat(path, squeeze_me=True, struct_as_record=False)["LGM50_5Ah_RateTest"]
    cells: dict[str, dict[str, MeasuredDischarge]] = {}
    for temperature in table._fieldnames:
        runs = getattr(table, temperature)
        rates = {}
        for name in runs._fieldnames:
            run = getattr(runs, name)
            rate = name.removeprefix("cRate_").replace("p", ".")
            discharging = run.currVec < -0.05
            first = int(np.argmax(discharging))
            stop = first + int(np.argmax(~discharging[first:]))
            label = f"{temperature.removeprefix('T')} degC, {rate}"
            rates[rate] = MeasuredDischarge(
                time_s=run.timeVec[first:stop] - run.timeVec[first],
                current_a=-run.currVec[first:stop],
                voltage_v=run.volVec[first:stop],
                label=label,
            )
        cells[temperature.removeprefix("T")] = rates
    return cells


def rows(cells: dict[str, dict[str, MeasuredDischarge]]) -> list[dict]:
    """One row a model, temperature and rate: predicted and measured runtime."""
    table = []
    for model, fitted_on, title in VARIANTS:
        for temperature, rates in cells.items():
            fit = fit_battery([rates[rate] for rate in fitted_on], model=model)
            for rate, discharge in rates.items():
                predicted = predict_discharge(fit, current_a=discharge.mean_current_a, cutoff_voltage_v=CUTOFF_V)
                voltage_v = fit.voltage_v(discharge.charge_a_s, discharge.current_a)
                table.append(
                    {
                        "model": model,
                        "title": title,
                        "temperature": temperature,
                        "rate": rate,
                        "is_fitted": rate in fitted_on,
                        "predicted_s": predicted.duration_s,
                        "status": predicted.status,
                        "measured_s": discharge.duration_s,
                        "error": predicted.duration_s / discharge.duration_s - 1.0,
                        "rmse_mv": 1e3 * float(np.sqrt(np.mean((voltage_v - discharge.voltage_v) ** 2))),
                        "fit": fit,
                    }
                )
    return table


HEAD = """# Real cells against the battery models

LG M50 cells (5 Ah), constant-current discharges to 2.5 V. Written by `benchmarks/battery_cells.py`;
every rate and temperature that was measured is shown, the bad ones too. Samples count as the tester
logged them. Runtimes beside a rate the model was fitted on are no predictions and are marked *fitted*.
"""
WHY = """
The goal is 3 % at 10 and 25 degC; at 25 degC it is met by a hair. Why the models with a resistance are
worse at 2C in the cold: the cell heats itself by up to 42 K at 2C, which these models do not know, and
its resistance falls by half. The resistance seen between 0.1C and 0.5C is that of the cold cell. Leaving
it out, so that it hides in V_nom, errs the other way and happens to err less. Eq. 16 with its capacity
tied is the worst in voltage: it must fall to 0 V when the charge is gone, where the cell was stopped at
2.5 V.
"""


def page(table: list[dict]) -> str:
    """Return the page as Markdown."""
    chosen = [row for row in table if row["model"] == CHOSEN and row["rate"] == "2C"]
    lines = [
        HEAD,
        f"The model chosen is `{CHOSEN}` on the 0.5C discharge: its 2C runtime is",
        "",
    ]
    lines += [
        f"- {row['error']:+.1%} at {row['temperature']} degC ({row['predicted_s']:.0f} s against "
        f"{row['measured_s']:.0f} s measured)"
        for row in chosen
    ]
    lines.append(WHY)
    for model, fitted_on, title in VARIANTS:
        rows_of_model = [row for row in table if row["model"] == model]
        lines += [f"## {title} (`{model}`, fitted on {' and '.join(fitted_on)})", ""]
        lines += _section(rows_of_model)
    return "\n".join(lines)


def _section(rows_of_model: list[dict]) -> list[str]:
    lines = [
        "| temperature degC | rate | measured s | predicted s | error | voltage RMSE mV | |",
        "|---|---|---|---|---|---|---|",
    ]
    fits = {}
    for row in rows_of_model:
        mark = "fitted" if row["is_fitted"] else "" if row["status"] == "ok" else row["status"]
        lines.append(
            f"| {row['temperature']} | {row['rate']} | {row['measured_s']:.0f} | "
            f"{row['predicted_s']:.0f} | {row['error']:+.1%} | {row['rmse_mv']:.0f} | {mark} |"
        )
        fits[row["temperature"]] = row["fit"]
    lines.append("")
    for temperature, fit in fits.items():
        shape = "" if fit.beta is None else f"V_nom {fit.nominal_voltage_v:.3f} V, beta {fit.beta:.3f}, "
        resistance = f"R {1e3 * fit.internal_resistance_ohm:.1f} mOhm"
        drop = "R in V_nom" if fit.internal_resistance_ohm == 0 else resistance
        lines.append(f"- {temperature} degC: {shape}Q {fit.capacity_ah:.3f} Ah, {drop}")
    return [*lines, ""]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=Path, required=True, help="folder with the LG M50 rate tests")
    parser.add_argument("--out", type=Path, help="page to write; printed without it")
    options = parser.parse_args()
    text = page(rows(read_cells(options.cells)))
    if options.out is None:
        print(text)
    else:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
