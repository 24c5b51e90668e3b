"""A disk that fills up: nothing half written stays, nothing recorded is lost, what waits goes on once there is room."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.exc import OperationalError

from tests.worker.conftest import Cluster, small_spec, wait_for
from worker.artifacts import StoreFull
from worker.folder_store import FolderStore
from worker.records import Records
from worker.rows import NewDesign
from worker.settings import Settings

SIZE = 24 << 20


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 24 MiB; skips where this user may not mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder)]
    try:
        done = subprocess.run(mount, capture_output=True, check=False)
    except FileNotFoundError:
        pytest.skip("there is no mount command")
    if done.returncode:
        pytest.skip("this user may not mount file systems")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(folder: Path, leave: int = 0) -> Path:
    """A file that leaves so many bytes of the disk free."""
    path = folder / "filler"
    with path.open("wb", buffering=0) as file, suppress(OSError):
        while shutil.disk_usage(folder).free > leave:
            file.write(bytes(4096))
    return path


def fails_after(write: Callable[[], object]) -> int:
    """How often a write succeeds before it is refused: what the last pages hold still fits."""
    for count in range(1000):
        try:
            write()
        except OperationalError:
            return count
    raise AssertionError("it was never refused")


def test_a_store_on_a_full_disk_says_so_and_keeps_what_it_has(small_disk: Path) -> None:
    store = FolderStore(small_disk / "store")
    kept = store.put([b"kept"])
    filler = fill(small_disk)
    files = sorted(p for p in store.folder.rglob("*") if p.is_file())
    with pytest.raises(StoreFull):
        store.put([bytes(1 << 20)])
    assert sorted(p for p in store.folder.rglob("*") if p.is_file()) == files
    assert b"".join(store.get(kept.sha256)) == b"kept"
    filler.unlink()
    assert store.put([bytes(1 << 20)]).size == 1 << 20


def test_records_on_a_full_disk_refuse_and_lose_nothing(small_disk: Path) -> None:
    settings = Settings(data_dir=small_disk / "data", database_url="", redis_url="")
    records = Records.open(settings)
    records.add_domain(id="0", sha256="0", size=1, name="x", suffix=".stl", units="mm", inspection={})
    filler = fill(small_disk)
    made = fails_after(lambda: records.create_design(NewDesign("0", small_spec())))
    assert records.counts() == ({"queued": made} if made else {})
    filler.unlink()
    records.create_design(NewDesign("0", small_spec()))
    assert records.counts() == {"queued": made + 1}
    with records.database.read() as session:
        assert session.execute(text("PRAGMA integrity_check")).scalar_one() == "ok"
    records.close()


@pytest.mark.slow
def test_a_design_waits_for_room_and_then_succeeds(small_disk: Path, tmp_path: Path) -> None:
    store = (small_disk / "store").as_uri()
    cluster = Cluster(tmp_path, DUALMS_STORE_URL=store, DUALMS_FREE_BYTES=str(8 << 20), DUALMS_REAP_S="1")
    try:
        filler = fill(small_disk, leave=2 << 20)
        cluster.start_worker()
        made = cluster.submit()
        wait_for(lambda: "steps wait" in (tmp_path / "worker.log").read_text())
        time.sleep(2)
        assert cluster.design(made.id).status == "queued"
        filler.unlink()
        final = wait_for(lambda: (d := cluster.design(made.id)).final and d)
        assert final.status == "succeeded", final.error
    finally:
        cluster.close()
