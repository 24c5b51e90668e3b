"""The demonstration: start the service, send it an envelope over HTTP, wait, and save what comes back."""

from __future__ import annotations

import argparse
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx

HERE = Path(__file__).parent
DUALMS = Path(sys.executable).with_name("dualms")


def main() -> int:
    """Run one example through a service of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--domain", type=Path, default=HERE / "u_bend.stl")
    parser.add_argument("--spec", type=Path, default=HERE / "u_bend.json")
    parser.add_argument("--out", type=Path, default=Path("demo-output"))
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="dualms-demo-") as data:
        port = _free_port()
        url = f"http://127.0.0.1:{port}"
        service = subprocess.Popen(
            [DUALMS, "serve", "--port", str(port), "--data", data], stdout=subprocess.DEVNULL, start_new_session=True
        )
        try:
            _wait_until_ready(url, service)
            print(f"The service runs at {url}; sending {asked.domain.name} with {asked.spec.name}.")
            code = subprocess.run(
                [DUALMS, "submit", asked.domain, asked.spec, "--url", url, "--wait", "--out", asked.out], check=False
            ).returncode
        finally:
            service.send_signal(signal.SIGINT)
            service.wait(timeout=60)
    if code == 0:
        out = asked.out
        print(f"\nLook at {out}/preview.png and {out}/report.html; the solid to print is {out}/solid.3mf.")
    return code


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _wait_until_ready(url: str, service: subprocess.Popen[bytes]) -> None:
    for _ in range(300):
        if service.poll() is not None:
            raise SystemExit(f"The service ended at once with exit code {service.returncode}.")
        try:
            if httpx.get(f"{url}/readyz", timeout=2).status_code == 200:
                return
        except httpx.TransportError:
            pass
        time.sleep(0.2)
    raise SystemExit("The service was not ready within a minute.")


if __name__ == "__main__":
    raise SystemExit(main())
