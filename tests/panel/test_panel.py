"""What the panel answers, asked without a browser: who may ask, what a form becomes, what a name may lead to."""

from __future__ import annotations

import asyncio
import html
import json
import re
import shutil
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import urlencode

import pytest

pytest.importorskip("starlette", reason="the panel needs sawbench[panel]")

from sawbench.acquisition.series.journal import Journal
from sawbench.acquisition.series.plan import load_plan
from sawbench.acquisition.series.progress import as_facts
from sawbench.acquisition.series.verdict import TrialMeasures
from sawbench.commands import terminal
from sawbench.commands.link import Link
from sawbench.commands.main import main
from sawbench.commands.panel import refusal
from sawbench.commands.series_dialogue import PanelDialogue
from sawbench.panel import jobs as panel_jobs
from sawbench.panel.app import PanelSettings, build_app
from sawbench.panel.commands_of import BenchOptions, record, series_plan, tare
from sawbench.panel.follower import Follower
from sawbench.panel.jobs import Jobs
from sawbench.panel.series_state import known_plans, series_state
from sawbench.reporting.trial_page import write_trial_page

from tests.reporting.test_pages import full_report

pytestmark = pytest.mark.contract

SAMPLES = Path(__file__).parents[2] / "recordings"
HERE = {"host": "127.0.0.1:8765"}


@pytest.fixture
def started(monkeypatch):
    """Arguments of the commands that were started, none of which runs."""
    launched: list[list[str]] = []

    def launch(self, folder):
        launched.append(json.loads((folder / "job.json").read_text())["arguments"])

    monkeypatch.setattr(Jobs, "_launch", launch)
    return launched


def panel(folder: Path, token: str = "", in_force=()):
    shutil.copy(SAMPLES / "oak-01.mcap", folder)
    (folder / "secret.txt").write_text("not for the panel")
    facts = {"config": "", "devices": [], "channels": ["force_n"], "in_force": list(in_force), "problem": ""}
    settings = PanelSettings(
        options=BenchOptions(recordings=folder, simulated=True), plans=folder, bench=lambda: facts, refusal=refusal
    )
    return build_app(settings, token=token)


def ask(app, path, *, form=None, headers=None, method=None):
    """One request to an ASGI application: status, headers, text."""
    body = b"" if form is None else urlencode(form, doseq=True).encode()
    route, _, query = path.partition("?")
    scope = {
        "type": "http", "http_version": "1.1", "method": method or ("GET" if form is None else "POST"), "path": route,
        "raw_path": route.encode(), "query_string": query.encode(), "root_path": "", "scheme": "http",
        "server": ("127.0.0.1", 8765), "client": ("127.0.0.1", 1),
        "headers": [(k.encode(), v.encode()) for k, v in {**HERE, **(headers or {})}.items()],
    }  # fmt: skip
    sent = []

    async def run():
        given = iter([{"type": "http.request", "body": body, "more_body": False}])

        async def receive():
            message = next(given, None)
            return message if message is not None else await asyncio.Future()

        async def send(message):
            sent.append(message)

        await app(scope, receive, send)

    asyncio.run(run())
    said = {k.decode(): v.decode() for k, v in sent[0]["headers"]}
    return sent[0]["status"], said, b"".join(m.get("body", b"") for m in sent[1:]).decode()


def secret_of(app, **options):
    return re.search(r'name="secret" value="([^"]+)"', ask(app, "/record", **options)[2])[1]


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8765", "127.0.0.1.evil.example", "", "[broken"])
def test_a_name_of_another_machine_is_refused(tmp_path, host):
    assert ask(panel(tmp_path), "/", headers={"host": host})[0] == 421


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:8765", "[::1]:8765"])
def test_this_machine_is_served(tmp_path, host):
    assert ask(panel(tmp_path), "/jobs", headers={"host": host})[0] == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "http://127.0.0.1:9999"},
        {"origin": "null"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
    ],
)
def test_a_page_of_another_site_starts_nothing(tmp_path, started, headers):
    app = panel(tmp_path)
    form = {"secret": secret_of(app), "material": "oak"}
    assert ask(app, "/record", form=form, headers=headers)[0] == 403
    assert started == []
    assert ask(app, "/record", form=form, headers={"origin": "http://127.0.0.1:8765"})[0] == 303
    assert len(started) == 1


@pytest.mark.parametrize("secret", [{}, {"secret": "guessed"}, {"secret": ["a", "b"]}])
def test_a_form_without_the_secret_starts_nothing(tmp_path, started, secret):
    status, _, said = ask(panel(tmp_path), "/record", form={"material": "oak", **secret})
    assert (status, started) == (400, [])
    assert "reload the page" in said


def test_others_need_the_token(tmp_path):
    app = panel(tmp_path, token="right")
    for path, cookie in (("/", ""), ("/?token=wrong", ""), ("/", "sawbench_panel=wrong"), ("/static/panel.js", "")):
        assert ask(app, path, headers={"host": "bench.lan", "cookie": cookie})[0] == 401
    status, headers, _ = ask(app, "/jobs?token=right", headers={"host": "bench.lan"})
    assert (status, headers["location"]) == (303, "/jobs")
    assert "HttpOnly" in headers["set-cookie"] and "SameSite=lax" in headers["set-cookie"]
    assert ask(app, "/jobs", headers={"host": "bench.lan", "cookie": "sawbench_panel=right"})[0] == 200


@pytest.mark.parametrize(
    "path",
    [
        "/recording?file=../secret.txt",
        "/recording?file=secret.txt",
        "/recording?file=/etc/passwd",
        "/jobs/..",
        "/jobs/0001-record/files/job.json",
        "/jobs/0001-record/files/../../secret.txt",
        "/jobs/../files/secret.txt",
        "/static/../app.py",
        "/static/app.py",
        "/series/..%2Fsecret.txt",
    ],
)
def test_no_name_leads_out_of_the_folders(tmp_path, started, path):
    app = panel(tmp_path)
    ask(app, "/record", form={"secret": secret_of(app), "material": "oak"})
    status, _, said = ask(app, path)
    assert status in {400, 404}
    assert "not for the panel" not in said and "root:" not in said


def test_pages_allow_nothing_from_elsewhere_and_results_live_in_a_sandbox(tmp_path, started):
    app = panel(tmp_path)
    ask(app, "/compare", form={"secret": secret_of(app), "file": ["oak-01.mcap"]})
    (job,) = (tmp_path / "panel").iterdir()
    (job / "comparison.html").write_text("<p>result</p>")
    policy = ask(app, "/")[1]["content-security-policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy
    status, headers, text = ask(app, f"/jobs/{job.name}/files/comparison.html")
    assert (status, text) == (200, "<p>result</p>")
    policy = headers["content-security-policy"]
    assert policy.startswith("sandbox ") and "same-origin" not in policy and "allow-forms" not in policy


def test_what_is_entered_is_shown_as_text(tmp_path, started):
    app = panel(tmp_path)
    ask(app, "/record", form={"secret": secret_of(app), "material": "<script>alert(1)</script>"})
    assert "<script>alert" not in ask(app, "/record")[2]
    assert "<script>alert" not in ask(app, "/recordings?q=<script>alert(1)</script>")[2]


def test_a_form_becomes_a_command_and_no_value_an_option(tmp_path):
    call = record(BenchOptions(recordings=tmp_path), {"material": "--force", "duty": "", "note": "a b", "seconds": ""})
    assert call.arguments == [
        "record", "--material=--force", "--note=a b", "--until-stopped", "--out", str(tmp_path), "--json",
    ]  # fmt: skip
    assert refusal(call.arguments) == ""


def test_a_wrong_number_is_said_and_starts_nothing(tmp_path, started):
    app = panel(tmp_path)
    status, _, said = ask(app, "/record", form={"secret": secret_of(app), "material": "oak", "duty": "44"})
    assert (status, started) == (400, [])
    assert "44.0 is not in the range" in said


def test_the_bench_has_one_user_at_a_time(tmp_path, started, monkeypatch):
    app = panel(tmp_path)
    form = {"secret": secret_of(app), "material": "oak"}
    ask(app, "/record", form=form)
    monkeypatch.setattr(panel_jobs, "_is_locked", lambda path: True)
    status, _, said = ask(app, "/tare", form=form)
    assert (status, len(started)) == (400, 1)
    assert "the bench is in use: trial oak" in said


def test_a_correction_and_a_rejection_leave_the_recording_as_it_was(tmp_path):
    app = panel(tmp_path)
    secret, before = secret_of(app), (tmp_path / "oak-01.mcap").read_bytes()
    form = {"secret": secret, "file": "oak-01.mcap", "duty": "0,5", "by": "Kim"}
    assert ask(app, "/amend", form=form)[0] == 303
    assert "duty 0.5 instead of 0.4375 (Kim, " in ask(app, "/recording?file=oak-01.mcap")[2]
    status, _, said = ask(app, "/amend", form={**form, "duty": "much"})
    assert status == 400 and "expected a number" in said
    assert ask(app, "/reject", form={"secret": secret, "file": "oak-01.mcap"})[0] == 303
    assert (tmp_path / "rejected" / "oak-01-1.mcap").read_bytes() == before
    assert ask(app, "/recording?file=oak-01.mcap")[0] == 400


def test_plans_are_told_from_other_tables(tmp_path, capsys):
    (tmp_path / "campaign.toml").write_text('[[trial]]\nfile = "a.csv"\nworkpiece = "oak"\n')
    (tmp_path / "bench.toml").write_text("[plant]\ngear_ratio = 9.3\n")
    (tmp_path / "trial.csv").write_text("time_s,force_n\n0,1\n")
    (tmp_path / "next.csv").write_text("duty,feed (mm/s),material\n0.5,4,oak\n")
    assert (
        main(["compare", str(SAMPLES), "--out", str(tmp_path / "compared.html"), "--csv", str(tmp_path / "a.csv")]) == 0
    )
    assert main(["series", "plan", "--material", "oak", "--out", str(tmp_path / "wood.toml")]) == 0
    assert list(known_plans([tmp_path])) == ["wood.toml", "next.csv"]
    state = series_state(tmp_path / "wood.toml")
    assert state.progress is not None and len(state.progress.trials) == 3
    assert "oak" in ask(panel(tmp_path), "/series/wood.toml")[2]


def test_a_fault_of_a_trial_of_a_series_has_no_instructions_for_a_terminal(tmp_path, started):
    assert (
        main(["series", "plan", "--material", "oak", "--repetitions", "1", "--out", str(tmp_path / "wood.toml")]) == 0
    )
    plan = load_plan(tmp_path / "wood.toml")
    (planned,) = plan.plan.trial
    plan.folder.mkdir()
    shutil.copy(SAMPLES / "oak-01.mcap", plan.folder / f"{planned.id}.mcap")
    said = "likely cause: wrong duty entered; if the duty was 0.438: `sawbench amend a.mcap --duty 0.438`, or check"
    journal = Journal(plan.folder)
    journal.add("started", planned.id)
    judged = TrialMeasures(trial_id=planned.id, setting=planned.setting, blade="B1", faults=(said,))
    journal.add("judged", planned.id, **as_facts(judged))
    text = ask(panel(tmp_path), "/series/wood.toml")[2]
    assert (
        "wrong duty entered; if the duty was 0.438: correct the duty to 0.438 on the page of the recording, or" in text
    )


def end(folder: Path, result, code: int = 0) -> None:
    """What a command leaves in the folder of its job."""
    (folder / "out.txt").write_text(json.dumps(result))
    (folder / "exit.json").write_text(json.dumps({"code": code}))


def test_a_result_from_before_a_correction_is_not_called_reliable(tmp_path, started):
    app = panel(tmp_path)
    secret, path = secret_of(app), "/recording?file=oak-01.mcap"
    result = [{"verdict": "The saw cut oak.", "trust": "good", "reasons": []}]

    def evaluate(number):
        assert ask(app, "/report", form={"secret": secret, "file": "oak-01.mcap"})[0] == 303
        end(tmp_path / "panel" / f"000{number}-report", result)

    evaluate(1)
    assert "The results are reliable." in ask(app, path)[2]
    correction = {"secret": secret, "file": "oak-01.mcap", "duty": "0.5", "by": "Kim"}
    assert ask(app, "/amend", form=correction)[0] == 303
    for page in (path, "/jobs/0001-report"):
        said = ask(app, page)[2]
        assert "Evaluated before the settings were corrected" in said
        assert "The results are reliable." not in said
    assert "Evaluate again" in ask(app, path)[2]
    result[0]["reasons"] = ["if it was 0.4: `sawbench amend oak-01.mcap --duty 0.4`, <b> or see `sawbench check`."]
    evaluate(2)
    assert "The results are reliable." in ask(app, path)[2]
    said = ask(app, path)[2]
    assert "if it was 0.4: correct the duty to 0.4 on the page of the recording, &lt;b&gt;" in said
    assert "see <code>sawbench check</code>." in said
    assert '<a href="/recording?file=oak-01.mcap">' in ask(app, "/jobs/0002-report")[2]


def test_an_evaluation_shows_its_step_also_without_script(tmp_path, started, monkeypatch):
    app = panel(tmp_path)
    ask(app, "/record", form={"secret": secret_of(app), "material": "oak"})
    recorded = {"path": str(tmp_path / "oak-01.mcap"), "is_complete": True, "losses": [], "duration_s": 2.0,
                "end_reason": "2 s recorded"}  # fmt: skip
    end(tmp_path / "panel" / "0001-record", recorded)
    monkeypatch.setattr(panel_jobs, "_is_locked", lambda path: path.parent.name.endswith("-report"))
    pages = ("/jobs/0001-record", "/recording?file=oak-01.mcap", "/jobs/0002-report")
    for page in pages:
        said = ask(app, page)[2]
        assert "<progress" in said and "value=" not in said.partition("<progress")[2].partition(">")[0]
    assert started[-1][:2] == ["report", str(tmp_path / "oak-01.mcap")]
    link = Link(tmp_path / "panel" / "0002-report")
    link.progress(1, 4, "evaluating oak-01: fitting k_Fc")
    for page in pages:
        said = ask(app, page)[2]
        assert "evaluating oak-01: fitting k_Fc" in said
        assert 'max="1" value="0.25"' in said
        is_reloaded = '<noscript><meta http-equiv="refresh" content="2"></noscript>' in said
        # What is being entered on the page of a recording must not be lost: it leads to the page of the job.
        assert is_reloaded or '<a href="/jobs/0002-report">' in said


def test_the_steps_of_a_trial_page_are_told_to_the_panel(tmp_path, monkeypatch, capsys):
    told = []

    class Told:
        def progress(self, done, total, what):
            told.append((done, total, what))

    monkeypatch.setattr(terminal, "current_link", Told)
    assert main(["report", str(SAMPLES / "oak-01.mcap"), "--out", str(tmp_path)]) == 0
    assert [(done, total) for done, total, _ in told] == [(0, 4), (1, 4), (2, 4), (3, 4)]
    assert told[0][2] == "evaluating oak-01: finding the strokes"


def test_a_page_of_a_result_leads_back_and_to_its_recording(tmp_path, started):
    app = panel(tmp_path)
    ask(app, "/report", form={"secret": secret_of(app), "file": "oak-01.mcap"})
    (folder,) = (tmp_path / "panel").iterdir()
    page = write_trial_page(folder / "oak-01.html", full_report(), files={"Recording": tmp_path / "oak-01.mcap"})
    assert 'href="../../oak-01.mcap"' in page.read_text()
    address = f"/jobs/{folder.name}/files/oak-01.html"
    said = ask(app, address)[2]
    assert f'<a href="/jobs/{folder.name}">page of oak-01</a>' in said
    assert '<a href="/recording?file=oak-01.mcap">' in said and "../../oak-01.mcap" in said
    (tmp_path / "oak-01.mcap").unlink()
    said = ask(app, address)[2]
    assert "oak-01.mcap</a>" not in said and "../../oak-01.mcap" in said


RESULT = {"zero_raw": -6.07e-05, "raw_unit": "mV/V"}
TARE = {
    "kind": "tare", "channel": "force_n", "result": RESULT, "zero_std_raw": 5.0e-05,
    "details": {"offset": -0.01518, "offset_std": 0.01248, "unit": "N", "noise_std": 1.0, "drift_per_s": -0.0076,
                "drift_std_per_s": 0.004},
}  # fmt: skip
CALIBRATION = {
    "kind": "calibration", "channel": "force_n", "unit": "N", "result": RESULT, "zero_std_raw": 5.0e-05,
    "details": {"fit": {"gain": 250.4, "gain_rel_std": 0.001, "nonlinearity": 6.2e-4, "hysteresis": 4.8e-4},
                "points": [{}, {}, {}]},
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "result", "words"),
    [
        ("tare", TARE, ["−0.015 ± 0.012 N", "one standard deviation"]),
        ("calibrate", CALIBRATION, ["250.40 ± 0.25 N/(mV/V)", "0.062 % of the range", "0.048 % of the range"]),
    ],
)
def test_a_tare_and_a_calibration_show_what_they_found(tmp_path, started, name, result, words):
    app = panel(tmp_path)
    ask(app, f"/{name}", form={"secret": secret_of(app), "channel": "force_n"})
    (folder,) = (tmp_path / "panel").iterdir()
    end(folder, result)
    said = ask(app, f"/jobs/{folder.name}")[2].replace("\N{NO-BREAK SPACE}", " ")
    assert [text for text in words if text not in said] == []
    (folder / "out.txt").write_text(json.dumps({"error": {"what": "the value drifts"}}))
    end(folder, {"error": {"what": "the value drifts"}}, 1)
    assert "Not stored." in ask(app, f"/jobs/{folder.name}")[2]


def test_a_calibration_that_would_be_replaced_is_said_before_any_load_is_applied(tmp_path, started):
    made_at = datetime(2026, 3, 2, 9, 30, tzinfo=UTC)
    kept = {**CALIBRATION, "made_at": made_at, "operator": "Kim", "age": "2.0 h old"}
    app = panel(tmp_path, in_force=[kept])
    form = {"secret": secret_of(app), "channel": "force_n"}
    bench = ask(app, "/")[2].replace("\N{NO-BREAK SPACE}", " ")
    when = made_at.astimezone().strftime("%Y-%m-%d %H:%M")
    assert f"force_n: calibration of {when} by Kim, 2.0 h old: gain 250.40 ± 0.25 N/(mV/V)" in bench
    status, _, said = ask(app, "/calibrate", form=form)
    assert (status, started) == (400, [])
    assert "tick “replace the current calibration”" in said and "--force" not in said
    assert ask(app, "/calibrate", form={**form, "replace": "1"})[0] == 303
    assert ask(app, "/calibrate", form={**form, "channel": "displacement_mm", "replace": ""})[0] == 303


def test_a_number_may_have_a_decimal_comma(tmp_path):
    options = BenchOptions(recordings=tmp_path)
    form = {"material": "oak, old", "duty": "0,44", "seconds": "2,5", "feed": "4"}
    assert {"--material=oak, old", "--duty=0.44", "--seconds=2.5", "--feed=4"} < set(record(options, form).arguments)
    assert "--seconds=2.5" in tare(options, form).arguments
    plan = series_plan(
        options, {"materials": "oak, nylon", "duties": "0,44; 0,5", "feeds": "3, 4"}, tmp_path / "p.toml"
    )
    assert {"--material=nylon", "--duty=0.44", "--duty=0.5", "--feed=3", "--feed=4"} < set(plan)


def test_errors_name_the_field_and_lead_back(tmp_path, started):
    app = panel(tmp_path)
    form = {"secret": secret_of(app), "material": "oak", "duty": "much"}
    came = {"referer": "http://127.0.0.1:8765/record?next=1"}
    said = html.unescape(ask(app, "/record", form=form, headers=came)[2])
    assert "Duty: 'much' is not a number." in said and "--duty" not in said
    assert '<a href="/record?next=1" data-back>Go back</a>' in said
    foreign = {"referer": "http://evil.example/page"}
    assert '<a href="/" data-back>' in ask(app, "/record", form=form, headers=foreign)[2]
    (tmp_path / "wood.toml").write_text('[[trial]]\nmaterial = "oak"\n')
    plan = {"secret": form["secret"], "materials": "oak"}
    said = html.unescape(ask(app, "/series", form={**plan, "name": "wood"})[2])
    assert "there is already a plan 'wood'" in said and "choose another name" in said
    for name in ("a/b", ".hidden", "", "a\\b"):
        assert "use letters, digits, spaces and" in ask(app, "/series", form={**plan, "name": name})[2]


def test_an_unknown_address_has_a_page_with_a_way_back(tmp_path):
    status, _, said = ask(panel(tmp_path), "/nope")
    assert status == 404
    assert "the panel has no page /nope" in said and '<a href="/"' in said


def test_the_output_has_no_instructions_for_a_terminal(tmp_path, started):
    app = panel(tmp_path)
    ask(app, "/record", form={"secret": secret_of(app), "material": "oak"})
    (folder,) = (tmp_path / "panel").iterdir()
    (folder / "log.txt").write_text(
        "Enter when ready: \ncheck: no faults\nrecording 4 s; switch the tool on (Ctrl-C ends the recording)\n"
        "k: keep, r: repeat: k\nforce_n: tare of 2026-03-02T09:30:06+00:00, 1.0 h old\n"
    )
    end(folder, {})
    when = datetime(2026, 3, 2, 9, 30, tzinfo=UTC).astimezone().strftime("%Y-%m-%d %H:%M")
    wanted = f"check: no faults\nrecording 4 s; switch the tool on\nAnswer: keep\nforce_n: tare of {when}, 1.0 h old\n"
    assert wanted in ask(app, f"/jobs/{folder.name}")[2]
    assert (
        json.loads(ask(app, f"/jobs/{folder.name}/stream")[2].partition("event: log\ndata: ")[2].split("\n")[0])
        == wanted
    )


def test_the_list_says_where_and_what_was_searched(tmp_path):
    assert "matching “oak”." in ask(panel(tmp_path), "/recordings?q=oak")[2]
    assert f"1 recording in {tmp_path} matching" in ask(panel(tmp_path), "/recordings?q=oak")[2]


def test_orders_reach_the_command(tmp_path, started):
    app = panel(tmp_path)
    secret = secret_of(app)
    ask(app, "/record", form={"secret": secret, "material": "oak"})
    (folder,) = (tmp_path / "panel").iterdir()
    link = Link(folder)
    for order, text in (("note", "loud"), ("answer", "k"), ("stop", "")):
        form = {"secret": secret, "text": text, "number": "1"}
        assert ask(app, f"/jobs/{folder.name}/{order}", form=form)[0] == 303
    assert link.stop.wait(10.0)
    assert link.waiting_notes() == ["loud"]
    link.stop.clear()
    assert link.ask("keep?", choices="k r") == "k"
    assert not (folder / "question.json").exists()


def test_the_panel_shows_that_a_trial_of_a_series_is_evaluated(tmp_path):
    PanelDialogue(Link(tmp_path)).phase("evaluating the trial …")
    assert json.loads((tmp_path / "live.jsonl").read_text()) == {"kind": "phase", "phase": "evaluating the trial …"}


def test_an_answer_to_another_question_is_none_of_this_one(tmp_path):
    link = Link(tmp_path)
    (tmp_path / "orders.jsonl").write_text(
        '{"kind": "answer", "number": 7, "text": "r"}\n{"kind": "answer", "number": 1, "text": ""}\n'
    )
    assert link.ask("keep?", default="k", choices="k r") == "k"


def test_a_page_that_comes_late_starts_with_a_whole_line(tmp_path):
    path = tmp_path / "live.jsonl"
    path.write_text("".join(f'{{"n": {n}}}\n' for n in range(100)))
    lines = Follower(path, late_bytes=35).new_lines()
    assert [json.loads(line)["n"] for line in lines] == [97, 98, 99]
    with path.open("a") as file:
        file.write('{"n": 1')
    follower = Follower(path)
    assert len(follower.new_lines()) == 100
    with path.open("a") as file:
        file.write("00}\n")
    assert follower.new_lines() == ['{"n": 100}']


def test_without_its_packages_the_panel_says_how_to_get_them(monkeypatch, capsys):
    monkeypatch.setattr("sawbench.commands.panel._NEEDED", ("no_such_package_of_the_panel",))
    assert main(["panel"]) == 2
    assert 'pip install "sawbench[panel]"' in capsys.readouterr().err
