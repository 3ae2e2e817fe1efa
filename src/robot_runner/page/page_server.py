"""The web server of the live page: its routes, each with the role that it needs."""

from __future__ import annotations

import asyncio
import json
import shlex
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from robot_runner.core.errors import ExecutionError, RobotRunnerError
from robot_runner.core.storage.guarded_files import MissingFileError, read_bytes
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.page.event_stream import Channel, EventStream, Followers, as_json
from robot_runner.page.found_experiments import FoundExperiments, metrics_text
from robot_runner.page.page_access import LOGIN_LASTS, Keys, RateLimit, Role, is_known_host, is_of_same_origin
from robot_runner.page.person_actions import ACTIONS, RefusedAnswersError
from robot_runner.page.robot_pictures import RobotPictures

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.types import ASGIApp, Receive, Scope, Send

    from robot_runner.page.followed_experiment import FollowedExperiment

_KINDS = {
    ".js": "text/javascript",
    ".css": "text/css",
    ".html": "text/html",
    ".svg": "image/svg+xml",
    ".txt": "text/plain",
}
#: The files of the page, by package.
_ASSETS = {
    **{each.name: "robot_runner.page" for each in files("robot_runner.page").joinpath("assets").iterdir()},
    **dict.fromkeys(
        ("palette.css", "uPlot-1.6.32.iife.min.js", "uPlot-1.6.32.min.css", "uPlot-LICENSE.txt"), "robot_runner.core"
    ),
}
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "x-frame-options": "DENY",
    "cache-control": "no-store",
}
#: A report has scripts and comes from a folder that an attacker may have prepared: it gets an opaque origin, so that it
#: cannot send requests to this server with the viewer's cookie.
_REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
#: A header that a page sends with each action, and that no form and no other site can send.
_OWN_HEADER = "x-robot-runner"
_MOST_BODY = 64_000
_MOST_ROWS = 500
#: How often the list of experiments is looked at, s.
_INDEX_EVERY = 1.0


@dataclass(frozen=True, slots=True)
class PageSettings:
    """How a page is served.

    Attributes:
        folder: the experiment's, or one with experiments below it.
        port: where it listens.
        names: host names by which browsers may address it, beside numeric addresses.
        keys: for looking and acting.
        is_read_only: whether nobody may act.
        is_one: whether the folder is an experiment's own, which may not exist yet.
    """

    folder: Path
    port: int
    names: frozenset[str]
    keys: Keys
    is_read_only: bool = False
    is_one: bool = False
    most_viewers: int = 100
    requests: RateLimit = field(default_factory=lambda: RateLimit(burst=300, rate=60.0))
    attempts: RateLimit = field(default_factory=lambda: RateLimit(burst=10, rate=0.2))


class LivePage:
    """The page of one folder, as an ASGI application.

    Args:
        settings: how it is served.
    """

    def __init__(self, settings: PageSettings) -> None:
        self._settings = settings
        self._found = FoundExperiments(settings.folder, is_one=settings.is_one)
        self._index = Channel(self._found, _INDEX_EVERY)
        self._followers = Followers()
        self._pictures: dict[str, RobotPictures] = {}
        self._rendering = asyncio.Lock()
        self._assets = {name: _asset(name, package) for name, package in _ASSETS.items()}
        acts, looks = Role.ACTS, Role.LOOKS
        one = "/api/experiments/{experiment}"
        routes = [
            Route("/", self._page),
            Route("/assets/{name}", self._asset),
            Route("/api/login", self._login, methods=["POST"]),
            Route("/api/logout", self._logout, methods=["POST"]),
            Route("/api/about", _for(looks, self._about)),
            Route("/api/events", _for(looks, self._index_events)),
            Route(f"{one}/events", _for(looks, self._events)),
            Route(f"{one}/rows", _for(looks, self._rows)),
            Route(f"{one}/curves/{{run}}", _for(looks, self._curves)),
            Route(f"{one}/picture/{{run}}", _for(looks, self._picture)),
            Route(f"{one}/report", _for(looks, self._report)),
            Route(f"{one}/{{action}}", _for(acts, self._act), methods=["POST"]),
            Route("/metrics", _for(looks, self._metrics)),
        ]
        handlers = {HTTPException: _refusal, RobotRunnerError: _error}
        self._app = Starlette(routes=routes, exception_handlers=handlers, lifespan=self._life)  # type: ignore[arg-type]
        self._app.state.page = self

    @property
    def app(self) -> ASGIApp:
        """The application, which checks each request before it is routed."""
        return self._guarded

    def role(self, request: Request) -> Role:
        """Return the role of the sender of a request."""
        keys = self._settings.keys
        word, _, bearer = request.headers.get("authorization", "").partition(" ")
        role = keys.role_of_login(request.cookies.get(self._cookie, ""))
        if word.casefold() == "bearer":
            role = max(role, keys.role_of_key(bearer.strip()))
        return min(role, Role.LOOKS) if self._settings.is_read_only else role

    @property
    def _cookie(self) -> str:
        # With the port, as browsers send cookies of a host to all its ports.
        return f"robot_runner_{self._settings.port}"

    @asynccontextmanager
    async def _life(self, _app: Starlette) -> AsyncIterator[None]:
        try:
            yield
        finally:
            self._followers.close()
            self._index.stop()
            for pictures in self._pictures.values():
                pictures.close()

    async def _guarded(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        address = scope["client"][0] if scope.get("client") else ""
        refused = self._refused(scope["method"], headers, address)
        if refused is not None:
            await refused(scope, receive, send)
            return
        await self._app(scope, receive, _with_headers(send))

    def _refused(self, method: str, headers: dict[str, str], address: str) -> Response | None:
        is_action = method not in {"GET", "HEAD"}
        if not is_known_host(headers.get("host", ""), self._settings.names):
            return _plain(421, "This page is not served under that name. robot-runner watch --name NAME adds one.")
        if not is_of_same_origin(headers, is_action=is_action):
            return _plain(403, "This request comes from another site.")
        if not self._settings.requests.lets_pass(address):
            return _plain(429, "Too many requests: wait a moment.")
        return _refused_action(headers) if is_action else None

    # Without a key: files that have nothing of an experiment.

    async def _page(self, _request: Request) -> Response:
        return Response(self._assets["page.html"], media_type="text/html")

    async def _asset(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in self._assets or name == "page.html":
            raise HTTPException(404, "There is no such file.")
        return Response(self._assets[name], media_type=_KINDS[name[name.rindex(".") :]])

    async def _login(self, request: Request) -> Response:
        """Set the cookie for the key of a link."""
        address = request.client.host if request.client else ""
        if not self._settings.attempts.lets_pass(address):
            raise HTTPException(429, "Too many keys were tried: wait a minute.")
        said = await _body(request)
        role = self._settings.keys.role_of_key(str(said.get("key", "")))
        if role is Role.NOBODY:
            raise HTTPException(403, "This link is not valid, or no longer: ask for the present one.")
        response = JSONResponse({"role": role.name})
        login = self._settings.keys.login(role)
        response.set_cookie(self._cookie, login, max_age=LOGIN_LASTS, httponly=True, samesite="strict", path="/")
        return response

    async def _logout(self, _request: Request) -> Response:
        response = JSONResponse({})
        response.delete_cookie(self._cookie, httponly=True, samesite="strict", path="/")
        return response

    # With a key.

    async def _about(self, request: Request) -> Response:
        only = await asyncio.to_thread(lambda: self._found.only)
        may_act = self.role(request) is Role.ACTS
        links = {"LOOKS": self._settings.keys.key(Role.LOOKS)}
        told = {"only": only, "may_act": may_act, "name": self._settings.folder.name, "links": links}
        return Response(as_json(told), media_type="application/json")

    async def _index_events(self, _request: Request) -> Any:
        return self._stream(self._index)

    async def _events(self, request: Request) -> Any:
        _, channel = self._followers.channel(await self._folder(request))
        return self._stream(channel)

    async def _rows(self, request: Request) -> Response:
        experiment = await self._followers.looked_at(await self._folder(request))
        asked = request.query_params
        start, count = _number(asked.get("start"), 0), min(_MOST_ROWS, _number(asked.get("count"), 100))
        status, text = asked.get("status", "")[:20], asked.get("text", "")[:100]
        found = await asyncio.to_thread(experiment.rows, start, count, status=status, text=text)
        return Response(as_json(found), media_type="application/json")

    async def _curves(self, request: Request) -> Response:
        experiment = await self._followers.looked_at(await self._folder(request))
        found = await asyncio.to_thread(experiment.curves, request.path_params["run"])
        return Response(await asyncio.to_thread(as_json, found), media_type="application/json")

    async def _picture(self, request: Request) -> Response:
        experiment = await self._followers.looked_at(await self._folder(request))
        pose = await asyncio.to_thread(experiment.pose, request.path_params["run"])
        if experiment.robot is None or pose is None:
            raise HTTPException(404, "Nothing tells where the robot is.")
        pictures = self._pictures.setdefault(experiment.robot, RobotPictures(experiment.robot))
        async with self._rendering:  # so that waiting requests take no thread
            await asyncio.sleep(pictures.wait_s(pose))
            image = await asyncio.to_thread(pictures.picture, pose)
        return Response(image, media_type="image/png")

    async def _report(self, request: Request) -> Response:
        content = await asyncio.to_thread(_report_in, await self._folder(request))
        return Response(content, media_type="text/html", headers={"content-security-policy": _REPORT_POLICY})

    async def _act(self, request: Request) -> Response:
        act = ACTIONS.get(request.path_params["action"])
        if act is None:
            raise HTTPException(404, "There is no such action.")
        experiment: FollowedExperiment = await self._followers.looked_at(await self._folder(request))
        said = await _body(request)
        return JSONResponse({"said": await asyncio.to_thread(act, experiment, said)})

    async def _metrics(self, _request: Request) -> Response:
        told = (await asyncio.to_thread(self._found.look))["experiments"]
        viewers = self._followers.viewers + len(self._index)
        text = metrics_text(told, viewers).encode("utf-8", "replace")  # names of folders may have invalid bytes
        return Response(text, media_type="text/plain; version=0.0.4; charset=utf-8")

    async def _folder(self, request: Request) -> Path:
        folder = await asyncio.to_thread(self._found.folder, request.path_params["experiment"])
        if folder is None:
            raise HTTPException(404, "There is no such experiment.")
        return folder

    def _stream(self, channel: Channel) -> Any:
        if self._followers.viewers + len(self._index) >= self._settings.most_viewers:
            raise HTTPException(503, f"{self._settings.most_viewers} people look already.")
        return EventStream(channel, _HEADERS)


def _refused_action(headers: dict[str, str]) -> Response | None:
    """Return the refusal of a request that changes something, by its headers, or None."""
    if headers.get(_OWN_HEADER) != "1":
        return _plain(403, "This request does not come from the live page.")
    if not headers.get("content-length", "").isdecimal():
        return _plain(411, "This request does not say how long it is.")
    if int(headers["content-length"]) > _MOST_BODY:
        return _plain(413, "This request is too long.")
    return None


def _for(least: Role, endpoint: Callable[[Request], Awaitable[Any]]) -> Callable[[Request], Awaitable[Any]]:
    """Return an endpoint that requires a role."""

    async def guarded(request: Request) -> Any:
        page: LivePage = request.app.state.page
        role = page.role(request)
        if role is Role.NOBODY:
            raise HTTPException(401, "Open this page by the link that the terminal shows.")
        if role < least:
            raise HTTPException(403, "This link is for looking only.")
        return await endpoint(request)

    return guarded


def _with_headers(send: Send) -> Send:
    async def sending(message: Any) -> None:
        if message["type"] == "http.response.start":
            given = {name for name, _ in message["headers"]}
            more = [(name.encode(), value.encode()) for name, value in _HEADERS.items() if name.encode() not in given]
            message = {**message, "headers": [*message["headers"], *more]}
        await send(message)

    return sending


def _plain(status: int, text: str) -> Response:
    return JSONResponse({"problem": text}, status_code=status, headers=_HEADERS)


async def _refusal(_request: Request, error: HTTPException) -> Response:
    return JSONResponse({"problem": error.detail}, status_code=error.status_code)


async def _error(_request: Request, error: RobotRunnerError) -> Response:
    """Return the response for an error of ours; refused answers have the names of their questions."""
    found = [{"where": each.where, "problem": each.problem, "fix": each.fix} for each in error.findings]
    status = 422 if isinstance(error, RefusedAnswersError) else 409
    return JSONResponse({"problem": error.findings[0].problem, "findings": found}, status_code=status)


async def _body(request: Request) -> dict[str, Any]:
    try:
        said = json.loads(await request.body())
    except (ValueError, RecursionError):
        said = None
    if not isinstance(said, dict):
        raise HTTPException(400, "This request is not a JSON object.")
    return said


def _number(text: str | None, otherwise: int) -> int:
    return int(text) if text and text.isascii() and text.isdecimal() and len(text) < 10 else otherwise  # noqa: PLR2004 - a billion rows


def _asset(name: str, package: str) -> bytes:
    return files(package).joinpath("assets", name).read_bytes()


def _report_in(folder: Path) -> bytes:
    try:
        return read_bytes(ExperimentFolder(folder).report / "report.html", folder)
    except MissingFileError as error:
        fix = f"Make it: robot-runner report {shlex.quote(folder.name)}"
        raise ExecutionError("there is no report yet", where=folder.name, fix=fix) from error
