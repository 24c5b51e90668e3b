"""ZIP archives are counted before anything unpacks them: by what their bytes become, not by what they say.

Python's :mod:`zipfile` unpacks an entry whole before it looks at the size that the directory states.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path
from typing import BinaryIO

from dualms.errors import TooLarge, UnreadableFile

_LOCAL = struct.Struct("<4s22xHH")  # signature, then lengths of name and extra field
_CHUNK = 1 << 18
MAX_ENTRIES = 10_000


def refuse_unless_small(path: Path, limit: int) -> None:
    """Refuse an archive whose files unpack to more than ``limit`` bytes together, or to more than they state.

    Raises
    ------
    TooLarge
        If it unpacks to more, or has more than ``MAX_ENTRIES`` entries.
    UnreadableFile
        If it is damaged, encrypted, packed by a method other than deflate, or states sizes that are not true.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
        if len(entries) > MAX_ENTRIES:
            raise TooLarge(
                f"The archive has {len(entries):,} entries; the limit is {MAX_ENTRIES:,}.",
                advice="Export the part alone.",
                measured={"entries": len(entries)},
            )
        stated = sum(entry.file_size for entry in entries)
        if stated > limit:
            raise _too_large(stated, limit)
        with path.open("rb") as file:
            for entry in entries:
                _count(file, entry)
    except (zipfile.BadZipFile, zlib.error, struct.error, NotImplementedError, ValueError, OSError) as error:
        raise UnreadableFile(f"The archive is damaged ({type(error).__name__}).", advice="Export it again.") from None


def _count(file: BinaryIO, entry: zipfile.ZipInfo) -> None:
    """Unpack one entry piece by piece, keeping none, until it is longer than it states."""
    if entry.flag_bits & 1 or entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise UnreadableFile("The archive is encrypted or packed in an unusual way.", advice="Export it again.")
    file.seek(entry.header_offset)
    signature, name, extra = _LOCAL.unpack(file.read(_LOCAL.size))
    if signature != b"PK\x03\x04":
        raise zipfile.BadZipFile
    file.seek(name + extra, 1)
    if entry.compress_type == zipfile.ZIP_STORED:
        size = entry.compress_size
    else:
        size = _unpacked(file, entry.compress_size, entry.file_size)
    if size > entry.file_size:
        raise UnreadableFile(
            f"A file in the archive is longer than the {entry.file_size:,} bytes that it states.",
            advice="Export it again.",
            measured={"stated_bytes": entry.file_size},
        )


def _unpacked(file: BinaryIO, packed: int, enough: int) -> int:
    """Length of a deflated file; counting ends once it exceeds ``enough``."""
    unpacker = zlib.decompressobj(-15)
    size = 0
    while packed > 0 and not unpacker.eof and size <= enough:
        piece = file.read(min(_CHUNK, packed))
        if not piece:
            raise zipfile.BadZipFile
        packed -= len(piece)
        while piece and size <= enough:
            size += len(unpacker.decompress(piece, _CHUNK))
            piece = unpacker.unconsumed_tail
    return size


def _too_large(size: int, limit: int) -> TooLarge:
    return TooLarge(
        f"The archive unpacks to {size / 1e6:,.0f} MB; the limit is {limit / 1e6:.0f} MB.",
        advice="Export it with a coarser tessellation.",
        measured={"unzipped_bytes": size},
    )
