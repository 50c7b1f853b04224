"""The pages: right numbers, safe text, nothing from outside, readable by everyone."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.bench.folded import FoldedCycle, pooled
from sawbench.bench.processed import (
    ChannelQuality,
    PeriodCandidate,
    PeriodEstimate,
    Phase,
    ProcessedTrial,
    RemovedForce,
)
from sawbench.bench.recording import Gap, Recording, Signal, Trial
from sawbench.commands.runtime import describe
from sawbench.modeling.discharge import DischargeCurves
from sawbench.modeling.results import CuttingFit, RuntimePrediction
from sawbench.processing.spectrum import power_spectrum
from sawbench.reporting.compared import ComparedTrial, LeftOut, compare, comparison_json
from sawbench.reporting.comparison_data import comparison_table
from sawbench.reporting.comparison_page import write_comparison_page
from sawbench.reporting.html import link_to
from sawbench.reporting.model_figures import deviations_of
from sawbench.reporting.spectrum_figures import harmonics_picture
from sawbench.reporting.trial_page import TrialReport, trust_in, verdict, write_trial_page

pytestmark = pytest.mark.unit

HOSTILE = "<script>alert('x')</script> & \"quoted\" <img src=http://evil.example/x.png>"
angle_rad = (np.arange(128) + 0.5) * 2.0 * np.pi / 128


def folded(channel="force_n", unit="N", mean=None, std=2.0, n_cycles=40):
    mean = (
        np.where(angle_rad > np.pi, -200.0 * np.sin(angle_rad), 4.0 * np.sin(2 * angle_rad)) if mean is None else mean
    )
    return FoldedCycle(
        channel=channel,
        unit=unit,
        angle_rad=angle_rad,
        mean=mean,
        std=np.full(128, std),
        count=np.full(128, n_cycles),
        n_cycles=n_cycles,
    )


def make_processed(trial_id="oak-01", material="oak", status="cutting", peak_force_n=205.3, **changes):
    settings = {"repetition": 1, "source": "simulated bench", "duty": 0.4375}
    settings |= changes.pop("trial", {})
    cutting = folded(mean=np.where(angle_rad > np.pi, -peak_force_n * np.sin(angle_rad), 0.0))
    values = {
        "trial": Trial(trial_id=trial_id, material=material, **settings),
        "status": status,
        "period": PeriodEstimate(
            period_s=0.08,
            period_std_s=6.4e-5,
            spread_s=4e-4,
            n_cycles=40,
            confidence="high",
            reason="one line stands out",
            channel="displacement_mm",
        ),
        "angle": None,
        "phases": (
            Phase(kind="spin_up", start_s=0.0, end_s=0.4),
            Phase(kind="running", start_s=0.4, end_s=1.5),
        ),
        "folded": {
            "force_n": folded(),
            "motor_current_a": folded("motor_current_a", "A", 8 + np.sin(angle_rad), 0.2),
        },
        "cutting_force": cutting,
        "removed": RemovedForce(
            mean_n=1.2, rms_n=3.1, peak_n=9.2, share_of_impulse=0.021, half="zero_to_pi", looks_swapped=False
        ),
        "peak_force_n": peak_force_n,
        "peak_force_std_n": 0.62,
        "mean_values": {"battery_current_a": 4.61},
        "rms_values": {"motor_current_a": 10.9},
        "quality": (
            ChannelQuality(
                channel="force_n",
                unit="N",
                rate_hz=5000.0,
                n_samples=7500,
                n_missing=0,
                jitter_std_s=2e-6,
                noise_std=1.5,
                n_spikes=0,
                n_clipped=0,
            ),
        ),
        "source_path": "oak-01.mcap",
        "source_sha256": "ab" * 32,
    }
    return ProcessedTrial(**(values | changes))


def make_fit(k_fc=240.287, std=4.31, statistical=0.92, status="ok", **changes):
    return CuttingFit(
        k_fc_n_s_per_m=k_fc,
        std_n_s_per_m=std,
        statistical_std_n_s_per_m=statistical,
        method="current",
        status=status,
        rmse_a=0.43,
        rmse_n=None,
        n_simulations=31,
        identifiability="Current alone cannot tell k_Fc from the torque constant.",
        **changes,
    )


def make_runtime(runtime_s=927.6, status="ok"):
    return RuntimePrediction(
        runtime_s=runtime_s,
        std_s=14.8,
        mean_battery_current_a=4.66,
        mean_motor_current_a=10.6,
        appendix_a_runtime_s=936.2,
        ended_by="soc",
        numerical_error_s=0.03,
        status=status,
        contributions_s={"k_fc_n_s_per_m": 9.2, "resistance_ohm": 8.1},
    )


def make_curves():
    falling = np.linspace(1.0, 0.2, 9)
    return DischargeCurves(
        time_s=np.linspace(0.0, 927.6, 9), soc=falling, battery_voltage_v=17.0 + falling,
        battery_current_a=np.full(9, 4.66), motor_current_a=np.full(9, 10.6), stroke_rate_hz=np.full(9, 12.5),
    )  # fmt: skip


def make_recording():
    time_s = np.arange(7500) / 5000.0
    kept = np.delete(time_s, slice(1000, 1500))
    force = Signal(
        channel="force_n",
        unit="N",
        time_s=kept,
        values=np.sin(80.0 * kept),
        gaps=(Gap(start_s=time_s[999], end_s=time_s[1500], n_missing=500),),
    )
    other = Signal(channel="bearing <b>", unit="K", time_s=time_s[::10], values=300.0 + time_s[::10])
    return Recording(trial=Trial(trial_id="oak-01"), signals={s.channel: s for s in (force, other)})


def make_rows():
    rows = []
    for material, k_fc in (("white oak", 240.0), ("nylon 6", 70.0)):
        for repetition in (1, 2, 3):
            value = k_fc * (1.0 + 0.004 * (repetition - 2))
            processed = make_processed(
                f"{material}-{repetition}",
                material,
                peak_force_n=value,
                trial={"repetition": repetition},
                source_sha256=f"{repetition}" * 64,
            )
            runtime = make_runtime(928.0 * 240.0 / value)
            rows.append(ComparedTrial(processed=processed, fit=make_fit(value, 0.02 * value, 1e-3), runtime=runtime))
    rows.append(ComparedTrial(processed=make_processed("pine-1", "pine"), fit=make_fit(130.0), runtime=make_runtime()))
    stalled = make_processed("pine-2", "pine", "stalled", period=None, cutting_force=None, peak_force_n=1.0)
    rows.append(ComparedTrial(processed=stalled))
    weak = ComparedTrial(processed=make_processed("pine-3", "pine"), fit=make_fit(status="not_identifiable"))
    rows.append(weak)
    idle = make_processed("air-1", "none", "no_cutting", cutting_force=None, removed=None, peak_force_std_n=None)
    rows.append(ComparedTrial(processed=replace(idle, peak_force_n=None)))
    return rows


class Page(HTMLParser):
    """A page as its reader meets it: tags, identifiers, words."""

    VOID = frozenset({"meta", "br", "img", "link", "input", "hr", "path", "use", "col"})

    def __init__(self, text):
        super().__init__()
        self.text, self.tags, self.ids, self.words, self.stack, self.headings = text, [], [], [], [], []
        self.feed(text)
        self.close()
        assert self.stack == [], f"left open: {self.stack}"

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.ids += [value for name, value in attrs if name == "id"]
        if tag in {"h1", "h2", "h3"}:
            self.headings.append(int(tag[1]))
        if tag not in self.VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.stack.pop()

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.stack.pop() == tag

    def handle_data(self, data):
        if not {"style", "script"} & set(self.stack):
            self.words.append(data)

    @property
    def shown(self):
        return " ".join(" ".join(self.words).replace("\N{NO-BREAK SPACE}", " ").split())


def full_report():
    """A report with every figure, and hostile words wherever somebody may type."""
    simulated = {
        "angle_rad": angle_rad,
        "force_n": np.clip(-190 * np.sin(angle_rad), 0, None),
        "motor_current_a": 8 + 0 * angle_rad,
    }
    trial = {"notes": HOSTILE, "operator": HOSTILE, "started_at": datetime(2026, 3, 2, 9, tzinfo=UTC)}
    return TrialReport(
        processed=make_processed(trial=trial, warnings=(HOSTILE,)),
        fit=make_fit(notes=(HOSTILE,)),
        runtime=make_runtime(),
        model={"linear force": simulated},
        discharges={"linear force": make_curves()},
        spectra={"force_n": power_spectrum(np.sin(2 * np.pi * 12.5 * np.arange(4000) / 1000.0), 1000.0)},
        recording=make_recording(),
    )


@pytest.fixture(scope="module")
def trial_path(tmp_path_factory):
    path = tmp_path_factory.mktemp("trial") / "oak-01.html"
    files = {"Recording": path.parent / "oak #1.mcap", "Rerun view": path.parent / "view" / "oak.rrd"}
    return write_trial_page(path, full_report(), files=files)


@pytest.fixture(scope="module")
def comparison_path(tmp_path_factory):
    path = tmp_path_factory.mktemp("comparison") / "report.html"
    left_out = [LeftOut(name=f"broken {HOSTILE}.mcap", reason="is not a recording")]
    return write_comparison_page(path, make_rows(), left_out=left_out)


@pytest.fixture(scope="module", params=["trial_path", "comparison_path"])
def page(request):
    return Page(request.getfixturevalue(request.param).read_text(encoding="utf-8"))


def script_of(page):
    """The one script of a page, which its policy allows by its hash."""
    (script,) = re.findall(r"<script>(.*?)</script>", page.text, re.S)
    return script


def test_pages_ask_nothing_of_the_network(page):
    own = script_of(page)
    text = page.text.replace(own, "").replace("http://evil.example", "")
    assert re.findall(r"(?:https?:)?//[a-z]", text) == []
    assert "evil.example" not in [value for _, attrs in page.tags for value in attrs.values()]
    assert not {"link", "img", "iframe", "object", "form"} & {tag for tag, _ in page.tags}
    assert "@import" not in page.text
    assert all(url.startswith("#") for url in re.findall(r"url\(([^)]+)\)", text))
    (policy,) = [attrs["content"] for tag, attrs in page.tags if "http-equiv" in attrs]
    allowed = base64.b64encode(hashlib.sha256(own.encode()).digest()).decode()
    assert policy == f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{allowed}'"


def test_free_text_stays_text(page):
    assert "<script>" not in page.text.replace(f"<script>{script_of(page)}", "")
    assert "<img" not in page.text
    assert "<script>alert('x')</script>" in page.shown


def test_pages_are_accessible(page):
    assert ("html", {"lang": "en"}) in page.tags
    assert page.headings[0] == 1
    assert page.headings.count(1) == 1
    assert all(after - before <= 1 for before, after in zip(page.headings, page.headings[1:], strict=False))
    assert [key for key, n in Counter(page.ids).items() if n > 1] == []
    pictures = [attrs for tag, attrs in page.tags if tag == "svg"]
    assert len(pictures) >= 2
    for attrs in pictures:
        assert attrs["role"] == "img"
        for label in attrs["aria-labelledby"].split():
            assert label in page.ids
            text = re.search(rf'id="{label}">([^<]+)<', page.text)
            assert text is not None
            assert len(text[1]) > 15
    assert all("scope" in attrs for tag, attrs in page.tags if tag == "th")
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', page.text))
    assert used <= set(page.ids)


def luminance(colour):
    channels = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_colours_have_contrast(page):
    from sawbench.reporting.figures import CHANNEL_COLOURS, SERIES_COLOURS

    light, dark = (
        dict(re.findall(r"--(\w+): (#\w{6})", block)) for block in re.findall(r":root {(.*?)}", page.text, re.S)
    )
    assert set(light) == set(dark)
    for named in (light, dark):
        wash = luminance(named["wash"])
        for name in ("ink", "quiet", "accent", "good", "warn", "bad"):
            darker, lighter = sorted((wash, luminance(named[name])))
            assert (lighter + 0.05) / (darker + 0.05) >= 4.5, name
    for colour in (*CHANNEL_COLOURS.values(), *SERIES_COLOURS):
        assert 1.05 / (luminance(colour) + 0.05) >= 4.5, colour


def test_trial_page_says_what_was_found(trial_path):
    page = Page(trial_path.read_text(encoding="utf-8"))
    for words in (
        "The saw cut oak at 12.500 ± 0.010 Hz.",
        "Peak force: 205.30 ± 0.62 N.",
        "k_Fc is 240.3 ± 4.3 N·s/m.",
        "928 ± 15 s (15 min 28 s)",
        "Simulated bench",
        "1.20 N mean, 3.10 N RMS and 9.20 N peak: 2.1 % of the whole cycle's impulse",
        "Usable, with remarks.",
        "ab" * 32,
        "5000 Hz",
    ):
        assert words in page.shown, words
    links = [attrs["href"] for tag, attrs in page.tags if tag == "a"]
    assert links == ["oak%20%231.mcap", "view/oak.rrd"]
    assert trial_path.stat().st_size < 500_000


def test_a_measurement_is_not_called_simulated(tmp_path):
    path = write_trial_page(tmp_path / "a.html", TrialReport(processed=make_processed(trial={"source": "bench"})))
    assert "imulated" not in Page(path.read_text(encoding="utf-8")).shown


def test_a_trial_with_nothing_in_it_is_still_a_page(tmp_path):
    empty = make_processed(
        status="no_stroke",
        period=None,
        phases=(),
        folded={},
        cutting_force=None,
        removed=None,
        quality=(),
        trial={"source": "bench"},
    )
    empty = replace(empty, peak_force_n=None, peak_force_std_n=None, mean_values={}, rms_values={})
    path = write_trial_page(
        tmp_path / "a.html", TrialReport(processed=empty, runtime=make_runtime(float("nan"), "stalled"))
    )
    page = Page(path.read_text(encoding="utf-8"))
    assert "No stroke was found." in page.shown
    assert "Not every result of this trial is reliable" in page.shown
    assert "nan" not in page.shown.split()
    assert not [tag for tag, _ in page.tags if tag in {"svg", "figure"}]


def test_results_that_failed_are_not_quoted(tmp_path):
    fit, runtime = make_fit(status="at_bound"), make_runtime(float("nan"), "cannot_start")
    words = verdict(make_processed(), fit, runtime)
    assert "k_Fc" not in words
    assert "battery" not in words
    path = write_trial_page(tmp_path / "a.html", TrialReport(processed=make_processed(), fit=fit, runtime=runtime))
    page = Page(path.read_text(encoding="utf-8"))
    assert "not reliable the fit ended at the edge of the allowed range, at 240.3 ± 4.3" in page.shown
    assert "the motor cannot start against this force" in page.shown


def test_a_wrong_duty_is_named_where_the_trial_is_judged(tmp_path):
    currents = {"mean_values": {"battery_current_a": 4.38, "motor_current_a": 10.0}}
    fit = make_fit(status="contradicted")
    wrong = TrialReport(processed=make_processed(trial={"duty": 0.55}, **currents), fit=fit)
    hint = "wrong duty entered: 0.55 is stated, the currents (battery over motor) show 0.438"
    (said,) = [reason for reason in trust_in(wrong).reasons if hint in reason]
    assert "`sawbench amend oak-01.mcap --duty 0.438`" in said
    assert hint in write_trial_page(tmp_path / "wrong.html", wrong).read_text(encoding="utf-8")
    right = TrialReport(processed=make_processed(trial={"duty": 0.438}, **currents), fit=fit)
    assert not [reason for reason in trust_in(right).reasons if "duty" in reason]


def test_both_columns_of_the_harmonics_have_a_unit():
    report = full_report()
    picture = harmonics_picture(report.processed, report.model)
    for unit in "NA":
        assert len(re.findall(rf">amplitude / {unit}</text>", picture.svg)) == 2
        assert picture.svg.partition(">")[0].count(f'"amplitude / {unit}"') == 2


def test_trial_page_shows_every_figure_and_the_facts(trial_path):
    page = Page(trial_path.read_text(encoding="utf-8"))
    drawn = {attrs["aria-labelledby"].split("-")[0] for tag, attrs in page.tags if tag == "svg"}
    assert drawn == {"signals", "period", "zeroed", "model", "harmonics", "discharge"}
    for words in (
        "Duty 0.4375", "Date 2026-03-02 09:00 UTC", "File oak-01.mcap", "Thickness not stated",
        "the stroke, 12.50 Hz", "linear force 927.6 s",
        "Provenance",
    ):  # fmt: skip
        assert words in page.shown, words


def test_a_mean_current_is_called_measured_or_the_models(tmp_path):
    processed = make_processed(mean_values={"battery_current_a": 4.7}, rms_values={})
    path = write_trial_page(tmp_path / "mean.html", TrialReport(processed=processed, runtime=make_runtime()))
    shown = Page(path.read_text(encoding="utf-8")).shown
    assert "Mean battery current 4.700 A measured, while running" in shown
    assert "the model has a mean battery current of 4.66 A" in shown
    assert "means of the model over the discharge: battery current 4.660 A" in describe("oak-01", make_runtime())


def test_deviations_are_those_of_the_curves():
    processed = make_processed(folded={"motor_current_a": folded("motor_current_a", "A", 8 + np.sin(angle_rad), 0.2)})
    model = {"linear force": {"angle_rad": angle_rad, "motor_current_a": np.full(128, 8.0)}}
    (found,) = deviations_of(processed, model)
    assert (found.channel, found.unit, found.model) == ("motor current", "A", "linear force")
    assert found.rms == pytest.approx(np.sqrt(0.5), rel=1e-9)
    assert (found.peak_measured, found.peak_model, found.largest) == pytest.approx((9.0, 8.0, 1.0), rel=1e-3)


def test_a_lossy_trial_is_bad_and_an_idle_one_says_why_it_has_no_fit(tmp_path):
    channel = make_processed().quality[0]
    lossy = make_processed(quality=(replace(channel, n_missing=2500, problems=("2500 samples are missing (25 %)",)),))
    found = trust_in(TrialReport(processed=lossy))
    assert found.level == "bad"
    assert found.reasons[0] == "Too many samples were lost: force_n: 2500 of 10000 samples are missing."
    few = make_processed(quality=(replace(channel, n_missing=7, problems=("7 samples are missing (0.093 %)",)),))
    assert trust_in(TrialReport(processed=few)).level == "warn"
    idle = make_processed("air", "none", "no_cutting", cutting_force=None, removed=None)
    path = write_trial_page(tmp_path / "idle.html", TrialReport(processed=idle, note="the blade ran without cutting"))
    page = Page(path.read_text(encoding="utf-8"))
    assert "Cutting coefficient None: the blade ran without cutting." in page.shown
    assert "No sample was lost." in page.shown
    assert "No problem found" in page.shown


def test_a_page_of_a_cut_off_recording_does_not_call_its_samples_complete(tmp_path):
    cut = replace(make_recording(), is_complete=False)
    path = write_trial_page(tmp_path / "cut.html", TrialReport(processed=make_processed(), recording=cut))
    assert "No sample was lost." not in Page(path.read_text(encoding="utf-8")).shown


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {
                "removed": RemovedForce(
                    mean_n=90,
                    rms_n=99,
                    peak_n=200,
                    share_of_impulse=0.9,
                    half="pi_to_2pi",
                    looks_swapped=True,
                )
            },
            "cutting_half in the configuration is probably wrong",
        ),
        (
            {
                "period": PeriodEstimate(
                    period_s=0.08,
                    period_std_s=0.01,
                    spread_s=0.01,
                    n_cycles=4,
                    confidence="low",
                    reason="two lines are equal",
                    channel="motor_current_a",
                    rivals=(PeriodCandidate(period_s=0.16, relative_power=0.97, reason="half the frequency"),),
                )
            },
            "Also possible: 160 ms with 97 % of the power (half the frequency).",
        ),
    ],
)
def test_doubts_are_said(tmp_path, changes, expected):
    path = write_trial_page(tmp_path / "a.html", TrialReport(processed=make_processed(**changes)))
    page = Page(path.read_text(encoding="utf-8"))
    assert expected in page.shown
    assert "Not every result of this trial is reliable" in page.shown


def test_pages_are_the_same_every_time(tmp_path):
    first = write_comparison_page(tmp_path / "a.html", make_rows())
    second = write_comparison_page(tmp_path / "b.html", make_rows()[::-1])
    assert first.read_bytes() == second.read_bytes()
    pages = [write_trial_page(tmp_path / f"t{k}.html", TrialReport(processed=make_processed())) for k in range(2)]
    assert pages[0].read_bytes() == pages[1].read_bytes()


def test_nothing_is_overwritten_unasked(tmp_path):
    path = tmp_path / "a.html"
    path.write_text("precious")
    with pytest.raises(InputError, match="already exists"):
        write_trial_page(path, TrialReport(processed=make_processed()))
    with pytest.raises(InputError, match="already exists"):
        write_comparison_page(path, make_rows())
    assert path.read_text() == "precious"
    write_comparison_page(path, make_rows(), overwrite=True)
    assert "precious" not in path.read_text(encoding="utf-8")
    with pytest.raises(InputError, match="cannot be written"):
        write_trial_page(tmp_path / "nowhere" / "a.html", TrialReport(processed=make_processed()))


def test_comparison_drops_nothing_silently():
    found = compare(make_rows(), [LeftOut(name="broken.mcap", reason="is not a recording")])
    names = {row.name for one in found.series for row in one.trials} | {row.name for row in found.idle}
    names |= {item.name for item in found.left_out}
    assert names == {row.name for row in make_rows()} | {"broken.mcap"}
    reasons = {(item.name, item.reason) for item in found.left_out}
    assert ("pine-2", "the saw stalled") in reasons
    assert ("pine-3", "k_Fc not used: the signals do not determine it") in reasons
    pine = next(one for one in found.series if one.label == "pine")
    assert pine.means["peak_force_n"].n == 2
    assert pine.means["k_fc_n_s_per_m"].n == 1


def test_comparison_numbers_by_hand():
    oak = next(one for one in compare(make_rows()).series if one.label == "white oak")
    k_fc = oak.means["k_fc_n_s_per_m"]
    assert k_fc.values == pytest.approx((239.04, 240.0, 240.96))
    assert k_fc.between_std == pytest.approx(0.96)
    # Scatter 0.96 over sqrt(3), and 2 % of 240 that all trials share (less the negligible 0.001).
    assert k_fc.std == pytest.approx(np.hypot(0.96 / np.sqrt(3), 4.8), rel=1e-6)
    assert oak.means["runtime_s"].mean == pytest.approx(928.0, rel=1e-4)


def test_comparison_page_shows_it(comparison_path):
    page = Page(comparison_path.read_text(encoding="utf-8"))
    for words in (
        "240.0 ± 4.8",
        "nylon 6 − white oak",
        "significant: white oak is higher",
        "not determined: two repetitions of each are needed; pine has 1",
        "Idle trials",
        "the saw stalled",
        "mean(bᵢ)²",
        "one trial only",
    ):
        assert words in page.shown, words
    assert comparison_path.stat().st_size < 400_000


def test_another_setting_is_another_series():
    rows = [
        ComparedTrial(processed=make_processed(f"oak-{mm}-{k}", trial={"thickness_mm": mm, "repetition": k}))
        for mm in (20.0, 27.0)
        for k in (1, 2)
    ]
    rows.append(ComparedTrial(processed=make_processed("fir-1", "fir", trial={"thickness_mm": 20.0})))
    assert [one.label for one in compare(rows).series] == ["fir", "oak, 20 mm", "oak, 27 mm"]


def test_a_lossy_trial_takes_no_part_and_the_reason_says_what_to_do():
    sound = make_processed("oak-1", "oak")
    lossy = make_processed("oak-2", "oak", quality=(replace(sound.quality[0], n_samples=7000, n_missing=3000),))
    rows = [ComparedTrial(processed=one, fit=make_fit(), runtime=make_runtime()) for one in (sound, lossy)]
    found = compare(rows)
    assert [[trial.name for trial in one.trials] for one in found.series] == [["oak-1"]]
    (item,) = found.left_out
    assert item.name == "oak-2"
    assert "3000 of 10000 samples are missing" in item.reason and "record the trial again" in item.remedy


@pytest.mark.parametrize("n_materials", [0, 1, 6])
def test_comparison_of_any_number_of_materials(tmp_path, n_materials):
    rows = [
        ComparedTrial(processed=make_processed(f"wood {m}-{k}", f"wood {m}"), fit=make_fit(200.0 + 5 * k + m))
        for m in range(n_materials)
        for k in range(2)
    ]
    path = write_comparison_page(tmp_path / "a.html", rows)
    page = Page(path.read_text(encoding="utf-8"))
    assert sum(tag == "svg" for tag, _ in page.tags) == (2 if n_materials else 0)
    assert ("No trial can be compared" in page.shown) == (n_materials == 0)


def test_pooled_cycles_hold_every_stroke():
    rng = np.random.default_rng(1)
    strokes = [rng.normal(100.0 + shift, 3.0, (n, 128)) for shift, n in ((-5.0, 20), (2.0, 50))]
    cycles = [
        replace(folded(n_cycles=len(s)), mean=s.mean(axis=0), std=s.std(axis=0, ddof=1), count=np.full(128, len(s)))
        for s in strokes
    ]
    both = pooled(cycles)
    together = np.concatenate(strokes)
    np.testing.assert_allclose(both.mean, together.mean(axis=0))
    np.testing.assert_allclose(both.std, together.std(axis=0, ddof=1))
    assert both.n_cycles == 70


def test_table_and_json_hold_every_trial():
    rows = make_rows()
    table = comparison_table(rows)
    assert list(table["trial"]) == [row.name for row in rows]
    oak = table.set_index("trial").loc["white oak-2"]
    assert (oak["k_fc_n_s_per_m"], oak["use"]) == (240.0, "compared")
    assert oak["k_fc_n_s_per_m_std"] == pytest.approx(4.8)
    assert table.set_index("trial").loc["pine-2", "use"] == "the saw stalled"
    assert table.set_index("trial").loc["air-1", "use"] == "idle"
    written = json.loads(json.dumps(comparison_json(rows), allow_nan=False))
    assert {one["label"] for one in written["series"]} == {"nylon 6", "pine", "white oak"}
    assert written["is_simulated"] is True


def test_links_are_relative_to_the_page(tmp_path):
    assert link_to(tmp_path / "a b.mcap", tmp_path / "out" / "page.html") == ("../a%20b.mcap", "../a b.mcap")
