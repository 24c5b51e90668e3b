"""The artifact store: bytes come back, nothing is half written."""

from __future__ import annotations

import errno
import hashlib
import os
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.s3 import S3
from worker.artifacts import ArtifactStore, MissingBlob, StoreAway, StoreFull, TooManyBytes, fetch
from worker.folder_store import FolderStore
from worker.garbage import collect
from worker.lease import FileRecord, StepRecord
from worker.leases import Leases
from worker.object_store import ObjectStore
from worker.records import Records
from worker.settings import Settings
from worker.stores import open_store
from worker.views import DesignRecord


@pytest.fixture(params=["folder", "memory", "obstore-folder", "s3"])
def store(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ArtifactStore:
    if request.param == "folder":
        return FolderStore(tmp_path / "store")
    if request.param == "memory":
        return ObjectStore("memory://")
    if request.param == "s3":
        return s3_store(request.getfixturevalue("s3"), tmp_path.name, monkeypatch)
    (tmp_path / "objects").mkdir()
    return ObjectStore((tmp_path / "objects").as_uri())


def s3_store(server: S3, prefix: str, monkeypatch: pytest.MonkeyPatch) -> ObjectStore:
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    return ObjectStore(f"{server.url}/{prefix}")


def test_bytes_come_back_whole_and_in_ranges(store: ArtifactStore, tmp_path: Path) -> None:
    data = os.urandom(3_000_001)
    blob = store.put([data[:1_000_000], data[1_000_000:]])
    assert blob.sha256 == hashlib.sha256(data).hexdigest()
    assert (blob.size, store.size(blob.sha256)) == (len(data), len(data))
    assert b"".join(store.get(blob.sha256)) == data
    assert b"".join(store.get(blob.sha256, 5, 2_000_000)) == data[5:2_000_000]
    assert b"".join(store.get(blob.sha256, 2_999_999)) == data[2_999_999:]
    fetch(store, blob.sha256, tmp_path / "copy")
    assert (tmp_path / "copy").read_bytes() == data
    assert [item.sha256 for item in store.list()] == [blob.sha256]
    store.delete(blob.sha256)
    store.delete(blob.sha256)
    assert store.size(blob.sha256) is None


@given(data=st.binary(max_size=300), start=st.integers(0, 310), end=st.one_of(st.none(), st.integers(0, 310)))
def test_a_range_is_a_slice(tmp_path_factory: pytest.TempPathFactory, data: bytes, start: int, end: int | None) -> None:
    store = FolderStore(tmp_path_factory.getbasetemp() / "slices")
    blob = store.put([data])
    assert b"".join(store.get(blob.sha256, start, end)) == data[start:end]


def test_s3_hands_out_the_bytes_itself(s3: S3, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = s3_store(s3, tmp_path.name, monkeypatch)
    data = os.urandom(1_000_000)
    blob = store.put([data])
    url = store.presigned_url(blob.sha256, 60, filename="solid.3mf", media_type="model/3mf")
    assert url is not None
    assert httpx.get(url).content == data
    part = httpx.get(url, headers={"Range": "bytes=1000-1999"})
    assert (part.status_code, part.content) == (206, data[1000:2000])
    other = url.replace(blob.sha256, "0" * 64)
    assert httpx.get(other).status_code == 403, "the signature is for one object alone"
    assert httpx.get(url.partition("?")[0]).status_code == 403


@pytest.mark.slow
def test_an_s3_server_that_is_away_is_said_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server = S3()
    try:
        server.start()
        store = s3_store(server, tmp_path.name, monkeypatch)
        blob = store.put([b"kept"])
        server.kill()
        with pytest.raises(StoreAway):
            store.put([b"lost"])
        with pytest.raises(StoreAway):
            store.size(blob.sha256)
        server.start()
        assert b"".join(store.get(blob.sha256)) == b"kept"
        assert store.put([b"lost"]).size == 4
    finally:
        server.close()


def test_missing_bytes_are_said_before_the_first_chunk(store: ArtifactStore) -> None:
    with pytest.raises(MissingBlob):
        store.get("f" * 64)
    with pytest.raises(MissingBlob):
        store.get("../../etc/passwd")


def test_a_broken_or_too_long_stream_leaves_nothing(tmp_path: Path) -> None:
    store = FolderStore(tmp_path)

    def broken() -> Iterator[bytes]:
        yield b"x" * 1000
        raise ConnectionError

    with pytest.raises(ConnectionError):
        store.put(broken())
    with pytest.raises(TooManyBytes):
        store.put([b"x" * 1000, b"y"], limit=1000)
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == []


def test_a_full_disk_is_said_and_leaves_nothing(tmp_path: Path) -> None:
    store = FolderStore(tmp_path)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    import signal

    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(StoreFull, match="no room"):
            store.put([b"x" * 50_000] * 4)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == []


def test_no_space_left_is_a_full_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = FolderStore(tmp_path)

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreFull):
        store.put([b"x"])
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == []


def test_changed_bytes_are_noticed(tmp_path: Path) -> None:
    store = FolderStore(tmp_path / "store")
    blob = store.put([b"right"])
    path = store.path(blob.sha256)
    assert path is not None
    path.write_bytes(b"wrong")
    with pytest.raises(MissingBlob):
        fetch(store, blob.sha256, tmp_path / "copy")


def test_garbage_goes_and_what_is_pointed_to_stays(
    records: Records, leases: Leases, design: DesignRecord, tmp_path: Path
) -> None:
    settings = records.settings
    store = open_store(settings)
    kept, lost, young = (store.put([word]) for word in (b"kept", b"lost", b"young"))
    lease = leases.claim("cpu", "w")
    assert lease is not None
    leases.commit(lease, StepRecord((FileRecord("skeletons.json", kept.sha256, kept.size),), {}, {}))
    long_ago = time.time() - 2 * settings.blob_grace_s
    for blob in (kept, lost):
        path = store.path(blob.sha256)
        assert path is not None
        os.utime(path, (long_ago, long_ago))
    assert collect(records, store).blobs == 1
    assert [store.size(blob.sha256) is not None for blob in (kept, lost, young)] == [True, False, True]
    records.delete(design.id)
    assert collect(records, store).blobs == 1
    assert store.size(kept.sha256) is None


def test_old_designs_go_where_a_retention_is_set(records: Records, leases: Leases, design: DesignRecord) -> None:
    records.cancel(design.id)
    store = open_store(records.settings)
    assert collect(records, store).designs == 0
    strict = Records(records.database, Settings(**{**records.settings.model_dump(), "retention_days": 1e-9}))
    assert collect(strict, store).designs == 1
    assert records.design(design.id) is None
