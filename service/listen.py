"""The API's process: uvicorn on a socket that is open already (under ``dualms serve`` the parent holds it)."""

from __future__ import annotations

import gc
import socket
import sys

import uvicorn

from worker.logs import log_to_stderr

GRACE_S = 3  # open streams and long polls get so long to end
KEEP_ALIVE_S = 75  # longer than proxies and clients keep a connection: who closes first may cut a request off


def run(listener: socket.socket) -> None:
    """Serve until SIGTERM or SIGINT."""
    log_to_stderr()
    config = uvicorn.Config(
        "service.app:app",
        access_log=False,
        log_config=None,
        timeout_graceful_shutdown=GRACE_S,
        timeout_keep_alive=KEEP_ALIVE_S,
        lifespan="on",
    )
    gc.disable()  # what is imported stays: looking through it again and again costs a fifth of the start
    config.load()
    gc.freeze()
    gc.enable()
    uvicorn.Server(config).run(sockets=[listener])


if __name__ == "__main__":
    run(socket.socket(fileno=int(sys.argv[1])))
