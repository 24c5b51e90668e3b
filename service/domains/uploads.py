"""Taking in a domain: to disk, through the jailed reader, into the store; refused files leave nothing behind."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from starlette.datastructures import UploadFile

from dualms.errors import UnreadableFile, UnsupportedFormat
from dualms.inspection import Inspection
from dualms.spec import Unit
from service.access import Caller, domain_not_found, note, within_quota
from service.backend import Backend
from service.problems import FieldProblem, Problem
from worker.artifacts import MissingBlob, fetch, put_file, read_chunks
from worker.domains import Domains
from worker.inspection import inspect_upload
from worker.views import DomainRecord

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".glb", ".3mf", ".step", ".stp")
MAX_NAME = 200


@dataclass(frozen=True)
class Upload:
    """Bytes that a client sent, or named by their hash, and what it calls them.

    ``copy`` brings them to a path, and gives their SHA-256 and size.
    """

    name: str
    suffix: str
    copy: Callable[[Path], tuple[str, int]]


def receive(
    backend: Backend, caller: Caller, file: UploadFile | None, sha256: str | None, units: Unit | None
) -> DomainRecord:
    """The domain of a form: by its file, or by the hash of bytes that are here already.

    Raises
    ------
    Problem
        ``invalid-request`` unless there is just one of them; else as below.
    """
    if (file is None) == (sha256 is None):
        field = FieldProblem(field="file", message="The form needs a file, or the sha256 of one sent before")
        raise Problem("invalid-request", f"{field.message}.", "Send one of the two.", errors=[field])
    if file is not None:
        return receive_domain(backend, caller, sent(file.file, file.filename or ""), units)
    return receive_again(backend, caller, str(sha256), units)


def forget(backend: Backend, domain_id: str) -> None:
    """Forget a domain that nothing uses.

    Raises
    ------
    Problem
        ``domain-not-found`` or ``domain-in-use``.
    """
    match Domains(backend.records).delete(domain_id):
        case "unknown":
            raise domain_not_found(domain_id)
        case "in use":
            advice = "Delete the designs and studies that use it first."
            raise Problem("domain-in-use", f"Designs or studies use the domain {domain_id}.", advice)


def sent(file: BinaryIO, filename: str) -> Upload:
    """A file in the request.

    Raises
    ------
    UnsupportedFormat
        By the extension of its name.
    """
    name, suffix = _named(filename)
    return Upload(name, suffix, lambda path: _copy(file, path))


def receive_again(backend: Backend, caller: Caller, sha256: str, units: Unit | None) -> DomainRecord:
    """The domain of bytes that the caller has sent before; in other units it is read again.

    Raises
    ------
    Problem
        ``domain-not-found``: another's bytes are not the caller's.
    """
    rows = Domains(backend.records).of_bytes(sha256, caller.owner)
    if not rows:
        raise _not_here(sha256)
    first = rows[0]

    def copy(path: Path) -> tuple[str, int]:
        try:
            fetch(backend.store, sha256, path)
        except MissingBlob:
            raise _not_here(sha256) from None
        return sha256, first.size

    return receive_domain(backend, caller, Upload(first.name, first.suffix, copy), units)


def receive_domain(backend: Backend, caller: Caller, upload: Upload, units: Unit | None) -> DomainRecord:
    """Record an uploaded file, or give the record that it has already.

    Raises
    ------
    DualMSError
        If the file cannot be an envelope.
    Problem
        If the caller's quotas have no room for it.
    """
    owner, suffix = caller.owner, upload.suffix
    scratch = backend.worker_settings.scratch
    scratch.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=scratch, prefix="upload-") as folder:
        path = Path(folder) / f"upload{suffix}"
        sha256, size = upload.copy(path)
        if size == 0:
            raise UnreadableFile("The file is empty.", advice="Export the domain again and check the upload.")
        if units is not None and (known := _recorded(backend, sha256, suffix, units, owner)) is not None:
            return known
        within_quota(backend, caller, stored=size, uploads=1)
        inspection = inspect_upload(path, upload.name, units, backend.worker_settings)
        put_file(backend.store, path)
    return _record(backend, caller, upload, (sha256, size), inspection)


def _record(
    backend: Backend, caller: Caller, upload: Upload, content: tuple[str, int], inspection: Inspection
) -> DomainRecord:
    (sha256, size), units, owner = content, inspection.units, caller.owner
    with backend.turns.of(owner):
        if (known := _recorded(backend, sha256, upload.suffix, units, owner)) is not None:
            return known
        within_quota(backend, caller, stored=size, uploads=1)
        rows = (
            backend.records.add_domain(
                id=domain_id,
                sha256=sha256,
                size=size,
                name=upload.name,
                suffix=upload.suffix,
                units=units.value,
                inspection=inspection.model_dump(mode="json"),
                owner=owner,
            )
            for domain_id in _ids(sha256, upload.suffix, units, owner)
        )
        made = next(row for row in rows if _same(row, upload.suffix, units, owner))
    note(backend, caller, "domain.upload", made.id, bytes=size)
    return made


def _not_here(sha256: str) -> Problem:
    advice = "Send the file itself."
    return Problem("domain-not-found", f"No domain of yours has bytes with the SHA-256 {sha256}.", advice)


def _ids(sha256: str, suffix: str, units: Unit, owner: str | None) -> tuple[str, ...]:
    """Ids to try. Without an owner the hash of the bytes, and, where that names them read otherwise, one that tells.

    An owner's ids come from the owner too: the id of a file then says nothing about who else has sent it, and one that
    was deleted can never come back as another's.
    """
    apart = hashlib.sha256(f"{sha256}:{suffix}:{units.value}:{owner or ''}".encode()).hexdigest()
    return (sha256, apart) if owner is None else (apart,)


def _recorded(backend: Backend, sha256: str, suffix: str, units: Unit, owner: str | None) -> DomainRecord | None:
    rows = Domains(backend.records).of_bytes(sha256, owner)
    return next((row for row in rows if _same(row, suffix, units, owner)), None)


def _same(row: DomainRecord, suffix: str, units: Unit, owner: str | None) -> bool:
    return (row.suffix, row.units, row.owner) == (suffix, units.value, owner)


def _named(filename: str) -> tuple[str, str]:
    """The name without folders and control characters, and its suffix in lower case."""
    last = filename.replace("\\", "/").rsplit("/", 1)[-1]
    name = "".join(c for c in last if c.isprintable()).strip()[-MAX_NAME:]
    suffix = Path(name).suffix.lower()
    if suffix not in SUFFIXES:
        raise UnsupportedFormat(
            f"Files of type '{suffix or name or 'without a name'}' are not read.",
            advice=f"Export one of {', '.join(SUFFIXES)} and keep the extension in the file's name.",
        )
    return name, suffix


def _copy(file: BinaryIO, path: Path) -> tuple[str, int]:
    digest, size = hashlib.sha256(), 0
    with path.open("wb") as out:
        for chunk in read_chunks(file):
            digest.update(chunk)
            size += out.write(chunk)
    return digest.hexdigest(), size
