"""The pages of the panel and what their buttons do."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, quote

import sawbench.reporting
from sawbench.acquisition.series.rejected import move_to_rejected
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.panel import commands_of
from sawbench.panel.commands_of import BenchOptions, Call
from sawbench.panel.jobs import KINDS, Job, Jobs
from sawbench.panel.security import Guard, new_secret
from sawbench.panel.series_state import SeriesState, known_plans, series_state
from sawbench.panel.shelf import PANEL_FOLDER, Shelf, corrections
from sawbench.panel.templates import render
from sawbench.storage.amendments import AMENDABLE, amend
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
_LOOK_EVERY_S: Final = 0.2
# Of the live numbers, a page that is opened late gets so much of what was before.
_LATE_BYTES: Final = 300_000

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
        ("/calibrate", panel.start_with(commands_of.calibrate)), ("/record", panel.start_with(commands_of.record)),
        ("/series", panel.make_plan), ("/series/{name}", panel.run_series), ("/series/{name}/repeat", panel.repeat),
        ("/compare", panel.compare), ("/diagnose", panel.diagnose), ("/amend", panel.amend), ("/reject", panel.reject),
        ("/report", panel.report), ("/jobs/{job}/{order}", panel.order),
    ]  # fmt: skip
    routes = [
        *(Route(path, panel.answered(handler), methods=["GET"]) for path, handler in pages),
        *(Route(path, panel.answered(panel.with_form(handler)), methods=["POST"]) for path, handler in actions),
    ]
    return Starlette(routes=routes, middleware=[Middleware(Guard, token=token)])


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
                return self._page("message.html.j2", request, 400, title="Error", error=error)

        return answer

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
                    remedy="go back, reload the page and enter the values again",
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
            raise InputError(refused, remedy="go back and correct it")
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
        return self._page("bench.html.j2", request, title="Bench", bench=known, check=self._jobs.latest("check"),
                          former=_former(self._jobs.latest("tare")))  # fmt: skip

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
        if not name or Path(name).name != name or name.startswith("."):
            raise InputError(f"{name!r} is not a valid plan name: it is also the file name", remedy="go back")
        out = self._settings.plans / f"{name.removesuffix('.toml')}.toml"
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
            raise InputError(refused, remedy="go back and correct it")

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
        report = next((j for j in self._jobs.all() if j.kind == "report" and j.form.get("file") == str(row.path)), None)
        return self._page("recording.html.j2", request, title=f"Recording {row.key}", row=row, report=report,
                          amendable=AMENDABLE)  # fmt: skip

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
            raise InputError("no recording is selected", remedy="go back and select recordings")
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
        return self._page("job.html.j2", request, title=job.title[:1].upper() + job.title[1:], **context)

    def _result_of(self, job: Job) -> dict[str, Any]:
        """Return the recording of a job and the job that evaluates it, which is started where there is none yet."""
        path = Path((job.result or {}).get("path", ""))
        key = next((key for key, known in self._shelf.keys().items() if known.resolve() == path.resolve()), "")
        if not key:
            return {"key": ""}
        known = next((j for j in self._jobs.all() if j.kind == "report" and j.form.get("file") == str(path)), None)
        if known is None:
            try:
                known = self._start(commands_of.report(self._options, path))
            except SawbenchError:
                return {"key": key}
        return {"key": key, "report": known}

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
        await asyncio.sleep(_LOOK_EVERY_S)
        return _to(job)

    async def stream(self, request: Request) -> Response:
        """What a job says, as it says it: server-sent events."""
        return StreamingResponse(_events(self._jobs, self._job(request), request), media_type="text/event-stream")

    async def file(self, request: Request) -> Response:
        """One of the files that a job has written."""
        job, name = self._job(request), request.path_params["name"]
        if name not in job.files:
            raise InputError(f"the job has written no file {name!r}")
        return FileResponse(job.folder / name)

    async def static(self, request: Request) -> Response:
        """Script and style of the panel."""
        name = request.path_params["name"]
        if name not in _STATIC:
            return Response(status_code=404)
        folder, media_type = _STATIC[name]
        return FileResponse(folder / name, media_type=media_type)


def _to(job: Job) -> RedirectResponse:
    return RedirectResponse(f"/jobs/{job.id}", 303)


def _former(job: Job | None) -> Mapping[str, str]:
    return {} if job is None else job.form


async def _events(jobs: Jobs, job: Job, request: Request) -> AsyncIterator[str]:
    """Follow the files of a job until it has ended or the page is closed."""
    live = Follower(job.folder / "live.jsonl", late_bytes=_LATE_BYTES)
    log = Follower(job.folder / "log.txt")
    state: dict[str, Any] = {}
    while not await request.is_disconnected():
        found = await run_in_threadpool(jobs.get, job.id)
        if found is None:
            return
        if lines := [json.loads(line) for line in live.new_lines()]:
            yield _event("live", lines)
        if text := log.new_text():
            yield _event("log", text)
        now = {"question": found.question.get("number"), "is_running": found.is_running}
        if now != state:
            state = now
            yield _event("state", state)
        if not found.is_running:
            return
        await asyncio.sleep(_LOOK_EVERY_S)


def _event(name: str, content: Any) -> str:
    return f"event: {name}\ndata: {json.dumps(content)}\n\n"


class Follower:
    """What is added to a file while it is watched.

    Parameters
    ----------
    path : Path
        Need not be there yet.
    late_bytes : int, optional
        How much of what is there already is given; default: all.
    """

    def __init__(self, path: Path, *, late_bytes: int | None = None) -> None:
        self._path = path
        self._rest = b""
        size = path.stat().st_size if path.exists() else 0
        # The line in the middle of which that begins is dropped: `new_lines` takes whole ones alone.
        self._position = 0 if late_bytes is None else max(0, size - late_bytes)

    def new_lines(self) -> list[str]:
        """Return the lines that are complete and new."""
        *lines, self._rest = (self._rest + self._read()).split(b"\n")
        return [line.decode() for line in lines if line.startswith(b"{")]

    def new_text(self) -> str:
        """Return what is new."""
        return self._read().decode(errors="replace")

    def _read(self) -> bytes:
        try:
            with self._path.open("rb") as file:
                file.seek(self._position)
                new = file.read()
        except OSError:
            return b""
        self._position += len(new)
        return new
