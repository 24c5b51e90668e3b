"""Whether there is room on the disks for another step: without it steps wait, rather than fail one after another."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path

from worker.artifacts import ArtifactStore
from worker.folder_store import FolderStore
from worker.settings import Settings


def short_of_room(settings: Settings, store: ArtifactStore) -> Path | None:
    """A folder whose disk has less than ``free_bytes`` left: the data folder, or the store where it is a folder."""
    folders: Iterable[Path] = (settings.folder, *([store.folder] if isinstance(store, FolderStore) else []))
    return next((folder for folder in folders if shutil.disk_usage(folder).free < settings.free_bytes), None)
