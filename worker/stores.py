"""Which artifact store the settings name."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote, urlparse

from worker.artifacts import ArtifactStore
from worker.folder_store import FolderStore
from worker.settings import Settings


def open_store(settings: Settings) -> ArtifactStore:
    """The store that the settings name."""
    url = settings.store
    if url.startswith("file:"):
        return FolderStore(Path(unquote(urlparse(url).path)))
    if "://" not in url:
        return FolderStore(Path(url).expanduser().resolve())
    from worker.object_store import ObjectStore  # obstore is loaded only where it is used

    return ObjectStore(url)
