"""The artifact store: bytes under their SHA-256, in a folder or any object store.

A hash names the same bytes for ever, so writing twice is harmless, and nothing is ever overwritten with something else.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Protocol

CHUNK = 1 << 20
HASH = re.compile(r"[0-9a-f]{64}")


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


def checked_hash(sha256: str) -> str:
    """The hash itself, if it is one.

    Raises
    ------
    MissingBlob
        If it is not: nothing can be stored under it.
    """
    if not HASH.fullmatch(sha256):
        raise MissingBlob(sha256)
    return sha256


def drain(chunks: Iterable[bytes], write: Any, limit: int | None) -> tuple[str, int]:
    """Write a stream; gives its hash and size. Raises :class:`TooManyBytes` beyond the limit."""
    digest, size = hashlib.sha256(), 0
    for chunk in chunks:
        size += len(chunk)
        if limit is not None and size > limit:
            raise TooManyBytes(f"more than {limit} bytes")
        digest.update(chunk)
        write(chunk)
    return digest.hexdigest(), size
