"""Results as they show themselves in a notebook: a sentence, a table, a figure."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from markupsafe import Markup
from sawbench.bench.processed import ProcessedTrial
from sawbench.bench.recording import Floats, Recording
from sawbench.modeling.machines.words import SAW, MachineWords
from sawbench.modeling.results import CuttingFit, RuntimePrediction
from sawbench.reporting.cause_words import interval_words, name_of
from sawbench.reporting.compared import FIT_STATUS_WORDS, QUANTITIES, RUNTIME_STATUS_WORDS, Comparison
from sawbench.reporting.comparison_figures import dots_picture
from sawbench.reporting.gap_figures import ladder_picture
from sawbench.reporting.gap_page import closest_description, known_effects, rungs_of, verdict_sentence
from sawbench.reporting.html import Picture, still_svg
from sawbench.reporting.quantities import format_duration, format_quantity
from sawbench.reporting.trial_figures import cycle_picture, signals_picture
from sawbench.reporting.trial_page import verdict

_PREVIEW_S = 1.0
_SHOWN_EVENTS = {"note", "gap", "warning", "interrupted"}
_SVG_NAMESPACE = 'xmlns="http://www.w3.org/2000/svg"'


def recording_block(recording: Recording, *, text: str = "", words: MachineWords = SAW) -> str:
    """Settings, channels and the first second of a recording.

    Parameters
    ----------
    recording : Recording
    text : str
        Said above the table.
    words : MachineWords
    """
    trial = recording.trial
    rows = [
        (name, signal.unit, f"{len(signal.values)}", f"{signal.rate_hz:.6g} Hz", f"{signal.duration_s:.4g} s",
         f"{len(signal.gaps)}")
        for name, signal in recording.signals.items()
    ]  # fmt: skip
    heading = f"Trial {trial.trial_id}: {trial.material or f'{words.load} not stated'}"
    duty = "duty not stated" if trial.duty is None else f"duty {trial.duty:.4g}"
    texts = [
        f"{duty}; source: {trial.source}",
        text,
        *(event.text for event in recording.events if event.kind in _SHOWN_EVENTS),
    ]
    table = _table(("channel", "unit", "samples", "rate", "duration", "gaps"), rows)
    return _block(heading, texts, [table], [signals_picture(recording, words=words, seconds=_PREVIEW_S)])


def processed_block(processed: ProcessedTrial) -> str:
    """What the processing found, and the folded cycle."""
    rows = [
        (row.channel, f"{row.rate_hz:.6g} Hz", f"{row.n_missing}",
         format_quantity(row.noise_std, None, row.unit, digits=2), "; ".join(row.problems) or "none")
        for row in processed.quality
    ]  # fmt: skip
    table = _table(("channel", "rate", "missing samples", "noise (standard deviation)", "problems"), rows)
    texts = [verdict(processed, None, None), *processed.warnings]
    return _block(f"Trial {processed.trial.trial_id}", texts, [table], [cycle_picture(processed, None)])


def fit_block(processed: ProcessedTrial, fit: CuttingFit, model: Mapping[str, Floats] | None) -> str:
    """k_Fc with its uncertainty, and the fitted model over the folded cycle."""
    rows = [("k_Fc", format_quantity(fit.k_fc_n_s_per_m, fit.std_n_s_per_m, "N·s/m"))]
    if fit.rmse_a is not None:
        rows.append(("RMSE of the motor current", format_quantity(fit.rmse_a, None, "A", digits=3)))
    if fit.rmse_n is not None:
        rows.append(("RMSE of the force", format_quantity(fit.rmse_n, None, "N", digits=3)))
    rows += [("method", fit.method.replace("_", " ")), ("status", FIT_STATUS_WORDS[fit.status])]
    texts = [fit.identifiability, *fit.notes]
    heading = f"Cutting coefficient of trial {processed.trial.trial_id}"
    return _block(heading, texts, [_table(("quantity", "value ± standard uncertainty"), rows)],
                  [cycle_picture(processed, model)])  # fmt: skip


def runtime_block(trial_id: str, found: RuntimePrediction) -> str:
    """Battery runtime, and what its uncertainty comes from."""
    if found.status != "ok":
        return _block(f"Battery runtime, trial {trial_id}", [f"None: {RUNTIME_STATUS_WORDS[found.status]}."], [], [])
    end = "state of charge" if found.ended_by == "soc" else "voltage"
    lasts = f"{format_quantity(found.runtime_s, found.std_s, 's')} ({format_duration(found.runtime_s)})"
    rows = [
        ("runtime", lasts),
        ("mean battery current of the model", format_quantity(found.mean_battery_current_a, None, "A")),
        ("mean motor current of the model", format_quantity(found.mean_motor_current_a, None, "A")),
    ]
    if found.appendix_a_runtime_s is not None:
        rows.append(("runtime from the measured mean current", format_quantity(found.appendix_a_runtime_s, None, "s")))
    parts = sorted(found.contributions_s.items(), key=lambda item: -item[1])
    shares = [(name, f"{std_s:.2g} s") for name, std_s in parts if std_s > 0]
    tables = [_table(("quantity", "value ± standard uncertainty"), rows)]
    tables += [_table(("uncertainty from", "standard uncertainty"), shares)] if shares else []
    texts = [f"Until the cut-off {end}.", found.battery_basis, *(f"Note: {text}." for text in found.notes)]
    return _block(f"Battery runtime, trial {trial_id}", texts, tables, [])


def comparison_block(found: Comparison) -> str:
    """One row a series, and a dot a trial."""
    shown = [q for q in QUANTITIES if any(q.key in one.means for one in found.series)]
    rows = [
        (one.label, f"{len(one.trials)}",
         *(q.written(one.means[q.key]) if q.key in one.means else "-" for q in shown))
        for one in found.series
    ]  # fmt: skip
    table = _table(("series", "trials", *(q.label for q in shown)), rows)
    left = [f"{item.name}: {item.reason}" for item in found.left_out]
    return _block(
        "Comparison of materials",
        ["Mean of the repetitions ± its standard uncertainty.", *left],
        [table],
        [dots_picture(found.series)],
    )


def gap_block(report: Mapping[str, Any]) -> str:
    """The verdict, the causes with their probabilities, and the error channel by channel."""
    rows = []
    for cause in report["causes"]:
        closed, interval = round(100.0 * cause["gap_closed"]), interval_words(cause["gap_closed_ci95"])
        rows.append(
            (" and ".join(name_of(name) for name in cause["effects"]), f"{100 * cause['probability']:.1f} %",
             f"{closed} % ({interval})")
        )  # fmt: skip
    others = sorted(report["probabilities"].items(), key=lambda item: -item[1])
    rows += [(name.replace("_", " "), f"{100 * p:.1f} %", "") for name, p in others]
    table = _table(("cause", "probability", "explained (95 % interval)"), rows)
    texts = [verdict_sentence(report), *closest_description(report), *known_effects(report)]
    picture = ladder_picture(report["gap"]["by_channel"], rungs_of(report["verdict"]))
    return _block("Sim-to-real gap", [*texts, f"Next trial: {report['next_trial']}."], [table], [picture])


def _block(heading: str, texts: Iterable[str], tables: Sequence[Markup], pictures: Iterable[Picture | None]) -> str:
    said = [Markup("<p>{}</p>").format(text) for text in texts if text.strip(" .")]
    shown = [_image(picture) for picture in pictures if picture is not None]
    return str(Markup("<div><h4>{}</h4>{}</div>").format(heading, Markup("").join([*said, *tables, *shown])))


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Markup:
    headings = Markup("").join(Markup('<th scope="col">{}</th>').format(cell) for cell in head)
    body = Markup("").join(
        Markup("<tr>{}</tr>").format(Markup("").join(Markup("<td>{}</td>").format(cell) for cell in row))
        for row in rows
    )
    return Markup("<table><thead><tr>{}</tr></thead><tbody>{}</tbody></table>").format(headings, body)


def _image(picture: Picture) -> Markup:
    """An SVG in a document of its own: identifiers of two figures in one notebook cannot meet."""
    svg = still_svg(picture).replace("<svg ", f"<svg {_SVG_NAMESPACE} ", 1)
    data = base64.b64encode(svg.encode()).decode()
    form = '<figure><img style="max-width:100%;background:white" alt="{0}" src="data:image/svg+xml;base64,{1}">' \
           "<figcaption>{0}</figcaption></figure>"  # fmt: skip
    return Markup(form).format(picture.caption, data)
