"""Who may use the panel: this machine; others with the token. Nothing of other sites gets in or out."""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import parse_qs, urlsplit

from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK: Final = frozenset({"127.0.0.1", "localhost", "::1"})
_COOKIE: Final = "sawbench_panel"
_OWN_PAGE: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
# Pages of results bring their own style and script; in a sandbox they are no part of the panel.
_RESULT_PAGE: Final = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "img-src data:; frame-ancestors 'none'"
)


class Guard:
    """Answers for the panel where a request may not pass, and sets the headers of every answer.

    Parameters
    ----------
    app : ASGI application
    token : str
        That a browser on another machine must show; empty: only this machine is served.

    Notes
    -----
    Without a token the `Host` of a request must be this machine, so that a foreign name that leads here (DNS
    rebinding) is refused. With one, every request needs the cookie that `/?token=...` sets. A request that changes
    something must come from a page of the panel, as the browser states it in `Origin` and `Sec-Fetch-Site`; the forms
    carry a secret besides, see `app`.
    """

    def __init__(self, app: ASGIApp, token: str = "") -> None:
        self._app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request pass or answer it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = {key.decode("latin-1").lower(): value.decode("latin-1") for key, value in scope["headers"]}
        refused = self._refusal(scope, headers)
        if refused is not None:
            await refused(scope, receive, _with_headers(send, _OWN_PAGE))
            return
        is_result = "/files/" in scope["path"]
        await self._app(scope, receive, _with_headers(send, _RESULT_PAGE if is_result else _OWN_PAGE))

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> Response | None:
        host = headers.get("host", "")
        if not self._token and _name_of(host) not in LOOPBACK:
            return PlainTextResponse("The panel serves only this computer, at http://127.0.0.1.\n", 421)
        if self._token and (answer := self._without_token(scope, headers)) is not None:
            return answer
        if scope["method"] not in {"GET", "HEAD"} and not _is_own(headers, host):
            return PlainTextResponse("Requests from other sites are refused.\n", 403)
        return None

    def _without_token(self, scope: Scope, headers: dict[str, str]) -> Response | None:
        if _is_same(_cookie(headers.get("cookie", "")), self._token):
            return None
        shown = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if scope["method"] == "GET" and _is_same(shown, self._token):
            answer = RedirectResponse(scope["path"], 303)
            # Not "strict": a page of a result is in a sandbox, so that its link back counts as one of another site.
            # What changes something is a POST, to which "lax" gives no more.
            answer.set_cookie(_COOKIE, self._token, httponly=True, samesite="lax", path="/")
            return answer
        return PlainTextResponse(
            "The panel needs its token: open the address that `sawbench panel` has printed.\n", 401
        )


def new_secret() -> str:
    """Return a secret that nobody guesses."""
    return secrets.token_urlsafe(24)


def _is_same(shown: str, secret: str) -> bool:
    return secrets.compare_digest(shown.encode(), secret.encode())


def _name_of(host: str) -> str:
    """Return the host of `Host: name:port`; empty where it is none.

    Examples
    --------
    >>> _name_of("127.0.0.1:8765"), _name_of("[::1]:8765"), _name_of("evil.example")
    ('127.0.0.1', '::1', 'evil.example')
    """
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _is_own(headers: dict[str, str], host: str) -> bool:
    if headers.get("sec-fetch-site", "same-origin") != "same-origin":
        return False
    origin = headers.get("origin")
    return origin is None or urlsplit(origin).netloc == host


def _cookie(text: str) -> str:
    try:
        found = SimpleCookie(text).get(_COOKIE)
    except CookieError:
        return ""
    return "" if found is None else found.value


def _with_headers(send: Send, policy: str) -> Send:
    added: Iterable[tuple[str, str]] = (
        ("content-security-policy", policy),
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "same-origin"),
        ("cross-origin-opener-policy", "same-origin"),
        ("cross-origin-resource-policy", "same-origin"),
        ("cache-control", "no-store"),
    )

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], *((k.encode(), v.encode()) for k, v in added)]
        await send(message)

    return sent
