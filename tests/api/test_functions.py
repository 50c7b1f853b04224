"""The public functions do what the commands do, and their results show themselves."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import sawbench
from sawbench.bench.errors import InputError, UntrustedResult
from sawbench.bench.recording import Event, Gap
from sawbench.commands.main import main
from sawbench.trial_report import trial_report
from threadpoolctl import threadpool_info, threadpool_limits

pytestmark = pytest.mark.pipeline

ROOT = Path(__file__).parents[2]
OAK = ROOT / "recordings" / "oak-01.mcap"


class _Shown(HTMLParser):
    """Tags that are open, cells and pictures of a block."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.pictures: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        if tag == "img":
            self.pictures.append(dict(attrs)["src"])
        else:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def shown(result, *, n_pictures: int) -> str:
    """Text of a result in a notebook, once its HTML is well-formed and needs nothing from elsewhere."""
    html = result._repr_html_()
    found = _Shown(html)
    assert not found.open
    assert len(found.pictures) == n_pictures
    assert all(picture.startswith("data:image/svg+xml;base64,") for picture in found.pictures)
    assert "http" not in html
    return " ".join(found.text).replace("\N{NO-BREAK SPACE}", " ")


@pytest.fixture(scope="module")
def oak():
    return sawbench.fit(OAK)


def printed(capsys, *arguments) -> list[dict]:
    assert main([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_import_is_light():
    code = (
        "import sys; before = set(sys.modules); import sawbench; dir(sawbench);"
        "heavy = {'numpy', 'scipy', 'numba', 'pydantic', 'click'} & set(sys.modules);"
        "new = sorted(set(sys.modules) - before);"
        "sys.exit(f'imported {new}' if heavy or len(new) > 20 else 0)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_every_public_function_is_there_and_documented():
    for name in sawbench.__all__:
        text = getattr(sawbench, name).__doc__
        for section in ("Parameters", "Returns", "Raises", "Examples"):
            assert re.search(rf"{section}\n +-+\n", text), f"{name} has no section {section}"
    with pytest.raises(AttributeError, match="no attribute 'fitt'"):
        _ = sawbench.fitt


def test_a_recording_shows_its_channels():
    opened = sawbench.read(OAK)
    text = shown(opened, n_pictures=1)
    for name, signal in opened.recording.signals.items():
        assert name in text
        assert str(len(signal.values)) in text


def test_fit_and_runtime_are_those_of_the_commands(oak, capsys):
    (row,) = printed(capsys, "fit", OAK)
    assert oak.cutting.k_fc_n_s_per_m == row["k_fc_n_s_per_m"]
    assert oak.cutting.std_n_s_per_m == row["std_n_s_per_m"]
    (row,) = printed(capsys, "runtime", OAK)
    lasts = sawbench.runtime(oak)
    assert lasts.prediction.runtime_s == row["runtime_s"]
    assert f"{lasts.prediction.runtime_s:.0f}" in shown(lasts, n_pictures=0)
    assert f"{oak.cutting.k_fc_n_s_per_m:.1f}" in shown(oak, n_pictures=1)
    assert f"{oak.trial.processed.period.rate_hz:.2f}"[:4] in shown(oak.trial, n_pictures=1)


def test_the_fit_finds_the_coefficient_a_trial_was_simulated_with():
    run = sawbench.simulate(k_fc_n_s_per_m=180.0, duration_s=2.0, rate_hz=2000.0)
    found = sawbench.fit(run.recording(material="oak")).cutting
    assert abs(found.k_fc_n_s_per_m - 180.0) < 3.0 * found.std_n_s_per_m
    assert "motor_current_a" in shown(run, n_pictures=1)


def test_simulated_channels_have_the_units_of_their_names():
    run = sawbench.simulate(duration_s=0.5)
    channels = run.channels()
    radius_mm = 1e3 * run.loaded.plant().crank_radius_m.nominal
    expected_mm = radius_mm * (1.0 - np.cos(run.run.crank_angle_rad))
    np.testing.assert_allclose(channels["displacement_mm"], expected_mm, atol=1e-6)


def test_a_simulated_bench_reads_as_its_sensors_are_stated_to(tmp_path):
    config = tmp_path / "sensors.toml"
    shipped = (ROOT / "bench_config.toml").read_text(encoding="utf-8")
    config.write_text(f"{shipped}\n[sensors]\nforce_n = {{ gain = 1.1, offset = 2.0 }}\n", encoding="utf-8")
    plain = sawbench.simulate(duration_s=1.0)
    read = sawbench.simulate(duration_s=1.0, config=config)
    np.testing.assert_allclose(read.channels()["force_n"], 1.1 * plain.channels()["force_n"] + 2.0)
    found = sawbench.process(read.recording()).processed.peak_force_n
    assert found == pytest.approx(sawbench.process(plain.recording()).processed.peak_force_n)


def test_air_has_no_runtime():
    with pytest.raises(InputError, match="not a cutting trial"):
        sawbench.runtime(sawbench.simulate(k_fc_n_s_per_m=0.0).recording())


def test_a_trial_of_unknown_duty_has_no_runtime_but_a_page(tmp_path):
    known = sawbench.simulate(duration_s=2.0, rate_hz=2000.0).recording(material="oak")
    signals = {name: known.recording.signal(name) for name in ("force_n", "displacement_mm")}
    trial = replace(known.recording.trial, duty=None)
    unknown = replace(known, recording=replace(known.recording, trial=trial, signals=signals))
    with pytest.raises(InputError, match="the duty of the trial is unknown, so its battery runtime is unknown too"):
        sawbench.runtime(unknown)
    page = trial_report(sawbench.process(unknown))
    assert page.fit.status == "ok" and page.runtime is None and "duty" in page.note


def test_what_is_left_of_an_interrupted_recording_is_fitted_and_said():
    whole = sawbench.simulate(duration_s=2.0, rate_hz=2000.0).recording(material="oak")
    cut = Event(kind="interrupted", time_s=1.9, text="the file is cut off")
    left = replace(whole, recording=replace(whole.recording, is_complete=False, events=(cut,)))
    found = sawbench.fit(left).cutting
    assert found.status == "ok"
    assert (
        "the recording is incomplete: it ends at 1.90 s, what came after is lost (the file is cut off)" in found.notes
    )
    assert not any("incomplete" in note for note in sawbench.fit(whole).cutting.notes)


def test_a_doubted_fit_gives_no_runtime(oak):
    doubted = replace(oak, cutting=replace(oak.cutting, status="contradicted", notes=("the gain is off",)))
    with pytest.raises(UntrustedResult, match=r"contradicted; the gain is off"):
        sawbench.runtime(doubted)
    assert "contradicts" in shown(doubted, n_pictures=1)


def test_a_fit_says_which_of_its_channels_ended_early():
    whole = sawbench.simulate(duration_s=3.0, rate_hz=2000.0).recording(material="oak")
    recording, force = whole.recording, whole.recording.signals["force_n"]
    half = len(force.time_s) // 2
    n_missing = len(force.time_s) - half
    gap = Gap(start_s=force.time_s[half - 1], end_s=force.time_s[-1], n_missing=n_missing, reason="link lost")
    cut = replace(force, time_s=force.time_s[:half], values=force.values[:half], raw=None, gaps=(gap,))
    ended = replace(whole, recording=replace(recording, signals={**recording.signals, "force_n": cut}))
    said = f"force_n: {n_missing} of {half + n_missing} samples are missing"
    assert said in sawbench.fit(ended).cutting.notes
    # What is not used is not said, and what is left is a fit.
    alone = sawbench.fit(ended, method="current").cutting
    assert alone.status == "ok" and said not in alone.notes


def test_wrong_input_is_one_clear_error(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        sawbench.read(tmp_path / "none.mcap")
    with pytest.raises(InputError, match="no trial to diagnose"):
        sawbench.diagnose([])
    with pytest.raises(InputError, match="no trial to diagnose"):
        sawbench.diagnose([], config="bench_config.toml")
    opened = sawbench.simulate(k_fc_n_s_per_m=200.0, duration_s=0.1).recording()
    with pytest.raises(InputError, match="holds its configuration"):
        sawbench.process(opened, config="bench_config.toml")
    with pytest.raises(InputError, match=r"has no \.mcap file"):
        sawbench.compare(tmp_path)


def test_comparison_groups_by_material(tmp_path):
    names = ("oak-01", "oak-02", "nylon-01")
    found = sawbench.compare([ROOT / "recordings" / f"{name}.mcap" for name in names])
    assert [(one.label, len(one.trials)) for one in found.comparison().series] == [("nylon", 1), ("oak", 2)]
    assert sorted(found.table()["trial"]) == sorted(names)
    assert "oak" in shown(found, n_pictures=1)
    page = found.save(tmp_path / "materials.html")
    assert "nylon" in page.read_text()
    with pytest.raises(InputError, match="already exists"):
        found.save(page)


def test_diagnosis_is_that_of_the_command(tmp_path, capsys):
    paths = [ROOT / "recordings" / f"{name}.mcap" for name in ("oak-01", "nylon-01", "none-01")]
    found = sawbench.diagnose(paths)
    assert main(["diagnose", *map(str, paths), "--out", str(tmp_path / "a"), "--json"]) == 0
    capsys.readouterr()
    assert json.loads((tmp_path / "a" / "gap_report.json").read_text()) == json.loads(found.as_json())
    text = shown(found, n_pictures=1)
    assert found.report["next_trial"] in text
    assert sum(cause["probability"] for cause in found.causes) + sum(found.report["probabilities"].values()) < 1.01
    json_path, html_path = found.save(tmp_path / "b")
    assert json_path.exists()
    assert html_path.exists()


def test_a_block_writes_shares_whole_and_escapes_what_people_wrote():
    from sawbench.bench.recording import Event, Recording, Signal, Trial
    from sawbench.reporting.notebook import gap_block, recording_block

    cause = {"effects": ["blade_wear"], "probability": 0.004, "gap_closed": -0.002, "gap_closed_ci95": [-5e-16, 7e-16]}
    report = {
        "verdict": "no_gap", "causes": [cause], "probabilities": {"no_gap": 0.99}, "next_trial": "an idle run",
        "gap": {"by_channel": {}}, "parameter_shifts": {},
    }  # fmt: skip
    assert "0 % (0 to 0 %)" in gap_block(report)
    events = (Event(kind="note", time_s=0.0, text="<b>knot</b>"), Event(kind="device", time_s=0.0, text="clock"))
    signal = Signal(channel="force_n", unit="N", time_s=[0.0, 0.1], values=[1.0, 2.0])
    html = recording_block(Recording(trial=Trial(trial_id="t"), signals={"force_n": signal}, events=events))
    assert "&lt;b&gt;knot" in html
    assert "clock" not in html


def test_a_diagnosis_uses_one_thread_of_the_linear_algebra_and_leaves_the_others_alone(monkeypatch):
    def threads():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    during = []
    monkeypatch.setattr(
        "sawbench.diagnosis.answer.gap_report.diagnose", lambda *_, **__: during.append(threads()) or {"causes": []}
    )
    with threadpool_limits(limits=2, user_api="blas"):
        sawbench.diagnose([OAK], config="bench_config.toml")
        after = threads()
    assert during == [{1}]
    assert after == {2}
