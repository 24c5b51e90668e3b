"""The team's set-up file is valid and says what the administrator needs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    return yaml.safe_load((ROOT / "docker-compose.yml").read_text())


def test_compose_file_follows_the_compose_specification(compose: dict[str, Any]) -> None:
    schema = json.loads((Path(__file__).parent / "data" / "compose_spec.json").read_text())
    # This edition predates the specification's own top-level `name` (added in 2021); everything else is checked.
    document = {key: value for key, value in compose.items() if key != "name"}
    jsonschema.Draft7Validator(schema).validate(document)


def test_compose_schema_would_refuse_a_misspelt_key(compose: dict[str, Any]) -> None:
    schema = json.loads((Path(__file__).parent / "data" / "compose_spec.json").read_text())
    broken = {"services": {"api": {**compose["services"]["api"], "healtcheck": {}}}}
    assert list(jsonschema.Draft7Validator(schema).iter_errors(broken))


def test_compose_has_the_team_s_services_with_limits_and_restart(compose: dict[str, Any]) -> None:
    services = compose["services"]
    assert set(services) == {"api", "worker-cpu", "worker-gpu", "worker-cfd", "valkey", "postgres"}
    for name, service in services.items():
        assert service["deploy"]["resources"]["limits"]["memory"], name
        assert service["restart"] == "unless-stopped", name
        assert service["healthcheck"]["test"], name
    assert services["worker-gpu"]["profiles"] == ["gpu"]
    assert services["worker-gpu"]["deploy"]["resources"]["reservations"]["devices"][0]["capabilities"] == ["gpu"]
    assert services["worker-cfd"]["profiles"] == ["cfd"]


def test_compose_publishes_the_api_on_loopback_only(compose: dict[str, Any]) -> None:
    published = [port for service in compose["services"].values() for port in service.get("ports", [])]
    assert published
    assert all(port.startswith("127.0.0.1:") for port in published)


def test_every_compose_command_is_one_of_ours_and_every_volume_is_declared(compose: dict[str, Any]) -> None:
    from service.cli import app

    names = {c.name or c.callback.__name__ for c in app.registered_commands if c.callback}
    for name, service in compose["services"].items():
        if service["image"].startswith("dualms"):
            assert service["command"][0] in names, name
        for volume in service["volumes"]:
            assert volume.split(":")[0] in compose["volumes"], name
