"""A small Python client: upload a domain, submit a design, wait for it, download what came out."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx

TERMINAL = frozenset({"succeeded", "failed", "cancelled"})
RETRY_STATUS = frozenset({429, 502, 503, 504})
LONG_POLL_S = 20

Json = dict[str, Any]


class ServiceError(Exception):
    """The service refused a request; the message is its problem document's.

    Parameters
    ----------
    status
        HTTP status.
    problem
        The problem document, as far as the answer was one.
    """

    def __init__(self, status: int, problem: Json) -> None:
        self.status, self.problem = status, problem
        self.code = str(problem.get("code", "unknown"))
        self.advice = str(problem.get("advice", ""))
        detail = str(problem.get("detail", f"HTTP status {status}"))
        super().__init__(f"{detail} {self.advice}".strip())


class Unreachable(Exception):
    """No answer came, after several tries."""


class Client:
    """Talks to one service.

    Parameters
    ----------
    url
        Where it listens, such as ``http://127.0.0.1:8000``.
    key
        API key, where the service asks for one.
    patience_s
        How long to try again while the service cannot be reached.

    Examples
    --------
    >>> with Client("http://127.0.0.1:8000") as client:           # doctest: +SKIP
    ...     domain = client.upload_domain(Path("u_bend.stl"), "mm")
    ...     design = client.wait(client.submit(domain["id"], spec)["id"])
    ...     client.download(design, Path("out"))
    """

    def __init__(self, url: str, key: str | None = None, *, patience_s: float = 60.0) -> None:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        timeout = httpx.Timeout(LONG_POLL_S + 40, connect=5)
        self._http = httpx.Client(base_url=url, timeout=timeout, headers=headers)
        self._patience_s = patience_s

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def upload_domain(self, path: Path, units: str | None = None) -> Json:
        """Send a domain file, unless the service has its bytes from before; gives its record."""
        data = {"units": units} if units else {}
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            try:
                return self._json("POST", "/v1/domains", data={**data, "sha256": sha256})
            except ServiceError as error:
                if error.code != "domain-not-found":
                    raise
            file.seek(0)
            return self._json("POST", "/v1/domains", files={"file": (path.name, file)}, data=data)

    def submit(self, domain: str, spec: Mapping[str, object], *, name: str | None = None,
               idempotency_key: str | None = None, **options: object) -> Json:  # fmt: skip
        """Ask for a design; gives its record. Sending it twice by a bad line is harmless.

        Parameters
        ----------
        domain
            Id of an uploaded domain.
        spec
            The specification.
        name
            For people.
        idempotency_key
            Names this request; the default is made from its contents, so that the same call within a minute of trying
            gives one design.
        options
            ``labels``, ``webhook``, ``deadline_s``, ``priority``.
        """
        body = {"domain": domain, "spec": dict(spec), **({"name": name} if name else {}), **options}
        key = idempotency_key or f"client-{hashlib.sha256(f'{body}{time.time_ns()}'.encode()).hexdigest()[:32]}"
        return self._json("POST", "/v1/designs", json=body, headers={"Idempotency-Key": key})

    def design(self, design_id: str, wait_s: int = 0, etag: str | None = None) -> tuple[Json | None, str]:
        """One look at a design: its record (None where it has not changed since ``etag``) and its ETag."""
        return self._look(f"/v1/designs/{design_id}", wait_s, etag)

    def wait(
        self, design_id: str, on_change: Callable[[Json], None] | None = None, timeout_s: float = float("inf")
    ) -> Json:
        """Follow a design by long polls until it ends.

        Raises
        ------
        TimeoutError
            If it has not ended in time.
        """
        return self._follow(f"/v1/designs/{design_id}", on_change, timeout_s)

    def submit_study(self, domain: str, plan: Mapping[str, object], *, idempotency_key: str | None = None) -> Json:
        """Ask for a study; gives its record.

        Parameters
        ----------
        domain
            Id of an uploaded domain.
        plan
            ``spec``, ``grid``, and perhaps ``metrics``, ``name``, ``labels``.
        idempotency_key
            As for ``submit``.
        """
        body = {**plan, "domain": domain}
        key = idempotency_key or f"client-{hashlib.sha256(f'{body}{time.time_ns()}'.encode()).hexdigest()[:32]}"
        return self._json("POST", "/v1/studies", json=body, headers={"Idempotency-Key": key})

    def study(self, study_id: str, wait_s: int = 0, etag: str | None = None) -> tuple[Json | None, str]:
        """One look at a study, as ``design`` does."""
        return self._look(f"/v1/studies/{study_id}", wait_s, etag)

    def wait_study(
        self, study_id: str, on_change: Callable[[Json], None] | None = None, timeout_s: float = float("inf")
    ) -> Json:
        """Follow a study until all of its points have ended, as ``wait`` does."""
        return self._follow(f"/v1/studies/{study_id}", on_change, timeout_s)

    def cancel_study(self, study_id: str) -> Json:
        """Ask all designs of a study to stop."""
        return self._json("POST", f"/v1/studies/{study_id}/cancel")

    def download_study(self, record: Mapping[str, Any], folder: Path) -> list[Path]:
        """Save the tables and the picture of a study."""
        folder.mkdir(parents=True, exist_ok=True)
        saved = []
        for file in record["files"]:
            target = folder / Path(str(file["name"])).name
            target.write_bytes(self._send("GET", str(file["href"])).content)
            saved.append(target)
        return saved

    def cancel(self, design_id: str) -> Json:
        """Ask a design to stop."""
        return self._json("POST", f"/v1/designs/{design_id}/cancel")

    def download(self, record: Mapping[str, Any], folder: Path) -> list[Path]:
        """Save all artifacts of a design, each checked against its SHA-256."""
        folder.mkdir(parents=True, exist_ok=True)
        return [self._save(artifact, folder) for artifact in record["artifacts"]]

    def artifact_json(self, record: Mapping[str, Any], name: str) -> Json:
        """A JSON artifact, such as ``report.json``."""
        href = next(a["href"] for a in record["artifacts"] if a["name"] == name)
        return self._json("GET", str(href), follow_redirects=True)

    def _look(self, path: str, wait_s: int, etag: str | None) -> tuple[Json | None, str]:
        headers = {"Prefer": f"wait={wait_s}"} if wait_s else {}
        if etag:
            headers["If-None-Match"] = etag
        answer = self._send("GET", path, headers=headers)
        return (None if answer.status_code == 304 else answer.json()), answer.headers.get("ETag", etag or "")

    def _follow(self, path: str, on_change: Callable[[Json], None] | None, timeout_s: float) -> Json:
        deadline = time.monotonic() + timeout_s
        etag: str | None = None
        while True:
            left = deadline - time.monotonic()
            if left <= 0:
                raise TimeoutError(f"{path} has not ended within {timeout_s:.0f} s")
            record, etag = self._look(path, max(1, int(min(LONG_POLL_S, left))), etag)
            if record is None:
                continue
            if on_change is not None:
                on_change(record)
            if record["status"] in TERMINAL:
                return record

    def _save(self, artifact: Mapping[str, Any], folder: Path) -> Path:
        target = folder / Path(str(artifact["name"])).name
        partial = target.with_name(target.name + ".partial")
        digest = hashlib.sha256()
        with partial.open("wb") as out:
            for chunk in self._stream(str(artifact["href"])):
                digest.update(chunk)
                out.write(chunk)
        if digest.hexdigest() != artifact["sha256"]:
            partial.unlink()
            raise ServiceError(502, {"detail": f"{target.name} arrived damaged", "advice": "Download it again."})
        return partial.replace(target)

    def _stream(self, href: str) -> Iterator[bytes]:
        with self._http.stream("GET", href, follow_redirects=True) as answer:
            if answer.status_code != 200:
                answer.read()
                raise ServiceError(answer.status_code, _problem(answer))
            yield from answer.iter_bytes()

    def _json(self, method: str, path: str, **options: Any) -> Json:
        answer: Json = self._send(method, path, **options).json()
        return answer

    def _send(self, method: str, path: str, **options: Any) -> httpx.Response:
        """One request, tried again while the service cannot be reached or asks for patience."""
        deadline = time.monotonic() + self._patience_s
        pause = 0.2
        while True:
            try:
                answer = self._http.request(method, path, **options)
            except httpx.TransportError as error:
                if time.monotonic() + pause > deadline:
                    raise Unreachable(f"No answer from {self._http.base_url}: {error}") from error
            else:
                if answer.status_code not in RETRY_STATUS or time.monotonic() + pause > deadline:
                    if answer.status_code >= 400:
                        raise ServiceError(answer.status_code, _problem(answer))
                    return answer
                pause = float(answer.headers.get("Retry-After", pause))
            time.sleep(pause)
            pause = min(2 * pause, 5.0)
            for _, file in (options.get("files") or {}).values():
                file.seek(0)


def _problem(answer: httpx.Response) -> Json:
    try:
        document = answer.json()
    except ValueError:
        return {}
    return document if isinstance(document, dict) else {}
