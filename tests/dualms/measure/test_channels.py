"""Channels: closed forms of a plain duct, and a dead end that is found."""

from __future__ import annotations

import numpy as np
import pytest

from dualms.domain import Domain
from dualms.grid import Grid
from dualms.measure.channels import measure_channel
from tests.dualms.shapes import box_mesh, domain_of, shared_ends


@pytest.fixture(scope="module")
def box() -> tuple[Domain, Grid, np.ndarray]:
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(48)
    return domain, grid, domain.inside(grid)


def test_a_straight_duct_has_its_own_width_and_no_dead_end(box: tuple[Domain, Grid, np.ndarray]) -> None:
    domain, grid, inside = box
    _, y, z = grid.points().T.reshape(3, *grid.shape)
    room = inside & (y > 0.25) & (y < 0.5) & (z > 0.125) & (z < 0.375)
    channel = measure_channel(domain, room, grid, 1)
    assert channel.connected
    assert channel.dead_end_fraction == 0
    assert channel.passage == pytest.approx(0.25, abs=2 * grid.spacing)
    assert channel.min_width == pytest.approx(0.25, abs=2 * grid.spacing)


def test_a_side_pocket_counts_as_dead_end(box: tuple[Domain, Grid, np.ndarray]) -> None:
    domain, grid, inside = box
    x, y, z = grid.points().T.reshape(3, *grid.shape)
    duct = inside & (y < 0.25) & (z < 0.25)
    pocket = inside & (x > 0.4) & (x < 0.6) & (y >= 0.25) & (z < 0.25)
    channel = measure_channel(domain, duct | pocket, grid, 1)
    share = pocket.sum() / (duct | pocket).sum()
    # The stream bulges into the mouth of the pocket by about a quarter of its width.
    assert 0.4 * share < channel.dead_end_fraction < share


def test_a_neck_limits_the_passage(box: tuple[Domain, Grid, np.ndarray]) -> None:
    domain, grid, inside = box
    x, y, z = grid.points().T.reshape(3, *grid.shape)
    wide = inside & (y < 0.5)
    neck = wide & ((np.abs(x - 0.5) > 0.05) | ((np.abs(y - 0.25) < 0.06) & (np.abs(z - 0.25) < 0.06)))
    assert measure_channel(domain, wide, grid, 1).passage > 0.4
    assert measure_channel(domain, neck, grid, 1).passage == pytest.approx(0.12, abs=2 * grid.spacing)


def test_a_blocked_channel_is_not_connected(box: tuple[Domain, Grid, np.ndarray]) -> None:
    domain, grid, inside = box
    x = grid.points()[:, 0].reshape(grid.shape)
    channel = measure_channel(domain, inside & (np.abs(x - 0.5) > 0.05), grid, 1)
    assert not channel.connected
    assert channel.passage == 0
