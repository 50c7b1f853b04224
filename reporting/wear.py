"""Wear of the blade over a series: how far k_Fc has grown since the blade's first trial, and the 20 % rule.

The paper changes the blade when its teeth are rounded or the specific force has grown by 20 % (`bench.wear_rule`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sawbench.bench.wear_rule import BLADE_GROWTH_LIMIT, is_worn
from sawbench.reporting.compared_trial import ComparedTrial
from sawbench.reporting.figures import QUIET, SERIES_COLOURS, SERIES_DASHES, SERIES_MARKERS, WIDTH_IN, figure_style
from sawbench.reporting.grouping import Setting
from sawbench.reporting.html import Picture, figure_to_svg


@dataclass(frozen=True, kw_only=True, slots=True)
class WornTrial:
    """A trial in the life of its blade.

    Attributes
    ----------
    blade, material, name : str
    setting : Setting
    cut_m : float or None
        Length that the blade had cut at the end of this trial, m; None where a feed is not stated.
    growth, growth_std : float
        k_Fc over that of the blade's first trial in this material at this setting, less 1.
    """

    blade: str
    material: str
    name: str
    setting: Setting
    cut_m: float | None
    growth: float
    growth_std: float

    @property
    def is_worn(self) -> bool:
        """Whether the 20 % rule asks for another blade."""
        return is_worn(self.growth)


def cut_length_m(row: ComparedTrial) -> float | None:
    """Length cut in a trial: feed times the time the saw ran; 0 in air, None where the feed is not stated."""
    trial = row.processed.trial
    if trial.is_idle or row.processed.status == "no_cutting":
        return 0.0
    if trial.feed_mm_s is None:
        return None
    moving = ("spin_up", "running", "spin_down")
    seconds = sum(phase.end_s - phase.start_s for phase in row.processed.phases if phase.kind in moving)
    return 1e-3 * trial.feed_mm_s * seconds


def wear_of(rows: Sequence[ComparedTrial], names: dict[str, str]) -> tuple[WornTrial, ...]:
    """Follow each blade through its trials, in the order of their dates.

    Parameters
    ----------
    rows : sequence of ComparedTrial
        Those that are left out of the comparison too: they wore the blade.
    names : dict
        Spelling of a material to its name.

    Returns
    -------
    tuple of WornTrial
        Trials whose blade, date and k_Fc are known, of blades with two or more at one material and setting.
    """
    dated = [row for row in rows if row.processed.trial.blade and row.processed.trial.started_at]
    dated.sort(key=lambda row: (row.processed.trial.blade, row.processed.trial.started_at, row.name))
    found: list[WornTrial] = []
    cut: dict[str, float | None] = {}
    first: dict[tuple[str, str, Setting], tuple[float, float]] = {}
    for row in dated:
        trial = row.processed.trial
        blade = str(trial.blade)
        before, own = cut.get(blade, 0.0), cut_length_m(row)
        cut[blade] = None if before is None or own is None else before + own
        if row.left_out_because or row.fit is None or row.fit.status != "ok" or trial.is_idle or trial.material is None:
            continue
        key = (blade, names[trial.material], Setting.of(trial))
        now = (row.fit.k_fc_n_s_per_m, row.fit.statistical_std_n_s_per_m)
        start = first.setdefault(key, now)
        ratio = now[0] / start[0]
        std = 0.0 if now is start else ratio * math.hypot(now[1] / now[0], start[1] / start[0])
        found.append(
            WornTrial(
                blade=blade, material=key[1], setting=key[2], name=row.name, cut_m=cut[blade], growth=ratio - 1.0,
                growth_std=std,
            )
        )  # fmt: skip
    keys = [(one.blade, one.material, one.setting) for one in found]
    return tuple(one for one, key in zip(found, keys, strict=True) if keys.count(key) > 1)


def wear_picture(found: Sequence[WornTrial]) -> Picture | None:
    """Draw the growth of k_Fc over the length that each blade has cut.

    Returns
    -------
    Picture or None
        None where no length is known.
    """
    from matplotlib.figure import Figure

    lines: dict[tuple[str, str, Setting], list[WornTrial]] = {}
    for one in found:
        if one.cut_m is not None:
            lines.setdefault((one.blade, one.material, one.setting), []).append(one)
    if not lines:
        return None
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 3.2), layout="constrained")
        axis = figure.subplots()
        for index, ((blade, material, _), trials) in enumerate(sorted(lines.items(), key=lambda item: str(item[0]))):
            axis.errorbar(
                [one.cut_m for one in trials if one.cut_m is not None],
                [100.0 * one.growth for one in trials],
                yerr=[100.0 * one.growth_std for one in trials],
                color=SERIES_COLOURS[index % len(SERIES_COLOURS)],
                linestyle=SERIES_DASHES[index % len(SERIES_DASHES)],
                marker=SERIES_MARKERS[index % len(SERIES_MARKERS)],
                markersize=4.5, capsize=2.5, linewidth=1.1,
                label=f"{blade}, {material}, {trials[0].setting.label}",
            )  # fmt: skip
        axis.axhline(100.0 * BLADE_GROWTH_LIMIT, color=QUIET, linestyle="--", linewidth=1.0)
        axis.annotate(
            f"change the blade at {100.0 * BLADE_GROWTH_LIMIT:.0f} %", (0.01, 100.0 * BLADE_GROWTH_LIMIT),
            xycoords=("axes fraction", "data"), va="bottom", fontsize=8.5, color=QUIET,
        )  # fmt: skip
        axis.set_ylim(top=max(axis.get_ylim()[1], 125.0 * BLADE_GROWTH_LIMIT))
        axis.set_xlabel("length of the kerf cut by the blade / m")
        axis.set_ylabel("growth of $k_{Fc}$ / %")
        figure.legend(loc="outside lower center", ncols=2, fontsize=8.5)
        largest = max(found, key=lambda one: one.growth)
        svg = figure_to_svg(
            figure, name="wear", title="Growth of k_Fc with the length cut",
            description=f"Largest growth: {100.0 * largest.growth:.1f} % in {largest.name}, blade {largest.blade}.",
        )  # fmt: skip
    return Picture(
        svg=svg,
        caption="k_Fc of each trial relative to the blade's first trial in the same material at the same setting; bars:"
        " one standard uncertainty. The length includes every trial of the blade in this comparison.",
    )
