"""The four steps of a design, their stages, files and cache keys: what a queue must know, without the science."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Literal

from dualms import __version__
from dualms.spec import Spec

Step = Literal["prepare", "solve", "build", "evaluate"]
STEPS: tuple[Step, ...] = ("prepare", "solve", "build", "evaluate")

STAGES: dict[Step, tuple[str, ...]] = {
    "prepare": ("domain", "flow", "graph", "partition", "skeletons"),
    "solve": ("field",),
    "build": ("surface", "body", "report"),
    "evaluate": ("evaluation",),
}

MEDIA_TYPES = {
    ".stl": "model/stl",
    ".gz": "application/gzip",
    ".obj": "model/obj",
    ".vtu": "application/xml",
    ".3mf": "model/3mf",
    ".glb": "model/gltf-binary",
    ".json": "application/json",
    ".html": "text/html; charset=utf-8",
    ".png": "image/png",
    ".safetensors": "application/octet-stream",
    ".zip": "application/zip",
}

# Files that a step leaves in its folder: what clients may download, and what only later steps read.
ARTIFACTS: dict[Step, tuple[str, ...]] = {
    "prepare": ("skeletons.json",),
    "solve": ("field.safetensors",),
    "build": (
        "surface.stl",
        "solid.stl",
        "solid.3mf",
        "fluid_hot.stl",
        "fluid_cold.stl",
        "fluid_hot_patches.stl.gz",
        "fluid_cold_patches.stl.gz",
        "patches.json",
        "scene.glb",
        "preview.png",
        "maps.png",
        "sections.png",
        "report.json",
        "report.html",
    ),
    "evaluate": ("evaluation.json", "report.json", "report.html"),
}
OPTIONAL_ARTIFACTS: dict[Step, tuple[str, ...]] = {
    "prepare": ("flow.png",),
    "solve": (),
    "build": (
        "solid.obj",
        "fluid_hot.obj",
        "fluid_cold.obj",
        "surface.obj",
        "wall.vtu",
        "solid.vtu",
        "fluid_hot.vtu",
        "fluid_cold.vtu",
    ),
    "evaluate": ("evaluation.png", "case.zip", "logs.zip"),
}
INTERNAL: dict[Step, tuple[str, ...]] = {
    "prepare": ("prepared.safetensors", "timings-prepare.json"),
    "solve": ("timings-solve.json",),
    "build": (),
    "evaluate": (),
}
CHECKPOINT = "checkpoint"  # a step's own folder for what lets a second attempt go on; not an artifact


def steps_of(spec: Spec) -> tuple[Step, ...]:
    """The steps that a specification asks for, in order."""
    return STEPS if spec.evaluation is not None else STEPS[:-1]


def step_keys(domain_sha256: str, spec: Spec) -> dict[Step, str]:
    """Cache key of each step's result, hashed from its inputs, its parameters and the code's version.

    Parameters
    ----------
    domain_sha256
        Hash of the domain file's bytes.
    spec
        The resolved specification (no ``auto``).

    Returns
    -------
    dict
        Step to a hexadecimal SHA-256. A key contains the key of the step before it, so a changed wall thickness
        changes the keys of ``build`` and ``evaluate`` alone.
    """
    document = spec.model_dump(mode="json")
    ports = [fluid[role] for fluid in document["fluids"].values() for role in ("inlets", "outlets")]
    places = [[{k: v for k, v in port.items() if k != "header"} for port in listed] for listed in ports]
    headers = [[port["header"] for port in listed] for listed in ports]
    frame = [document["self_support"], document["build_direction"]] if spec.self_support else None
    guided = [document[k] for k in ("units", "flow", "graph", "partition")]
    parameters: dict[Step, object] = {
        "prepare": [places, guided, frame, spec.seed],
        "solve": [document["field"], spec.seed],
        "build": [
            headers,
            *(document[k] for k in ("surface", "wall", "shell", "build_direction", "pictures", "output", "require")),
        ],
        "evaluate": [document["evaluation"], document["fluids"]],
    }
    keys: dict[Step, str] = {}
    previous = domain_sha256
    for step in steps_of(spec):
        text = json.dumps([__version__, step, previous, parameters[step]], sort_keys=True)
        previous = keys[step] = hashlib.sha256(text.encode()).hexdigest()
    return keys


def sha256_of(path: Path) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
