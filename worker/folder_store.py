"""Artifacts in a local folder: ``ab/cd/abcd…``, each file written aside, flushed to the disk, and renamed."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from worker.artifacts import CHUNK, Blob, MissingBlob, StoredBlob, StoreFull, checked_hash, drain


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
                digest, size = drain(chunks, file.write, limit)
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
        return self.folder / checked_hash(sha256)[:2] / sha256[2:4] / sha256


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
