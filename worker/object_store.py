"""Artifacts in any object store that obstore reaches by URL."""

from __future__ import annotations

import contextlib
import errno
import tempfile
from collections.abc import Iterable, Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any

import obstore
from obstore.exceptions import BaseError
from obstore.store import MemoryStore, S3Store, from_url

from worker.artifacts import CHUNK, HASH, Blob, MissingBlob, StoreAway, StoredBlob, StoreFull, checked_hash, drain


class ObjectStore:
    """Any object store that obstore reaches by URL, such as ``s3://bucket/prefix`` or ``memory://``.

    Parameters
    ----------
    url
        Credentials and region come from the environment (``AWS_…``), or from the machine's role.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._store: Any = MemoryStore() if url.startswith("memory:") else from_url(url)

    def put(self, chunks: Iterable[bytes], limit: int | None = None) -> Blob:
        """Store a stream: spooled to a local temporary file first, since its name is its hash."""
        import obstore

        with tempfile.TemporaryFile() as spool:
            try:
                digest, size = drain(chunks, spool.write, limit)
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
        try:
            with _translated():
                return int(obstore.head(self._store, self._key(sha256))["size"])
        except FileNotFoundError:
            return None

    def delete(self, sha256: str) -> None:
        """Remove the bytes."""
        with contextlib.suppress(FileNotFoundError), _translated():
            obstore.delete(self._store, self._key(sha256))

    def list(self) -> Iterator[StoredBlob]:
        """Everything that is stored."""
        for page in obstore.list(self._store):
            for item in page:
                name = str(item["path"]).rsplit("/", 1)[-1]
                if HASH.fullmatch(name):
                    yield StoredBlob(name, int(item["size"]), item["last_modified"].timestamp())

    def presigned_url(self, sha256: str, seconds: float, *, filename: str, media_type: str) -> str | None:
        """A signed GET address, where the store is one that signs (S3 and its like)."""

        if not isinstance(self._store, S3Store):
            return None
        return str(obstore.sign(self._store, "GET", self._key(sha256), timedelta(seconds=seconds)))

    def path(self, sha256: str) -> Path | None:
        """None: the bytes are elsewhere."""
        return None

    def _key(self, sha256: str) -> str:
        return f"{checked_hash(sha256)[:2]}/{sha256[2:4]}/{sha256}"


@contextlib.contextmanager
def _translated() -> Iterator[None]:
    try:
        yield
    except BaseError as error:
        raise StoreAway(f"the object store does not serve: {error}") from error


def _stream(result: Any) -> Iterator[bytes]:
    with _translated():
        for chunk in result.stream(min_chunk_size=CHUNK):
            yield bytes(chunk)
