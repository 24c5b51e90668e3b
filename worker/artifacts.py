"""The artifact store: bytes under their SHA-256, in a folder or any object store.

A hash names the same bytes for ever, so writing twice is harmless, and nothing is ever overwritten with something else.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import secrets
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol
from urllib.parse import unquote, urlparse

if TYPE_CHECKING:
    from worker.settings import Settings

CHUNK = 1 << 20
_HASH = re.compile(r"[0-9a-f]{64}")


class StoreFull(OSError):
    """The store has no room for the bytes; nothing of them was kept."""


class StoreAway(OSError):
    """The object store does not answer, or refuses; it may answer later."""


class TooManyBytes(Exception):
    """More bytes came than the caller allows; nothing of them was kept."""


class MissingBlob(KeyError):
    """The store has no bytes under this hash."""


@dataclass(frozen=True)
class Blob:
    """Stored bytes."""

    sha256: str
    size: int


@dataclass(frozen=True)
class StoredBlob:
    """Stored bytes, with the time they were last written (seconds since 1970)."""

    sha256: str
    size: int
    written_at: float


class ArtifactStore(Protocol):
    """Where artifacts live."""

    def put(self, chunks: Iterable[bytes], limit: int | None = None) -> Blob:
        """Store a stream in constant memory.

        Raises
        ------
        TooManyBytes
            If more than ``limit`` bytes come.
        StoreFull
            If there is no room.
        """

    def get(self, sha256: str, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """Stream bytes ``start`` to ``end`` (exclusive; None: to the last).

        Raises
        ------
        MissingBlob
            Before the first chunk, if there is no such blob.
        """

    def size(self, sha256: str) -> int | None:
        """Number of bytes, or None where there is no such blob."""

    def delete(self, sha256: str) -> None:
        """Remove the bytes; harmless where there are none."""

    def list(self) -> Iterator[StoredBlob]:
        """Everything that is stored, in no order."""

    def presigned_url(self, sha256: str, seconds: float, *, filename: str, media_type: str) -> str | None:
        """An address from which a client may fetch the bytes itself; None where the store has no such thing."""

    def path(self, sha256: str) -> Path | None:
        """The file with the bytes, where the store is a local folder and has them."""


def open_store(settings: Settings) -> ArtifactStore:
    """The store that the settings name."""
    url = settings.store
    if url.startswith("file:"):
        return FolderStore(Path(unquote(urlparse(url).path)))
    if "://" not in url:
        return FolderStore(Path(url).expanduser().resolve())
    return ObjectStore(url)


def put_file(store: ArtifactStore, path: Path) -> Blob:
    """Store a file's bytes."""
    with path.open("rb") as file:
        return store.put(read_chunks(file))


def read_chunks(file: BinaryIO) -> Iterator[bytes]:
    """A file's bytes in chunks of 1 MiB."""
    while chunk := file.read(CHUNK):
        yield chunk


def fetch(store: ArtifactStore, sha256: str, path: Path) -> None:
    """Write a blob to a file, and check that its hash is right.

    Raises
    ------
    MissingBlob
        If there is no such blob, or its bytes are not those that the hash names.
    """
    digest = hashlib.sha256()
    with path.open("wb") as file:
        for chunk in store.get(sha256):
            digest.update(chunk)
            file.write(chunk)
    if digest.hexdigest() != sha256:
        path.unlink()
        raise MissingBlob(sha256)


class FolderStore:
    """A local folder: ``ab/cd/abcd…``, each file written aside, flushed to the disk, and renamed.

    Parameters
    ----------
    folder
        Is made where it does not exist.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._partial = folder / "partial"
        self._partial.mkdir(parents=True, exist_ok=True)

    def put(self, chunks: Iterable[bytes], limit: int | None = None) -> Blob:
        """Store a stream; see :class:`ArtifactStore`."""
        partial = self._partial / f"{os.getpid()}-{secrets.token_hex(8)}"
        try:
            with partial.open("xb") as file:
                digest, size = _drain(chunks, file.write, limit)
                file.flush()
                os.fsync(file.fileno())
            target = self._target(digest)
            for folder in (target.parent.parent, target.parent):
                if not folder.exists():
                    folder.mkdir(exist_ok=True)
                    _sync_folder(folder.parent)
            partial.replace(target)
            _sync_folder(target.parent)
        except OSError as error:
            partial.unlink(missing_ok=True)
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise StoreFull(error.errno, f"no room left in the artifact store {self.folder}") from error
            raise
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
        return Blob(digest, size)

    def get(self, sha256: str, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """Stream a blob; see :class:`ArtifactStore`."""
        try:
            file = self._target(sha256).open("rb")
        except FileNotFoundError:
            raise MissingBlob(sha256) from None
        return _read(file, start, end)

    def size(self, sha256: str) -> int | None:
        """Number of bytes, or None."""
        try:
            return self._target(sha256).stat().st_size
        except FileNotFoundError:
            return None

    def delete(self, sha256: str) -> None:
        """Remove the bytes."""
        self._target(sha256).unlink(missing_ok=True)

    def list(self) -> Iterator[StoredBlob]:
        """Everything that is stored; leaves of broken writes older than a day are removed on the way."""
        for left in self._partial.iterdir():
            with contextlib.suppress(FileNotFoundError):
                if time.time() - left.stat().st_mtime > 86400:
                    left.unlink()
        for path in self.folder.glob("??/??/*"):
            with contextlib.suppress(FileNotFoundError):
                stat = path.stat()
                yield StoredBlob(path.name, stat.st_size, stat.st_mtime)

    def presigned_url(self, sha256: str, seconds: float, *, filename: str, media_type: str) -> str | None:
        """None: a folder has no addresses."""
        return None

    def path(self, sha256: str) -> Path | None:
        """The file with the bytes."""
        target = self._target(sha256)
        return target if target.exists() else None

    def _target(self, sha256: str) -> Path:
        return self.folder / _checked(sha256)[:2] / sha256[2:4] / sha256


class ObjectStore:
    """Any object store that obstore reaches by URL, such as ``s3://bucket/prefix`` or ``memory://``.

    Parameters
    ----------
    url
        Credentials and region come from the environment (``AWS_…``), or from the machine's role.
    """

    def __init__(self, url: str) -> None:
        from obstore.store import MemoryStore, from_url

        self._url = url
        self._store: Any = MemoryStore() if url.startswith("memory:") else from_url(url)

    def put(self, chunks: Iterable[bytes], limit: int | None = None) -> Blob:
        """Store a stream: spooled to a local temporary file first, since its name is its hash."""
        import tempfile

        import obstore

        with tempfile.TemporaryFile() as spool:
            try:
                digest, size = _drain(chunks, spool.write, limit)
            except OSError as error:
                if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                    raise StoreFull(error.errno, "no room left for temporary files") from error
                raise
            spool.seek(0)
            with _translated():
                obstore.put(self._store, self._key(digest), spool)
        return Blob(digest, size)

    def get(self, sha256: str, start: int = 0, end: int | None = None) -> Iterator[bytes]:
        """Stream a blob; see :class:`ArtifactStore`."""
        import obstore

        size = self.size(sha256)
        if size is None:
            raise MissingBlob(sha256)
        end = size if end is None else min(end, size)
        if start >= end:
            return iter(())
        with _translated():
            result = obstore.get(self._store, self._key(sha256), options={"range": (start, end)})
        return _stream(result)

    def size(self, sha256: str) -> int | None:
        """Number of bytes, or None."""
        import obstore

        try:
            with _translated():
                return int(obstore.head(self._store, self._key(sha256))["size"])
        except FileNotFoundError:
            return None

    def delete(self, sha256: str) -> None:
        """Remove the bytes."""
        import obstore

        with contextlib.suppress(FileNotFoundError), _translated():
            obstore.delete(self._store, self._key(sha256))

    def list(self) -> Iterator[StoredBlob]:
        """Everything that is stored."""
        import obstore

        for page in obstore.list(self._store):
            for item in page:
                name = str(item["path"]).rsplit("/", 1)[-1]
                if _HASH.fullmatch(name):
                    yield StoredBlob(name, int(item["size"]), item["last_modified"].timestamp())

    def presigned_url(self, sha256: str, seconds: float, *, filename: str, media_type: str) -> str | None:
        """A signed GET address, where the store is one that signs (S3 and its like)."""
        import obstore
        from obstore.store import S3Store

        if not isinstance(self._store, S3Store):
            return None
        return str(obstore.sign(self._store, "GET", self._key(sha256), timedelta(seconds=seconds)))

    def path(self, sha256: str) -> Path | None:
        """None: the bytes are elsewhere."""
        return None

    def _key(self, sha256: str) -> str:
        return f"{_checked(sha256)[:2]}/{sha256[2:4]}/{sha256}"


@contextlib.contextmanager
def _translated() -> Iterator[None]:
    from obstore.exceptions import BaseError

    try:
        yield
    except BaseError as error:
        raise StoreAway(f"the object store does not serve: {error}") from error


def _stream(result: Any) -> Iterator[bytes]:
    with _translated():
        for chunk in result.stream(min_chunk_size=CHUNK):
            yield bytes(chunk)


def _checked(sha256: str) -> str:
    if not _HASH.fullmatch(sha256):
        raise MissingBlob(sha256)
    return sha256


def _drain(chunks: Iterable[bytes], write: Any, limit: int | None) -> tuple[str, int]:
    digest, size = hashlib.sha256(), 0
    for chunk in chunks:
        size += len(chunk)
        if limit is not None and size > limit:
            raise TooManyBytes(f"more than {limit} bytes")
        digest.update(chunk)
        write(chunk)
    return digest.hexdigest(), size


def _read(file: BinaryIO, start: int, end: int | None) -> Iterator[bytes]:
    with file:
        file.seek(start)
        left = None if end is None else max(end - start, 0)
        while left is None or left > 0:
            chunk = file.read(CHUNK if left is None else min(CHUNK, left))
            if not chunk:
                return
            if left is not None:
                left -= len(chunk)
            yield chunk


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
