"""The API's process: uvicorn on a socket that is open already (under ``dualms serve`` the parent holds it)."""

from __future__ import annotations

import gc
import socket

import uvicorn

from worker.logs import log_to_stderr

GRACE_S = 3  # open streams and long polls get so long to end
KEEP_ALIVE_S = 75  # longer than proxies and clients keep a connection: who closes first may cut a request off


def load() -> None:
    """Load what the API is made of; a process that is forked later starts with it."""
    gc.disable()  # what is imported stays: looking through it again and again costs a fifth of the start
    import service.app  # noqa: F401

    gc.freeze()
    gc.enable()


def run(listener: socket.socket) -> None:
    """Serve until SIGTERM or SIGINT."""
    load()
    log_to_stderr()
    config = uvicorn.Config(
        "service.app:create_app",
        factory=True,
        access_log=False,
        log_config=None,
        timeout_graceful_shutdown=GRACE_S,
        timeout_keep_alive=KEEP_ALIVE_S,
        lifespan="on",
    )
    uvicorn.Server(config).run(sockets=[listener])
