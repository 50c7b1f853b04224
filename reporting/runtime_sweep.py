"""The what-if sweep of the battery runtime: a picture, a text table, and rows for CSV and JSON."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.reporting.figures import INK, QUIET, SERIES_COLOURS, SERIES_DASHES, SERIES_MARKERS, figure_style
from sawbench.storage.output import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from sawbench.bench.recording import Floats
    from sawbench.modeling.runtime_sweep import RuntimeSweep

FORMATS: Final = (".svg", ".png")
WORDS: Final = {
    "stalled": "stalls",
    "cannot_start": "cannot start",
    "never_reached": "cut-off never reached",
}
MOST_PANELS_ABREAST: Final = 3


def sweep_rows(sweep: RuntimeSweep) -> list[dict[str, Any]]:
    """Give one row per case, also for those without a runtime.

    Returns
    -------
    list of dict
        `capacity_ah`, `duty`, `k_fc_n_s_per_m`, `runtime_s`, `mean_battery_current_a` (None without a
        runtime), `status`, `effects_std_s` and `battery_std_s` (None where none is stated) and `note`.
    """

    def at(values: Floats | None, place: tuple[int, int, int]) -> float | None:
        return float(values[place]) if values is not None and sweep.status[place] == "ok" else None

    rows: list[dict[str, Any]] = []
    for c, capacity_ah in enumerate(sweep.capacity_ah):
        for d, duty in enumerate(sweep.duty):
            for k, k_fc in enumerate(sweep.k_fc_n_s_per_m):
                place = (k, d, c)
                rows.append(
                    {
                        "capacity_ah": float(capacity_ah),
                        "duty": float(duty),
                        "k_fc_n_s_per_m": float(k_fc),
                        "runtime_s": at(sweep.runtime_s, place),
                        "mean_battery_current_a": at(sweep.mean_battery_current_a, place),
                        "status": str(sweep.status[place]),
                        "effects_std_s": at(sweep.effects_std_s, place),
                        "battery_std_s": at(sweep.battery_std_s, place),
                        "note": "; ".join(sweep.notes.get(place, ())),
                    }
                )
    return rows


def sweep_cells(sweep: RuntimeSweep, capacity: int) -> tuple[list[str], list[list[str]]]:
    """Lay the runtimes of one capacity out: a row a k_Fc, a column a duty; the status where there is none.

    A star marks what lies outside of the range that something was fitted to (`RuntimeSweep.notes`).

    Parameters
    ----------
    sweep : RuntimeSweep
    capacity : int
        Place in `sweep.capacity_ah`.

    Returns
    -------
    headers : list of str
    rows : list of list of str
    """
    headers = ["k_Fc / N·s/m", *(f"duty {duty:.4g}" for duty in sweep.duty)]
    rows = []
    for k, k_fc in enumerate(sweep.k_fc_n_s_per_m):
        cells = [f"{k_fc:.4g}"]
        for d in range(len(sweep.duty)):
            status = str(sweep.status[k, d, capacity])
            star = "*" if (k, d, capacity) in sweep.notes else ""
            runtime = f"{sweep.runtime_s[k, d, capacity]:.0f} s{star}"
            cells.append(runtime if status == "ok" else WORDS.get(status, status))
        rows.append(cells)
    return headers, rows


def write_sweep_picture(path: str | Path, sweep: RuntimeSweep, *, overwrite: bool = False) -> Path:
    """Draw the runtime over k_Fc: a line a duty, a panel a capacity; cases without a runtime as crosses.

    Parameters
    ----------
    path : str or Path
        `.svg` or `.png`; its folder must exist.
    sweep : RuntimeSweep
    overwrite : bool

    Raises
    ------
    InputError
        If the ending is another, the file exists and `overwrite` is not set, or it cannot be written.
    """
    import matplotlib as mpl

    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"the picture must end in {' or '.join(FORMATS)}, got {path.suffix!r}", where=path)
    with figure_style(), mpl.rc_context({"svg.hashsalt": "runtime-sweep", "svg.fonttype": "none"}):
        figure = draw_sweep(sweep)
        metadata = {"Date": None} if path.suffix.lower() == ".svg" else {"Software": None}
        picture = io.BytesIO()
        figure.savefig(picture, format=path.suffix.lower().removeprefix("."), dpi=150, metadata=metadata)
    return write_whole(path, picture.getvalue(), overwrite=overwrite)


def draw_sweep(sweep: RuntimeSweep) -> Figure:
    """Draw the panels of `write_sweep_picture`; the axes are in the order of the capacities."""
    from matplotlib.figure import Figure

    n_panels = len(sweep.capacity_ah)
    n_columns = min(n_panels, MOST_PANELS_ABREAST)
    n_rows = -(-n_panels // n_columns)
    figure = Figure(figsize=(2.2 + 3.1 * n_columns, 0.7 + 3.3 * n_rows), layout="constrained")
    axes = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False).ravel()
    for c, axis in enumerate(axes[:n_panels]):
        _draw_panel(axis, sweep, c)
        axis.set_title(f"{sweep.capacity_ah[c]:g} Ah")
        axis.tick_params(labelbottom=True)
        if c % n_columns == 0:
            axis.set_ylabel("runtime / min")
        if c + n_columns >= n_panels:
            axis.set_xlabel("k_Fc / N·s/m")
    # After all panels: they share the axis, and a limit set earlier would stop it from growing.
    axes[0].set_ylim(bottom=0.0)
    for axis in axes[n_panels:]:
        axis.remove()
    handles, labels = axes[0].get_legend_handles_labels()
    if (sweep.status != "ok").any():
        handles.append(axes[0].plot([], [], "x", color=INK, markersize=7)[0])
        labels.append("no runtime:\nstalls or\ncannot start")
    if sweep.notes:
        handles.append(axes[0].plot([], [], "o", color=INK, markerfacecolor="white", markersize=6)[0])
        labels.append("outside of\nwhat was\nfitted")
    figure.legend(handles, labels, loc="outside right upper", title="PWM duty")
    figure.suptitle("Battery runtime to the cut-off", x=0.01, ha="left", color=QUIET, fontsize=9.5)
    return figure


def _draw_panel(axis: Axes, sweep: RuntimeSweep, capacity: int) -> None:
    k_fc = sweep.k_fc_n_s_per_m
    for d, duty in enumerate(sweep.duty):
        colour = SERIES_COLOURS[d % len(SERIES_COLOURS)]
        axis.plot(
            k_fc,
            sweep.runtime_s[:, d, capacity] / 60.0,
            color=colour,
            linestyle=SERIES_DASHES[d % len(SERIES_DASHES)],
            marker=SERIES_MARKERS[d % len(SERIES_MARKERS)],
            markersize=4,
            label=f"{duty:.4g}",
        )
        is_outside = [(k, d, capacity) in sweep.notes for k in range(len(k_fc))]
        axis.plot(
            k_fc[is_outside], sweep.runtime_s[is_outside, d, capacity] / 60.0, SERIES_MARKERS[d % len(SERIES_MARKERS)],
            color=colour, markerfacecolor="white", markersize=6,
        )  # fmt: skip
        is_without = sweep.status[:, d, capacity] != "ok"
        if is_without.any():
            # On the lower edge, one row a duty, so that crosses of several duties do not hide each other.
            height = np.full(int(is_without.sum()), 0.02 + 0.035 * d)
            axis.plot(
                k_fc[is_without], height, "x", color=colour, markersize=7, clip_on=False,
                transform=axis.get_xaxis_transform(),
            )  # fmt: skip
    axis.margins(x=0.04)
