"""Archives are counted by what they unpack to, with little memory, and whatever they state."""

from __future__ import annotations

import tracemalloc
import zipfile
from pathlib import Path

import pytest

from dualms.archives import refuse_unless_small
from dualms.errors import DualMSError, TooLarge, UnreadableFile
from tests.hostile import ARCHIVES

MIB = 1 << 20


def packed(path: Path, sizes: list[int], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for i, size in enumerate(sizes):
            archive.writestr(f"{i}", bytes(size))
    return path


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED])
def test_an_archive_passes_up_to_the_limit(tmp_path: Path, method: int) -> None:
    path = packed(tmp_path / "a.zip", [MIB, MIB, 0], method)
    refuse_unless_small(path, 2 * MIB)
    with pytest.raises(TooLarge, match="unpacks to"):
        refuse_unless_small(path, 2 * MIB - 1)


def test_a_forged_size_is_found_without_unpacking_it_all(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    ARCHIVES["archive with a forged size"][1](path)
    tracemalloc.start()
    try:
        with pytest.raises(UnreadableFile, match="longer than the 10 bytes"):
            refuse_unless_small(path, 100 * MIB)
        assert tracemalloc.get_traced_memory()[1] < 8 * MIB, "a gibibyte is packed in it"
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_unusual_methods_are_refused(tmp_path: Path, method: int) -> None:
    with pytest.raises(UnreadableFile, match="unusual"):
        refuse_unless_small(packed(tmp_path / "a.zip", [100], method), MIB)


@pytest.mark.parametrize("size", [0, 10, 22, 60, 100])
def test_a_damaged_archive_is_refused(tmp_path: Path, size: int) -> None:
    path = packed(tmp_path / "a.zip", [1000])
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(DualMSError):
        refuse_unless_small(path, MIB)


def test_too_many_entries_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TooLarge, match="entries"):
        refuse_unless_small(packed(tmp_path / "a.zip", [0] * 10_001), MIB)
