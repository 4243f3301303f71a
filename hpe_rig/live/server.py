"""Server of the live page: loopback only, a random token in the address, one task a viewer, nothing else.

A viewer that is slow misses states; it never holds up the reading of the next one, let alone the acquisition.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import socket
import time
from collections.abc import AsyncIterator, Callable
from importlib import resources
from typing import final

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from hpe_rig.live.source import Source
from hpe_rig.store import StoreError, reason

HOST = "127.0.0.1"
START_S = 5.0
LEAST_PAUSE_S = 0.15
HURRIED_PAUSE_S = 0.02
IDLE_SHARE = 2.0
"""The reader rests this many times as long as its last reading took: it keeps no core busy that acquires."""
REQUEST_S, LOOK_S = 5.0, 1.0
"""Time within which a request must be there as a whole; half-open connections would else stay for ever."""
MOST_CONNECTIONS = 64
"""Far more than the viewers of one bench; what is open costs memory and file handles."""
ENDED = ("complete", "aborted", "failed")


@final
class ImpatientProtocol(H11Protocol):
    """Connections to the page: few at once, and each ended that sends no whole request within ``REQUEST_S``."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, or end it where there are too many."""
        super().connection_made(transport)
        if len(self.connections) > MOST_CONNECTIONS:
            transport.abort()
            return
        self._waits_since_s = self.loop.time()
        self._look()

    def _look(self) -> None:
        """End the connection if it has waited for the rest of a request too long; else look again in a moment."""
        gone = self.transport.is_closing() or self.transport.get_protocol() is not self
        if gone:
            # Ended, or a viewer's by now: the page itself sees to those.
            return
        if self.cycle is not None and not self.cycle.response_complete:
            self._waits_since_s = self.loop.time()
        elif self.loop.time() - self._waits_since_s > REQUEST_S:
            self.transport.abort()
            return
        self.loop.call_later(LOOK_S, self._look)


@final
class LivePage:
    """The page over ``source`` at ``address``; ``serve`` runs until told to stop, in this or another thread."""

    def __init__(self, source: Source, port: int = 0, token: str | None = None) -> None:
        """Bind a loopback port, any free one by default; raise ``StoreError`` where it is taken."""
        self._source = source
        self._token = token or secrets.token_urlsafe(24)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._socket.bind((HOST, port))
            # From here on whoever comes before the server has started waits instead of being refused.
            self._socket.listen(64)
        except OSError as error:
            self._socket.close()
            remedy = "another --port, or none for any free one"
            raise StoreError(f"port {port} cannot be used ({reason(error)}). Try: {remedy}.") from None
        self._port = int(self._socket.getsockname()[1])
        self.address = f"http://{HOST}:{self._port}/{self._token}/"
        self._latest, self._version = json.dumps({"status": "waiting"}), 0
        self._ended = self._serving = self._hurried = False
        self._seen: dict[WebSocket, int] = {}
        config = uvicorn.Config(
            self._application(),
            log_level="error",
            access_log=False,
            http=ImpatientProtocol,
            ws="websockets-sansio",
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)

    def serve(self) -> None:
        """Serve until ``close`` or Ctrl-C."""
        self._serving = True
        try:
            self._server.run(sockets=[self._socket])
        finally:
            # Told to end while it was starting, the server leaves the port open.
            self._socket.close()

    def close(self, grace_s: float = 0.0) -> None:
        """End serving once viewers have had ``grace_s`` to get the last state."""
        if not self._serving:
            self._socket.close()
            return
        self._hurried = True
        _wait(lambda: self._ended and all(seen == self._version for seen in [*self._seen.values()]), grace_s)
        # Told to end while it is still starting, the server would not tidy up.
        _wait(lambda: self._server.started, START_S)
        self._server.should_exit = True

    def _application(self) -> Starlette:
        base = f"/{self._token}"
        routes = [
            Route(f"{base}/", self._page),
            Route(f"{base}/stop", self._stop, methods=["POST"]),
            Route(f"{base}/pause", self._pause, methods=["POST"]),
            Route(f"{base}/state", self._state),
            WebSocketRoute(f"{base}/ws", self._watch),
        ]
        return Starlette(routes=routes, lifespan=self._reading)

    @contextlib.asynccontextmanager
    async def _reading(self, application: Starlette) -> AsyncIterator[None]:
        self._changed = asyncio.Condition()
        reader = asyncio.create_task(self._read())
        try:
            yield
        finally:
            reader.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await reader

    async def _read(self) -> None:
        """Read the source again and again, and wake the viewers when it has changed."""
        while True:
            start_s = time.monotonic()
            text = await asyncio.to_thread(self._next)
            if text is not None:
                async with self._changed:
                    self._latest, self._version = text, self._version + 1
                    self._changed.notify_all()
            rest_s = max(LEAST_PAUSE_S, IDLE_SHARE * (time.monotonic() - start_s))
            again_s = time.monotonic() + rest_s
            # Once a stop is asked for or the page is closing, somebody waits for the last state.
            while time.monotonic() < again_s and not self._hurried:
                await asyncio.sleep(min(rest_s, 0.1))
            await asyncio.sleep(HURRIED_PAUSE_S)

    def _next(self) -> str | None:
        try:
            state = self._source.poll()
        except Exception as error:
            # One odd state must not end the page: the stop button is on it.
            state = {"status": "waiting", "why": f"{type(error).__name__}: {error}"}
        if state is None:
            return None
        self._ended = state.get("status") in ENDED
        return json.dumps(state, allow_nan=False, separators=(",", ":"))

    async def _page(self, request: Request) -> Response:
        if not self._welcome(request.headers):
            return Response(status_code=403)
        nonce = secrets.token_urlsafe(12)
        text = (resources.files("hpe_rig.live") / "live.html").read_text(encoding="utf-8")
        policy = f"default-src 'none'; style-src 'nonce-{nonce}'; script-src 'nonce-{nonce}'; connect-src 'self'"
        headers = {
            "Content-Security-Policy": f"{policy}; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }
        return HTMLResponse(text.replace("@NONCE@", nonce), headers=headers)

    async def _state(self, request: Request) -> Response:
        if not self._welcome(request.headers):
            return Response(status_code=403)
        return Response(self._latest, media_type="application/json", headers={"Cache-Control": "no-store"})

    async def _stop(self, request: Request) -> Response:
        if not self._welcome(request.headers):
            return Response(status_code=403)
        try:
            await asyncio.to_thread(self._source.stop)
        except StoreError as error:
            return JSONResponse({"error": str(error)}, status_code=409)
        self._hurried = True
        return JSONResponse({"stopping": True})

    async def _pause(self, request: Request) -> Response:
        if not self._welcome(request.headers):
            return Response(status_code=403)
        try:
            await asyncio.to_thread(self._source.pause)
        except StoreError as error:
            return JSONResponse({"error": str(error)}, status_code=409)
        return JSONResponse({"asked": True})

    async def _watch(self, viewer: WebSocket) -> None:
        """Send every state that this viewer is quick enough for, the latest first."""
        if not self._welcome(viewer.headers):
            await viewer.close(code=1008)
            return
        await viewer.accept()
        gone = asyncio.create_task(_until_gone(viewer))
        self._seen[viewer] = -1
        try:
            while not gone.done():
                async with self._changed:
                    with contextlib.suppress(TimeoutError):
                        changed = self._changed.wait_for(lambda: self._seen[viewer] != self._version)
                        await asyncio.wait_for(changed, timeout=1.0)
                    text, version = self._latest, self._version
                if version != self._seen[viewer] and not gone.done():
                    await viewer.send_text(text)
                    self._seen[viewer] = version
        except (WebSocketDisconnect, RuntimeError):
            # The viewer left between two states.
            return
        finally:
            gone.cancel()
            del self._seen[viewer]

    def _welcome(self, headers: Headers) -> bool:
        """Return whether a request names this host as a browser here would: no rebinding, no foreign page."""
        here = {f"{HOST}:{self._port}", f"localhost:{self._port}"}
        origin = headers.get("origin")
        return headers.get("host") in here and (origin is None or origin.removeprefix("http://") in here)


def _wait(ready: Callable[[], bool], longest_s: float) -> None:
    deadline_s = time.monotonic() + longest_s
    while not ready() and time.monotonic() < deadline_s:
        time.sleep(0.02)


async def _until_gone(viewer: WebSocket) -> None:
    """Return when the viewer has left; whatever it sends is dropped."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            message = await viewer.receive()
            if message["type"] == "websocket.disconnect":
                return
