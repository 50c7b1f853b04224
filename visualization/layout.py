"""What the technician sees: panels, names, colours, and the text beside the plots."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

from sawbench.bench.processed import ProcessedTrial
from sawbench.bench.recording import Event, Trial
from sawbench.bench.units import BATTERY_CURRENT, BATTERY_VOLTAGE, CHANNEL_BY_NAME, DISPLACEMENT, FORCE, MOTOR_CURRENT
from sawbench.modeling.machines.words import SAW, MachineWords
from sawbench.visualization.sdk import TimelineColumn, rr, rrb

TIMELINE: Final = "time"
STROKE_RATE: Final = "stroke_rate_hz"
STROKE_RATE_PATH: Final = f"signals/{STROKE_RATE}"
K_FC: Final = "k_fc_n_s_per_m"
REMAINING: Final = "remaining_runtime_s"
TRIAL_PATH: Final = "trial"
EVENTS_PATH: Final = "events"
CYCLE_PATH: Final = "cycle"
MECHANISM_PATH: Final = "mechanism"


@dataclass(frozen=True, kw_only=True, slots=True)
class Series:
    """One line of the display.

    Attributes
    ----------
    path : str
        Rerun entity.
    title : str
        Panel title, with the unit.
    name : str
        Name in the legend.
    colour : tuple of int
        Red, green, blue; from the Okabe-Ito set, legible on a dark and on a light theme.
    """

    path: str
    title: str
    name: str
    colour: tuple[int, int, int]

    @property
    def simulated_path(self) -> str:
        """Entity of the fitted model: Rerun draws in the order of the paths, and what is below a path before it."""
        return f"{self.path}_simulated"


# What the bench shows, in this order, from the Okabe-Ito set.
COLOURS: Final = {
    FORCE.name: (230, 110, 20),
    DISPLACEMENT.name: (86, 180, 233),
    STROKE_RATE: (240, 220, 90),
    MOTOR_CURRENT.name: (0, 178, 130),
    BATTERY_VOLTAGE.name: (204, 121, 167),
    BATTERY_CURRENT.name: (150, 140, 220),
    K_FC: (200, 200, 200),
    REMAINING: (213, 94, 0),
}
_OTHER_COLOUR: Final = (170, 170, 170)
_ESTIMATES: Final = {
    K_FC: ("k_Fc ± its uncertainty / N·s/m, updated every stroke", "k_Fc"),
    REMAINING: ("Remaining runtime at this load / s", "remaining runtime"),
}
_HIDDEN_TIME: Final = TimelineColumn(TIMELINE, visible=False)
"""Rerun cuts its time column short; the text of an event begins with the time instead."""
_TEXT_COLUMNS: Final = 160
_LEFT: Final = (FORCE.name, DISPLACEMENT.name, "stroke_rate_hz", K_FC)
_RIGHT: Final = (MOTOR_CURRENT.name, BATTERY_CURRENT.name, BATTERY_VOLTAGE.name, REMAINING)


def series_of(channel: str, unit: str = "", words: MachineWords = SAW) -> Series:
    """Return how a channel is drawn; a channel of an importer gets a panel of its own, in grey.

    Examples
    --------
    >>> series_of("displacement_mm").title, series_of("drive_force_n", "N").title
    ('Blade displacement / mm', 'drive_force_n / N')
    """
    title, name = _ESTIMATES.get(channel) or _named(channel, unit, words)
    return Series(path=f"signals/{channel}", title=title, name=name, colour=COLOURS.get(channel, _OTHER_COLOUR))


def _named(channel: str, unit: str, words: MachineWords) -> tuple[str, str]:
    """Title and name of what is measured."""
    if channel == STROKE_RATE:
        return f"{words.rate.capitalize()} / Hz", words.rate
    known = CHANNEL_BY_NAME.get(channel)
    if known is None:
        return (f"{channel} / {unit}" if unit else channel), channel
    label = words.label(channel)
    return f"{label.capitalize()} / {known.unit}", label


def make_blueprint(
    *,
    words: MachineWords = SAW,
    channels: Mapping[str, str] | None = None,
    has_cycle: bool = False,
    has_mechanism: bool = False,
    has_estimate: bool = False,
    simulated: Collection[str] = (),
    live_window_s: float | None = None,
) -> Any:
    """Lay out the panels.

    Parameters
    ----------
    words : MachineWords
        Of the machine that is shown.
    channels : mapping of str to str, optional
        Channel names that will be shown, with their units; the six of the bench by default. The stroke rate
        is shown where there is a displacement.
    has_cycle : bool
        Add the folded force cycle.
    has_mechanism : bool
        Add the crank and what hangs on it.
    has_estimate : bool
        Add k_Fc and the remaining runtime, which only a live view has.
    simulated : collection of str
        Channels that the fitted model is laid over; their panels get a legend.
    live_window_s : float, optional
        Show the last seconds only, moving along; the whole trial where absent.

    Returns
    -------
    rerun.blueprint.Blueprint
    """
    shown = dict.fromkeys(COLOURS, "") if channels is None else dict(channels)
    if live_window_s is None or not has_estimate:
        shown = {name: unit for name, unit in shown.items() if name not in {K_FC, REMAINING}}
    if DISPLACEMENT.name in shown:
        shown["stroke_rate_hz"] = "Hz"
    columns = [[name for name in column if name in shown] for column in (_LEFT, _RIGHT)]
    for name in shown:
        if name not in COLOURS:
            min(columns, key=len).append(name)
    plots = [
        rrb.Vertical(
            *[
                _panel(series_of(name, shown[name], words), live_window_s, has_legend=name in simulated)
                for name in column
            ]
        )
        for column in columns
        if column
    ]
    side: list[Any] = [rrb.TextDocumentView(origin=TRIAL_PATH, name="Trial")]
    shares = [5]
    if has_mechanism:
        side.append(rrb.Spatial2DView(origin=MECHANISM_PATH, name="Crank (yellow) and blade (orange)"))
        shares.append(2)
    if has_cycle:
        title = f"Mean force / N, {words.angle} / °"
        side.append(rrb.BarChartView(origin=CYCLE_PATH, name=title, plot_legend=rrb.PlotLegend(visible=False)))
        shares.append(3)
    columns_shown = rrb.TextLogColumns(timeline_columns=[_HIDDEN_TIME], text_log_columns=["LogLevel", "Body"])
    # As wide as the window, so that few texts need a second line.
    events = rrb.TextLogView(origin=EVENTS_PATH, name="Notes and events", columns=columns_shown)
    panels = rrb.Horizontal(*plots, rrb.Vertical(*side, row_shares=shares), column_shares=[3] * len(plots) + [2])
    return rrb.Blueprint(
        rrb.Vertical(panels, events, row_shares=[6, 1]),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="following" if live_window_s else "paused",
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _panel(series: Series, live_window_s: float | None, *, has_legend: bool) -> Any:
    options: dict[str, Any] = {}
    if live_window_s:
        options["time_ranges"] = rrb.VisibleTimeRange(
            TIMELINE,
            start=rrb.TimeRangeBoundary.cursor_relative(seconds=-live_window_s),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
    return rrb.TimeSeriesView(
        origin=f"/{series.path}",
        contents=["$origin/**", f"/{series.simulated_path}"],
        name=series.title,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        plot_legend=rrb.PlotLegend(visible=has_legend),
        **options,
    )


def log_style(recording: Any, series: Series) -> None:
    """Give a series its name, colour and width; peaks stay when many samples share a pixel."""
    style = rr.SeriesLines(colors=series.colour, names=series.name, widths=1.5, aggregation_policy="MinMax")
    recording.log(series.path, style, static=True)


def log_bounds_style(recording: Any, series: Series) -> None:
    """Draw the bounds of a series, `lower` and `upper` below its path, thin and dim."""
    dim = tuple(colour // 2 for colour in series.colour)
    for bound in ("lower", "upper"):
        style = rr.SeriesLines(colors=dim, names=f"{series.name} {bound}", widths=1.0)
        recording.log(f"{series.path}/{bound}", style, static=True)


def log_simulated_style(recording: Any, series: Series) -> None:
    """Draw what the fitted model gives over the series: thin and light."""
    style = rr.SeriesLines(colors=(250, 250, 250), names="fitted model", widths=1.0)
    recording.log(series.simulated_path, style, static=True)


def log_event(recording: Any, event: Event) -> None:
    """Put a note or an event into the event list at its time."""
    level = {"warning": "WARN", "gap": "WARN", "interrupted": "ERROR"}.get(event.kind, "INFO")
    what = " ".join(part for part in (event.kind, event.device, event.channel) if part)
    recording.set_time(TIMELINE, duration=event.time_s)
    # The view shows the first line of a text only, and cuts one that is too long.
    text = f"{event.time_s:.3f} s  {what}: {event.text}"
    for line in textwrap.wrap(text, _TEXT_COLUMNS, subsequent_indent="    "):
        recording.log(EVENTS_PATH, rr.TextLog(line, level=level))


def log_trial(recording: Any, trial: Trial, processed: ProcessedTrial | None = None, words: MachineWords = SAW) -> None:
    """Write the text panel."""
    text = trial_markdown(trial, processed, words)
    recording.log(TRIAL_PATH, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def trial_markdown(trial: Trial, processed: ProcessedTrial | None = None, words: MachineWords = SAW) -> str:
    """Describe a trial, and what the processing found, as Markdown.

    Examples
    --------
    >>> print(trial_markdown(Trial(trial_id="oak-01", material="oak", duty=0.4375)))
    # oak-01
    | Setting | |
    |---|---|
    | Material | oak |
    | Duty | 43.75 % |
    | Source | bench |
    """
    lines = [f"# {_plain(trial.trial_id)}"]
    if "simulated" in trial.source:
        lines += ["**Simulated bench: not a measurement.**", ""]
    rows: list[tuple[str, str | None]] = [
        (words.load.capitalize(), words.idle if trial.is_idle else trial.material),
        ("Repetition", None if trial.repetition is None else str(trial.repetition)),
        ("Duty", None if trial.duty is None else f"{100 * trial.duty:.4g} %"),
        ("Thickness", None if trial.thickness_mm is None else f"{trial.thickness_mm:g} mm"),
        ("Feed", None if trial.feed_mm_s is None else f"{trial.feed_mm_s:g} mm/s"),
        ("Blade", trial.blade),
        ("Battery", trial.battery),
        ("Operator", trial.operator),
        ("Started", None if trial.started_at is None else f"{trial.started_at:%Y-%m-%d %H:%M:%S %Z}"),
        ("Source", trial.source),
        ("Notes", trial.notes or None),
    ]
    if processed is not None:
        lines += _result_lines(processed, words)
    lines += ["| Setting | |", "|---|---|"] + [f"| {name} | {_plain(value)} |" for name, value in rows if value]
    return "\n".join(lines)


def _result_lines(processed: ProcessedTrial, words: MachineWords) -> list[str]:
    rows = [("Status", processed.status.replace("_", " "))]
    if processed.period is not None:
        period = processed.period
        rate_std_hz = period.period_std_s / period.period_s**2
        rows.append(
            (words.rate.capitalize(), f"{period.rate_hz:.3f} ± {rate_std_hz:.2g} Hz ({period.confidence} confidence)")
        )
    if processed.peak_force_n is not None:
        rows.append(("Peak force", f"{processed.peak_force_n:.1f} ± {processed.peak_force_std_n or 0.0:.2g} N"))
    lines = ["| Result | |", "|---|---|"] + [f"| {name} | {value} |" for name, value in rows]
    return [*lines, "", *(f"- {_plain(words.told(warning))}" for warning in processed.warnings), ""]


def _plain(text: str | None) -> str:
    """Make free text safe inside a Markdown table: one line, no markup of its own."""
    flat = " ".join((text or "").split())
    return "".join("\\" + sign if sign in "\\`*_[]<>|#" else sign for sign in flat)
