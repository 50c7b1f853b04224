"""Diagnose a surgical tool's reciprocating drive with a viscous-only axis: which friction, how much it closes.

The logs are those of the Medical Robotics and Devices Lab, University of Minnesota (O'Neill, Stephens, Kowalewski,
IEEE RA-L 2018, doi 10.1109/LRA.2018.2849862; Open Database License): a motor with gearbox drives a cable-driven
tool back and forth at 0.1 to 0.5 Hz against a set torque; torque is measured at both ends, motor current and angle.

    python benchmarks/davinci_axis.py FOLDER_OF_LOGS OUT

writes OUT/STAGE/campaign.toml with tables and configuration for each stage of the drive, which `sawbench import`
and `sawbench diagnose` then take, and prints what the diagnosis finds. Rotation becomes travel on a lever of 10 mm.
"""

from __future__ import annotations

import gzip
import json
import re
import sys
from pathlib import Path

import numpy as np

LEVER_M = 0.01
COUNTS_A_TURN_BACK, COUNTS_A_TURN_FRONT = 8192, 4000
TORQUE_N_M_A_COUNT = 3.9811e-5
N_COLUMNS = 10
# What stands on which side: (drive channel, load channel, lines for the drive).
_MOTOR = "force_constant_n_per_a = { nominal = 90.0, rel_std = 0.15 }\n"
STAGES = {
    "tool": ("back_force_n", "force_n", ""),
    "tool, load not measured": ("back_force_n", None, ""),
    "whole drive": ("motor_current_a", "force_n", _MOTOR),
    "whole drive, load not measured": ("motor_current_a", None, _MOTOR),
    "motor and gearbox": ("motor_current_a", "back_force_n", _MOTOR),
}
_TITLE = re.compile(r"([\d.]+) Hz Sine.*?reaction torque of ([\d.]+) percent")


def read_log(path: Path) -> tuple[dict[str, np.ndarray], float, float]:
    """Read one log as the channels of an axis.

    Parameters
    ----------
    path : Path
        Text, or text in gzip: ten columns after lines that begin with %.

    Returns
    -------
    columns : dict of str to ndarray, shape (n,)
        `time_s`, `displacement_mm`, `motor_current_a`, `back_force_n` (drive side), `force_n` (load side, carried
        to the drive side by the ratio of the two encoders).
    rate_hz, load_percent : float
        As the header says.
    """
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rt") as stream:
        lines = stream.read().splitlines()
    title = _TITLE.search(" ".join(line for line in lines if line.startswith("%")))
    if title is None:
        raise ValueError(f"{path}: the header names no frequency and torque")
    rows = [line.split(",") for line in lines if not line.startswith("%")]
    table = np.array([row for row in rows if len(row) == N_COLUMNS], dtype=float)
    angle = 2 * np.pi * table[:, 1] / COUNTS_A_TURN_BACK
    front = 2 * np.pi * table[:, 4] / COUNTS_A_TURN_FRONT
    ratio = float(np.polyfit(angle, front, 1)[0])
    to_n = TORQUE_N_M_A_COUNT / LEVER_M
    columns = {
        "time_s": table[:, 0],
        "displacement_mm": 1e3 * LEVER_M * angle,
        # Torque and current are counted against the angle; turned round, the drive does positive work.
        "motor_current_a": -table[:, 3],
        "back_force_n": -to_n * table[:, 2],
        "force_n": -ratio * to_n * table[:, 5],
    }
    return columns, float(title[1]), float(title[2])


def write_campaign(folder: Path, out: Path, stage: str) -> Path:
    """Write tables, configuration and `campaign.toml` of one stage; returns the path of the last."""
    drive, load, constant = STAGES[stage]
    out.mkdir(parents=True, exist_ok=True)
    entries = ['config = "bench_config.toml"\n']
    for path in sorted(folder.glob("*.TXT*")):
        columns, rate_hz, load_percent = read_log(path)
        name = path.name.split(".")[0]
        np.savetxt(
            out / f"{name}.csv", np.array(list(columns.values())).T, delimiter=",", fmt="%.7g", comments="",
            header=",".join(columns),
        )  # fmt: skip
        entries.append(
            f'[[trial]]\nfile = "{name}.csv"\nworkpiece = "load {load_percent:g} %"\nnotes = "{rate_hz:g} Hz"\n'
        )
    (out / "campaign.toml").write_text("\n".join(entries))
    (out / "bench_config.toml").write_text(
        "[linear_axis]\n"
        "moving_mass_kg = { nominal = 0.1, rel_std = 1.0 }\n"
        # The slope of torque over speed at 0.3 Hz, the middle of the sweep: what a viscous-only model is set to.
        "viscous_damping_n_s_per_m = { nominal = 500.0, rel_std = 0.5 }\n"
        f'drive_channel = "{drive}"\n{constant}'
        + ("" if load is None else f'load_channel = "{load}"\nload_gain_rel_std = 0.02\n')
    )
    return out / "campaign.toml"


def main(folder: Path, out: Path) -> None:
    """Diagnose every stage and print what was found."""
    from sawbench.commands.main import main as sawbench

    for stage in STAGES:
        place = out / re.sub(r"\W+", "_", stage)
        campaign = write_campaign(folder, place, stage)
        sawbench(["import", str(campaign), "--out", str(place / "mcap"), "--force"])
        sawbench(["diagnose", str(place / "mcap"), "--out", str(place / "gap"), "--force"])
        report = json.loads((place / "gap" / "gap_report.json").read_text())
        print(f"\n{stage}: {report['verdict']}")
        for cause in report["causes"]:
            numbers = ", ".join(f"{k} {v['value']:.3g} +- {v['std']:.2g}" for k, v in cause["parameters"].items())
            low, high = cause["gap_closed_ci95"]
            print(
                f"  {cause['probability']:6.3f} {' + '.join(cause['effects'])}: closes {cause['gap_closed']:.2f} "
                f"({low:.2f} to {high:.2f}); {numbers}"
            )
        dry = sum(p for name, p in report["detail"]["probabilities"].items() if "guide_friction" in name.split(" + "))
        print(f"  dry friction takes part: {dry:.2f}")
        print(f"  {json.dumps(report['probabilities'])}\n  {json.dumps(report['gap']['by_channel'])}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
