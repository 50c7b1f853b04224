"""How every figure of a page looks: colours that a colour-blind reader and a grey printer tell apart."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.machines.words import MachineWords

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK: Final = "#1b1f23"
QUIET: Final = "#52595f"
MODEL: Final = "#000000"
FORCE_COLOUR: Final = "#c2410c"
CHANNEL_COLOURS: Final = {
    "force_n": FORCE_COLOUR,
    "displacement_mm": "#0072b2",
    "motor_current_a": "#00795a",
    "battery_current_a": "#6a4fa3",
    "battery_voltage_v": "#a0447f",
}
SERIES_COLOURS: Final = ("#0072b2", "#c2410c", "#00795a", "#a0447f", "#6a4fa3", "#7a6100", "#4d4d4d")
SERIES_DASHES: Final = ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (6, 2, 1.5, 2)))
SERIES_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X")
WIDTH_IN: Final = 9.2
"""Width of a figure that fills the page, inches; at this width a point is about a CSS pixel."""


@contextmanager
def figure_style() -> Iterator[None]:
    """Set matplotlib's defaults for the figures made inside, and put them back."""
    import matplotlib as mpl

    style: dict[Any, Any] = {
        "font.family": "DejaVu Sans",
        "font.size": 9.5,
        "axes.titlesize": 10.5,
        "axes.titlelocation": "left",
        "axes.labelsize": 9.5,
        "axes.edgecolor": QUIET,
        "axes.labelcolor": INK,
        "text.color": INK,
        "xtick.color": QUIET,
        "ytick.color": QUIET,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": "#e3e6e8",
        "grid.linewidth": 0.7,
        "axes.axisbelow": True,
        "lines.linewidth": 1.4,
        "legend.frameon": False,
        "hatch.linewidth": 0.6,
    }
    with mpl.rc_context(style):
        yield


def thin_out(time_s: Floats, values: Floats, *, n_points: int = 1600) -> tuple[Floats, Floats]:
    """Keep the smallest and the largest sample of equal stretches of time: few points, every peak.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
    n_points : int
        Largest number of points that remain.

    Returns
    -------
    time_s, values : ndarray, shape (m,)

    Examples
    --------
    >>> t, v = thin_out(np.arange(10_000) / 1e4, np.eye(1, 10_000, 5003)[0], n_points=100)
    >>> len(t) <= 100, v.max()
    (True, np.float64(1.0))
    """
    if len(time_s) <= n_points:
        return time_s, values
    edges = np.linspace(time_s[0], time_s[-1], n_points // 2 + 1)[1:-1]
    bucket = np.searchsorted(edges, time_s, side="right")
    order = np.lexsort((values, bucket))
    is_first = np.r_[True, np.diff(bucket[order]) != 0]
    is_last = np.r_[is_first[1:], True]
    is_kept = np.logical_or(is_first, is_last)
    kept = np.unique(order[is_kept])
    return time_s[kept], values[kept]


def cycle_axis(axes: Axes, words: MachineWords) -> None:
    """Label the phase within a cycle in degrees; of a crank the dead centres are ticks."""
    axes.set_xlim(0.0, 360.0)
    axes.set_xticks([0, 45, 90, 135, 180, 225, 270, 315, 360])
    axes.set_xlabel(f"{words.angle} / °")
