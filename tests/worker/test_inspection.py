"""Uploads are read in a jail: limits hold, and everything that goes wrong there is a clear refusal."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import pytest

from dualms.errors import DualMSError, TooLarge, UnreadableFile
from dualms.spec import Unit
from tests.worker.conftest import box_file
from worker.inspection import inspect_upload
from worker.settings import Settings


def test_a_box_is_described(tmp_path: Path) -> None:
    found = inspect_upload(box_file(tmp_path), "Box.STL", Unit.MM, Settings())
    assert found.volume == pytest.approx(16000.0)
    assert len(found.facets) == 6


def test_refusals_come_through_with_their_code(tmp_path: Path) -> None:
    path = tmp_path / "upload"
    path.write_bytes(b"solid nothing\nendsolid\n")
    with pytest.raises(DualMSError) as caught:
        inspect_upload(path, "x.stl", Unit.MM, Settings())
    assert caught.value.code in ("invalid-mesh", "unreadable-file")
    assert caught.value.message


def test_a_forged_face_count_does_not_take_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "upload"
    path.write_bytes(b"\0" * 80 + struct.pack("<I", 2_000_000_000) + b"\0" * 500)
    with pytest.raises(DualMSError):
        inspect_upload(path, "x.stl", Unit.MM, Settings())


def test_memory_and_time_are_limited(tmp_path: Path) -> None:
    path = box_file(tmp_path)
    with pytest.raises((TooLarge, UnreadableFile)):
        inspect_upload(path, "x.stl", Unit.MM, Settings(inspection_memory_bytes=100 << 20))
    with pytest.raises(TooLarge, match="longer than"):
        inspect_upload(path, "x.stl", Unit.MM, Settings(inspection_seconds=0.1))


def test_the_jail_has_no_network() -> None:
    code = """
import socket, sys
from worker.jail import _leave_the_network
_leave_the_network()
if [name for _, name in socket.if_nameindex()] != ["lo"]:
    sys.exit(77)
with socket.socket() as s:
    s.settimeout(1)
    sys.exit(0 if s.connect_ex(("127.0.0.1", 9)) == 101 else 1)  # ENETUNREACH, not refused
"""
    done = subprocess.run([sys.executable, "-c", code], check=False)
    if done.returncode == 77:
        pytest.skip("this kernel gives us no network namespace")
    assert done.returncode == 0
