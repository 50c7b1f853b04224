"""The pages of the panel and what their buttons do."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, quote, urlsplit

import sawbench.reporting
from sawbench.acquisition.series.rejected import move_to_rejected
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.panel import commands_of
from sawbench.panel.commands_of import BenchOptions, Call
from sawbench.panel.follower import LOOK_EVERY_S, events
from sawbench.panel.jobs import KINDS, Job, Jobs
from sawbench.panel.measured import rows_of, value_of
from sawbench.panel.result_page import with_way_back
from sawbench.panel.security import Guard, new_secret
from sawbench.panel.series_state import SeriesState, known_plans, series_state
from sawbench.panel.shelf import PANEL_FOLDER, Shelf, corrections
from sawbench.panel.templates import render
from sawbench.panel.words import local, refusal_in_panel
from sawbench.reporting.html import link_to
from sawbench.storage.amendments import AMENDABLE, amend, amendments_path
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route

_OWN: Final = Path(__file__).parent
_ASSETS: Final = Path(sawbench.reporting.__path__[0]) / "assets"
_STATIC: Final = {
    "panel.js": (_OWN, "text/javascript"), "panel.css": (_OWN, "text/css"),
    "uPlot.iife.min.js": (_ASSETS, "text/javascript"), "uPlot.min.css": (_ASSETS, "text/css"),
}  # fmt: skip
_LARGEST_FORM: Final = 1_000_000

# Also the name of a file, on every system.
_PLAN_NAME: Final = re.compile(r"\w[\w .-]*")

Handler = Callable[[Request], Any]


@dataclass(frozen=True, kw_only=True, slots=True)
class PanelSettings:
    """What the panel needs to know.

    Attributes
    ----------
    options : BenchOptions
    plans : Path
        Folder in which plans of series lie.
    bench : callable
        Returns what to show of the bench: configuration, instruments, tares and calibrations in force.
    refusal : callable
        Given arguments of `sawbench`, says what is wrong with them; empty where nothing is.
    second_copy : str, optional
        Folder with second copies of recordings.
    """

    options: BenchOptions
    plans: Path
    bench: Callable[[], Mapping[str, Any]]
    refusal: Callable[[Sequence[str]], str]
    second_copy: str | None = None


def build_app(settings: PanelSettings, *, token: str = "") -> Starlette:
    """Return the panel as an ASGI application.

    Parameters
    ----------
    settings : PanelSettings
    token : str
        That a browser must show; empty: this machine alone is served, see `security.Guard`.
    """
    panel = Panel(settings)
    pages: list[tuple[str, Handler]] = [
        ("/", panel.bench), ("/record", panel.trial), ("/series", panel.series), ("/series/{name}", panel.one_series),
        ("/recordings", panel.recordings), ("/recording", panel.recording), ("/jobs", panel.jobs_page),
        ("/jobs/{job}", panel.job), ("/jobs/{job}/stream", panel.stream), ("/jobs/{job}/files/{name:path}", panel.file),
        ("/static/{name}", panel.static),
    ]  # fmt: skip
    actions: list[tuple[str, Handler]] = [
        ("/check", panel.start_with(commands_of.check)), ("/tare", panel.start_with(commands_of.tare)),
        ("/calibrate", panel.calibrate), ("/record", panel.start_with(commands_of.record)),
        ("/series", panel.make_plan), ("/series/{name}", panel.run_series), ("/series/{name}/repeat", panel.repeat),
        ("/compare", panel.compare), ("/diagnose", panel.diagnose), ("/amend", panel.amend), ("/reject", panel.reject),
        ("/report", panel.report), ("/jobs/{job}/{order}", panel.order),
    ]  # fmt: skip
    routes = [
        *(Route(path, panel.answered(handler), methods=["GET"]) for path, handler in pages),
        *(Route(path, panel.answered(panel.with_form(handler)), methods=["POST"]) for path, handler in actions),
    ]
    return Starlette(
        routes=routes, middleware=[Middleware(Guard, token=token)], exception_handlers={404: panel.unknown}
    )


class Panel:
    """Handlers of the pages and forms."""

    def __init__(self, settings: PanelSettings) -> None:
        self._settings = settings
        self._options = settings.options
        self._jobs = Jobs(settings.options.recordings / PANEL_FOLDER)
        self._shelf = Shelf(settings.options.recordings)
        # A page of another site cannot read it, so that it cannot send a form of ours.
        self._secret = new_secret()

    # How every request is answered.

    def answered(self, handler: Handler) -> Handler:
        """Turn errors of the user into a page that says them."""

        async def answer(request: Request) -> Response:
            try:
                return await handler(request)
            except SawbenchError as error:
                return self._page("message.html.j2", request, 400, title="Error", error=error, back=_before(request))

        return answer

    async def unknown(self, request: Request, _: Exception) -> Response:
        """Say that there is no such page."""
        error = InputError(f"the panel has no page {request.url.path}", remedy="select one from the menu above")
        return self._page("message.html.j2", request, 404, title="Page not found", error=error, back=_before(request))

    def with_form(self, handler: Handler) -> Handler:
        """Give the handler the form, as `request.state.form`, once it is known to be one of ours."""

        async def handle(request: Request) -> Response:
            body = bytearray()
            async for chunk in request.stream():
                body += chunk
                if len(body) > _LARGEST_FORM:
                    raise InputError("the form is too large")
            try:
                fields = parse_qs(body.decode(), keep_blank_values=True, max_num_fields=5000)
            except ValueError:
                raise InputError("the form is not readable") from None
            if fields.get("secret") != [self._secret]:
                raise InputError(
                    "the panel was restarted after this page was loaded",
                    remedy="reload the page before and enter the values again",
                )
            request.state.files = fields.get("file", [])
            request.state.form = {name: values[-1] for name, values in fields.items() if name != "secret"}
            return await handler(request)

        return handle

    def _page(self, template: str, request: Request, status: int = 200, /, **context: Any) -> HTMLResponse:
        bench_job = self._jobs.on_bench()
        text = render(
            template,
            {
                "secret": self._secret,
                "path": request.url.path,
                "is_simulated": self._options.simulated,
                "on_bench": bench_job,
                **context,
            },
        )
        return HTMLResponse(text, status)

    def _start(self, call: Call) -> Job:
        refused = self._settings.refusal(call.arguments)
        if refused:
            raise InputError(refusal_in_panel(refused, commands_of.LABELS))
        return self._jobs.start(call.kind, call.title, call.arguments, form=call.form)

    def start_with(self, make: Callable[[BenchOptions, Mapping[str, str]], Call]) -> Handler:
        """Return the handler that starts a command from its form and leads to its page."""

        async def start(request: Request) -> Response:
            return _to(await run_in_threadpool(self._start, make(self._options, request.state.form)))

        return start

    # The bench.

    async def bench(self, request: Request) -> Response:
        """Instruments and their health, tare, calibration."""
        known = await run_in_threadpool(self._settings.bench)
        return self._page("bench.html.j2", request, title="Bench", bench=known,
                          in_force=[{**entry, "value": value_of(entry, entry["unit"])} for entry in known["in_force"]],
                          check=self._jobs.latest("check"),
                          former=_former(self._jobs.latest("tare")))  # fmt: skip

    async def calibrate(self, request: Request) -> Response:
        """Start a calibration; that one would be replaced is said before any load is applied."""
        form = request.state.form
        known = await run_in_threadpool(self._settings.bench)
        made = [e for e in known["in_force"] if e["kind"] == "calibration" and e["channel"] == form.get("channel")]
        if made and not form.get("replace"):
            raise InputError(
                f"{made[0]['channel']} already has a calibration, of {local(made[0]['made_at'])}",
                remedy="to replace it, tick “replace the current calibration”; it stays in the history",
            )
        return await self.start_with(commands_of.calibrate)(request)

    # Trials and series.

    async def trial(self, request: Request) -> Response:
        """Form of a trial, filled in as the last one."""
        last = self._jobs.latest("record")
        form = dict(_former(last))
        form.pop("note", None)
        form.pop("trial", None)
        if form.get("repetition", "").isdigit() and request.query_params.get("next") is not None:
            form["repetition"] = str(int(form["repetition"]) + 1)
        return self._page("trial.html.j2", request, title="Trial", form=form, last=last)

    async def series(self, request: Request) -> Response:
        """Plans of series, and the form of a new one."""
        plans = await run_in_threadpool(self._plans)
        states = [await run_in_threadpool(series_state, path) for path in plans.values()]
        return self._page("series.html.j2", request, title="Series", states=states)

    def _plans(self) -> dict[str, Path]:
        return known_plans([self._settings.plans, *(job.folder / "gap" for job in self._jobs.all())])

    async def _series(self, request: Request) -> SeriesState:
        path = (await run_in_threadpool(self._plans)).get(request.path_params["name"])
        if path is None:
            raise InputError("there is no plan with this name", where=self._settings.plans)
        return await run_in_threadpool(series_state, path)

    async def one_series(self, request: Request) -> Response:
        """How far a series is, and its next step."""
        state = await self._series(request)
        return self._page("plan.html.j2", request, title=f"Series {state.name}", state=state,
                          former=_former(self._jobs.latest("series")))  # fmt: skip

    async def make_plan(self, request: Request) -> Response:
        """Write a plan."""
        form = request.state.form
        name = form.get("name", "").strip()
        if not _PLAN_NAME.fullmatch(name):
            raise InputError(
                f"{name!r} is not a valid plan name",
                remedy="use letters, digits, spaces and . _ -, with a letter or a digit first: it is also a file name",
            )
        out = self._settings.plans / f"{name.removesuffix('.toml')}.toml"
        if out.exists():
            raise InputError(f"there is already a plan {out.stem!r}", remedy="choose another name")
        await self._run_now(commands_of.series_plan(self._options, form, out))
        return RedirectResponse(f"/series/{quote(out.name, safe='')}", 303)

    async def run_series(self, request: Request) -> Response:
        """Continue a series."""
        state = await self._series(request)
        call = commands_of.series_run(self._options, state.path, request.state.form)
        return _to(await run_in_threadpool(self._start, call))

    async def repeat(self, request: Request) -> Response:
        """Reject a trial of a series, kept or not."""
        state, form = await self._series(request), request.state.form
        because = f"--because={form.get('because', '').strip() or 'no reason given'}"
        await self._run_now(
            ["series", "repeat", because, *self._options.config, "--", str(state.path), form.get("trial", "")]
        )
        return RedirectResponse(f"/series/{quote(state.key, safe='')}", 303)

    async def _run_now(self, arguments: Sequence[str]) -> None:
        """Run a command that takes a moment; what it refuses is said."""
        from sawbench.panel.run_now import run_now

        refused = self._settings.refusal(arguments) or await run_in_threadpool(run_now, arguments)
        if refused:
            raise InputError(refusal_in_panel(refused, commands_of.LABELS))

    # Recordings.

    async def recordings(self, request: Request) -> Response:
        """Return the list, searched."""
        query = request.query_params.get("q", "")
        rows = await run_in_threadpool(self._shelf.rows, query)
        return self._page("recordings.html.j2", request, title="Recordings", rows=rows, query=query,
                          folder=self._shelf.root)  # fmt: skip

    async def recording(self, request: Request) -> Response:
        """One recording: settings, corrections, result."""
        row = await run_in_threadpool(self._shelf.row, request.query_params.get("file", ""))
        report = self._report_of(row.path)
        return self._page("recording.html.j2", request, title=f"Recording {row.key}", row=row, report=report,
                          is_outdated=report is not None and _is_outdated(report), amendable=AMENDABLE)  # fmt: skip

    def _report_of(self, path: Path) -> Job | None:
        """Return the newest evaluation of a recording."""
        return next((j for j in self._jobs.all() if j.kind == "report" and j.form.get("file") == str(path)), None)

    async def amend(self, request: Request) -> Response:
        """Keep a correction of the settings."""
        form = request.state.form
        row = await run_in_threadpool(self._shelf.row, form.get("file", ""))
        new = corrections(form, row.trial)
        made = partial(amend, row.path, row.trial, new, by=form.get("by", ""), because=form.get("because", ""))
        await run_in_threadpool(made)
        return RedirectResponse(f"/recording?file={quote(row.key)}", 303)

    async def reject(self, request: Request) -> Response:
        """Move a recording to the rejected ones and lead to the form of its repetition."""
        path = self._shelf.path(request.state.form.get("file", ""))
        moved = partial(move_to_rejected, path, path.stem, second_copy=self._settings.second_copy)
        await run_in_threadpool(moved)
        return RedirectResponse("/record", 303)

    async def report(self, request: Request) -> Response:
        """Write the page of a recording."""
        path = self._shelf.path(request.state.form.get("file", ""))
        return _to(await run_in_threadpool(self._start, commands_of.report(self._options, path)))

    async def compare(self, request: Request) -> Response:
        """Compare the chosen recordings."""
        return _to(await run_in_threadpool(self._start, commands_of.compare(self._options, self._chosen(request))))

    async def diagnose(self, request: Request) -> Response:
        """Diagnose the chosen recordings."""
        call = commands_of.diagnose(self._options, self._chosen(request), request.state.form)
        return _to(await run_in_threadpool(self._start, call))

    def _chosen(self, request: Request) -> list[Path]:
        if not request.state.files:
            raise InputError("no recording is selected", remedy="select recordings first")
        return [self._shelf.path(key) for key in request.state.files]

    # Jobs.

    async def jobs_page(self, request: Request) -> Response:
        """Everything that was started."""
        return self._page("jobs.html.j2", request, title="Jobs", jobs=self._jobs.all()[:200])

    def _job(self, request: Request) -> Job:
        job = self._jobs.get(request.path_params["job"])
        if job is None:
            raise InputError("there is no job with this name", remedy="select one from the list of jobs")
        return job

    async def job(self, request: Request) -> Response:
        """One job: live numbers, question, result."""
        job = self._job(request)
        context: dict[str, Any] = {"job": job, "needs_bench": KINDS[job.kind].needs_bench}
        if job.kind == "record" and not job.is_running:
            context |= await run_in_threadpool(self._result_of, job)
        if job.kind in {"tare", "calibrate"}:
            context["stored"] = rows_of(job.result) if "details" in (job.result or {}) else []
        if job.kind == "report":
            context["key"] = self._key_of(Path(job.form.get("file", "")))
        context["is_outdated"] = await run_in_threadpool(_is_outdated, context.get("report", job))
        return self._page("job.html.j2", request, title=job.title[:1].upper() + job.title[1:], **context)

    def _result_of(self, job: Job) -> dict[str, Any]:
        """Return the recording of a job and the job that evaluates it, which is started where there is none yet."""
        path = Path((job.result or {}).get("path", ""))
        key = self._key_of(path)
        if not key:
            return {"key": ""}
        known = self._report_of(path)
        if known is None:
            try:
                known = self._start(commands_of.report(self._options, path))
            except SawbenchError:
                return {"key": key}
        return {"key": key, "report": known}

    def _key_of(self, path: Path) -> str:
        """Return by what the list names a recording; empty where it is not in it."""
        return next((key for key, known in self._shelf.keys().items() if known.resolve() == path.resolve()), "")

    async def order(self, request: Request) -> Response:
        """Answer the question of a job, take a note, stop it."""
        job, form, kind = self._job(request), request.state.form, request.path_params["order"]
        if kind == "answer":
            number = form.get("number", "")
            job.order("answer", text=form.get("text", ""), number=int(number) if number.isdigit() else 0)
        elif kind in {"note", "stop"}:
            job.order(kind, text=form.get("text", ""))
        else:
            raise InputError(f"there is no action {kind!r}")
        await asyncio.sleep(LOOK_EVERY_S)
        return _to(job)

    async def stream(self, request: Request) -> Response:
        """What a job says, as it says it: server-sent events."""
        return StreamingResponse(events(self._jobs, self._job(request), request), media_type="text/event-stream")

    async def file(self, request: Request) -> Response:
        """One of the files that a job has written."""
        job, name = self._job(request), request.path_params["name"]
        if name not in job.files:
            raise InputError(f"the job has written no file {name!r}")
        path = job.folder / name
        if path.suffix != ".html":
            return FileResponse(path)
        return HTMLResponse(await run_in_threadpool(self._result_page, job, path))

    def _result_page(self, job: Job, path: Path) -> str:
        links = {}
        if job.kind == "report":
            recording = Path(job.form.get("file", ""))
            key = self._key_of(recording)
            links = {link_to(recording, path)[0]: f"/recording?file={quote(key)}" if key else ""}
        page = path.read_text(encoding="utf-8")
        return with_way_back(page, job=job.id, title=job.title, links=links)

    async def static(self, request: Request) -> Response:
        """Script and style of the panel."""
        name = request.path_params["name"]
        if name not in _STATIC:
            return Response(status_code=404)
        folder, media_type = _STATIC[name]
        return FileResponse(folder / name, media_type=media_type)


def _to(job: Job) -> RedirectResponse:
    return RedirectResponse(f"/jobs/{job.id}", 303)


def _before(request: Request) -> str:
    """Return the page of the panel that led here; the first one where the browser does not say."""
    referrer = urlsplit(request.headers.get("referer", ""))
    if referrer.netloc != request.headers.get("host", "") or not referrer.path.startswith("/"):
        return "/"
    return referrer.path + (f"?{referrer.query}" if referrer.query else "")


def _is_outdated(job: Job) -> bool:
    """Whether the settings of the recording were corrected after a job began to evaluate it."""
    if job.kind != "report":
        return False
    try:
        corrected_s = amendments_path(Path(job.form.get("file", ""))).stat().st_mtime
    except OSError:
        return False
    return corrected_s > job.started_at.timestamp()


def _former(job: Job | None) -> Mapping[str, str]:
    return {} if job is None else job.form
