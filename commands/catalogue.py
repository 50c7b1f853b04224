"""`sawbench catalogue`: what an archive holds."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Any, Final

import click
from sawbench.commands.options import PLACE, json_option
from sawbench.commands.terminal import emit, table

if TYPE_CHECKING:
    import pandas
    from sawbench.storage.places import Place

_NAMES: Final = ("material", "blade", "battery", "operator", "quality")
_NUMBERS: Final = {
    "stroke_period_s": ("stroke_period_std_s", 1e3, "period / ms"),
    "k_fc_n_s_per_m": ("k_fc_std_n_s_per_m", 1.0, "k_Fc / N·s/m"),
    "runtime_s": ("runtime_std_s", 1.0, "runtime / s"),
}
_SHOWN: Final = (
    "trial_id", *_NAMES, "started_at", "status",
    *(name for value, (std, *_) in _NUMBERS.items() for name in (value, std)),
    "fit_status", "runtime_status", "error", "source", "source_sha256", "software", "evaluated_at",
)  # fmt: skip


@click.command(name="catalogue", epilog="Example: sawbench catalogue archive --material oak --since 2026-03-01")
@click.argument("directory", metavar="DIR", type=PLACE)
@click.option("--material", help="Only this material; 'none' for idle runs.")
@click.option("--blade", help="Only this blade.")
@click.option("--battery", help="Only this battery.")
@click.option("--operator", help="Only recordings of this operator.")
@click.option("--quality", help="Only this quality: good, failed, 'doubted channel', ... as the table names it.")
@click.option("--since", type=click.DateTime(["%Y-%m-%d"]), metavar="DATE", help="Started on this day (UTC) or later.")
@click.option("--until", type=click.DateTime(["%Y-%m-%d"]), metavar="DATE", help="Started on this day (UTC) or before.")
@click.option("--period", type=(float, float), metavar="LOW HIGH", help="Stroke period from LOW to HIGH, ms.")
@click.option("--k-fc", type=(float, float), metavar="LOW HIGH", help="k_Fc from LOW to HIGH, N·s/m.")
@json_option
def command(
    directory: Place,
    since: datetime | None,
    until: datetime | None,
    period: tuple[float, float] | None,
    k_fc: tuple[float, float] | None,
    as_json: bool,
    **wanted: str | None,
) -> int:
    """List the recordings of an archive, with what was found in them; make one with `process --archive DIR`."""
    from sawbench.archive.table import ResultTable

    found: Any = ResultTable(directory).read(_SHOWN)
    n_all = len(found)
    for name, value in wanted.items():
        if value is not None:
            found = found[found[name] == value]
    for name, span in (("stroke_period_s", period), ("k_fc_n_s_per_m", k_fc)):
        if span is not None:
            found = found[(_NUMBERS[name][1] * found[name]).between(*span)]
    days = found["started_at"].dt.strftime("%Y-%m-%d")
    for given, is_inside in ((since, lambda day: days >= day), (until, lambda day: days <= day)):
        if given is not None:
            found = found[is_inside(f"{given:%Y-%m-%d}").reindex(found.index, fill_value=False)]
    records: list[dict[str, Any]] = [
        {name: None if value != value else value for name, value in row.items()}  # noqa: PLR0124 (not known is NaN)
        for row in found[list(_SHOWN)].astype(object).to_dict("records")
    ]
    emit(records, f"{describe(found)}\n{len(found)} of {n_all} recordings", as_json=as_json)
    return 0


def describe(found: pandas.DataFrame) -> str:
    """One row per recording, then the reasons of those that failed."""
    from sawbench.reporting.quantities import format_quantity

    rows, reasons = [], []
    for row in found.astype(object).where(found.notna(), None).to_dict("records"):
        numbers = [
            "-" if row[value] is None else format_quantity(scale * row[value], scale * (row[std] or 0.0))
            for value, (std, scale, _) in _NUMBERS.items()
        ]
        name = row["trial_id"] or str(row["source"]).replace("\\", "/").rpartition("/")[2]
        day = "-" if row["started_at"] is None else f"{row['started_at']:%Y-%m-%d %H:%M}"
        rows.append([name, day, *(row[key] or "-" for key in _NAMES[:-1]), *numbers, row["quality"] or "-"])
        if row["error"]:
            reasons.append(f"{row['source']}: {row['error']}")
    head = ["trial", "started (UTC)", *_NAMES[:-1], *(label for *_, label in _NUMBERS.values()), "quality"]
    return "\n".join([table(head, rows), *reasons])
