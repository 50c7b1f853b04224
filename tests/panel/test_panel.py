"""What the panel answers, asked without a browser: who may ask, what a form becomes, what a name may lead to."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
from pathlib import Path
from urllib.parse import urlencode

import pytest

pytest.importorskip("starlette", reason="the panel needs sawbench[panel]")

from sawbench.commands.link import Link
from sawbench.commands.main import main
from sawbench.commands.panel import refusal
from sawbench.panel import jobs as panel_jobs
from sawbench.panel.app import Follower, PanelSettings, build_app
from sawbench.panel.commands_of import BenchOptions, record
from sawbench.panel.jobs import Jobs
from sawbench.panel.series_state import known_plans, series_state

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


def panel(folder: Path, token: str = ""):
    shutil.copy(SAMPLES / "oak-01.mcap", folder)
    (folder / "secret.txt").write_text("not for the panel")
    facts = {"config": "", "devices": [], "channels": ["force_n"], "in_force": [], "problem": ""}
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
    assert "HttpOnly" in headers["set-cookie"] and "SameSite=strict" in headers["set-cookie"]
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
    assert main(["series", "plan", "--material", "oak", "--out", str(tmp_path / "wood.toml")]) == 0
    assert list(known_plans([tmp_path])) == ["wood.toml", "next.csv"]
    state = series_state(tmp_path / "wood.toml")
    assert state.progress is not None and len(state.progress.trials) == 3
    assert "oak" in ask(panel(tmp_path), "/series/wood.toml")[2]


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
