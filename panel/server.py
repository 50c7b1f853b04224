"""Serves the panel until Ctrl-C."""

from __future__ import annotations

import socket as sockets

import uvicorn
from sawbench.bench.errors import InputError
from starlette.applications import Starlette


def bound(host: str, port: int) -> sockets.socket:
    """Return a socket that listens at an address.

    Parameters
    ----------
    host : str
    port : int
        0: any that is free.

    Raises
    ------
    InputError
        If the address cannot be used.
    """
    family = sockets.AF_INET6 if ":" in host else sockets.AF_INET
    found = sockets.socket(family, sockets.SOCK_STREAM)
    try:
        found.setsockopt(sockets.SOL_SOCKET, sockets.SO_REUSEADDR, 1)
        found.bind((host, port))
    except OSError as error:
        found.close()
        raise InputError(
            f"cannot serve there: {error.strerror or error}",
            where=f"{host} port {port}",
            remedy="give another --port, or stop the panel that is already running",
        ) from error
    return found


def serve(app: Starlette, socket: sockets.socket) -> None:
    """Serve until Ctrl-C; pages that are open do not hold the end up.

    Parameters
    ----------
    app : Starlette
    socket : socket
        See `bound`.
    """
    config = uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=1, lifespan="off")
    try:
        uvicorn.Server(config).run(sockets=[socket])
    except KeyboardInterrupt:
        return
