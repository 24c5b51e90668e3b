"""Taking in a domain file: to disk, through the jailed reader, into the store; refused files leave nothing behind."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path
from typing import BinaryIO

from dualms.errors import UnreadableFile, UnsupportedFormat
from dualms.spec import Unit
from service.access import Caller, note, within_quota
from service.backend import Backend
from worker.artifacts import put_file, read_chunks
from worker.inspection import inspect_upload
from worker.views import DomainRecord

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".glb", ".3mf", ".step", ".stp")
MAX_NAME = 200


def receive_domain(backend: Backend, caller: Caller, file: BinaryIO, filename: str, units: Unit | None) -> DomainRecord:
    """Record an uploaded file, or give the record that it has already.

    Raises
    ------
    DualMSError
        If the file cannot be an envelope.
    Problem
        If the caller's quotas have no room for it.
    """
    owner = caller.owner
    name, suffix = _named(filename)
    scratch = backend.worker_settings.scratch
    scratch.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=scratch, prefix="upload-") as folder:
        path = Path(folder) / f"upload{suffix}"
        sha256, size = _copy(file, path)
        if size == 0:
            raise UnreadableFile("The file is empty.", advice="Export the domain again and check the upload.")
        if units is not None and (known := _known(backend, sha256, suffix, units, owner)) is not None:
            return known
        within_quota(backend, caller, stored=size, uploads=1)
        inspection = inspect_upload(path, name, units, backend.worker_settings)
        put_file(backend.store, path)
    for domain_id in _ids(sha256, suffix, inspection.units, owner):
        row = backend.records.add_domain(
            id=domain_id,
            sha256=sha256,
            size=size,
            name=name,
            suffix=suffix,
            units=inspection.units.value,
            inspection=inspection.model_dump(mode="json"),
            owner=owner,
        )
        if _same(row, suffix, inspection.units, owner):
            break
    note(backend, caller, "domain.upload", row.id, bytes=size)
    return row


def _ids(sha256: str, suffix: str, units: Unit, owner: str | None) -> tuple[str, str]:
    """The hash of the bytes; and, where that names the same bytes read otherwise, one that tells them apart."""
    return sha256, hashlib.sha256(f"{sha256}:{suffix}:{units.value}:{owner or ''}".encode()).hexdigest()


def _known(backend: Backend, sha256: str, suffix: str, units: Unit, owner: str | None) -> DomainRecord | None:
    rows = (backend.records.domain(i) for i in _ids(sha256, suffix, units, owner))
    return next((row for row in rows if row is not None and _same(row, suffix, units, owner)), None)


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
