import numpy as np
import pytest

from dualms.cfd.channels import STEPS, Openings, VoxelExchanger, boundary_faces
from dualms.cfd.film import GROWTH, LEVEQUE, half_width, layer_thickness
from dualms.cfd.mesh import ChannelMesh, channel_mesh
from dualms.cfd.shear import wall_shear
from dualms.cfd.wall import wall_sheet
from dualms.triangles import TriangleMesh

OBLIQUE = [(1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.6, 0.3)]


def tube(radius: float, length: float, direction: np.ndarray) -> tuple[VoxelExchanger, ChannelMesh, np.ndarray]:
    """A round tube through unit voxels in any direction, its mesh, and Poiseuille's velocity of mean one."""
    low = np.minimum(0, length * direction) - radius - 4
    shape = tuple(np.ceil(np.maximum(0, length * direction) + radius + 4 - low).astype(int))
    points = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1) + low
    along = points @ direction
    off_axis = np.linalg.norm(points - along[..., None] * direction, axis=-1)
    labels = np.where(off_axis < radius, 1, 2).astype(np.int8)
    labels[(along < 0) | (along > length)] = 0
    labels[[0, -1]] = labels[:, [0, -1]] = labels[:, :, [0, -1]] = 0
    ends = boundary_faces(labels, 1, (0,))
    at, facing = (ends[:, :3] + low) @ direction, STEPS[ends[:, 3]] @ direction
    inlet, outlet = ends[(at < length / 2) & (facing < -0.35)], ends[(at > length / 2) & (facing > 0.35)]
    openings = Openings(inlet, outlet, np.tile(-direction, (len(inlet), 1)))
    exchanger = VoxelExchanger(
        labels, (radius - off_axis).astype(np.float32), 1.0, low, 0.0, openings, openings, 0.0, 0.0
    )
    mesh = channel_mesh(exchanger, 1)
    speed = 2 * (1 - (off_axis[tuple(mesh.cells.T)] / radius) ** 2)
    return exchanger, mesh, speed[:, None] * direction


@pytest.mark.parametrize("radius", [3.0, 6.0])
@pytest.mark.parametrize("direction", OBLIQUE)
def test_stair_steps_show_neither_in_area_shear_nor_width(direction, radius) -> None:
    axis = np.array(direction) / np.linalg.norm(direction)
    length = 10 * radius
    exchanger, mesh, velocity = tube(radius, length, axis)
    wall = wall_sheet(exchanger, mesh, 1)
    assert wall.area_m2.sum() == pytest.approx(2 * np.pi * radius * length, rel=0.03)
    along = wall.mesh.vertices[np.unique(wall.mesh.faces)] @ axis
    middle = np.unique(wall.mesh.faces)[(along > 0.2 * length) & (along < 0.8 * length)]
    shear = wall_shear(exchanger, mesh, velocity, wall.mesh)[middle]
    assert np.allclose(shear @ axis, 4 / radius, rtol=0.02)
    across = shear - (shear @ axis)[:, None] * axis
    assert np.sqrt((across**2).sum(axis=1).mean()) < 0.03 * 4 / radius
    widths = half_width(exchanger, mesh, wall)
    assert abs(np.median(widths) - radius) < 1


@pytest.mark.parametrize("direction", OBLIQUE)
def test_layer_in_a_tube_grows_as_leveque_says(direction) -> None:
    axis = np.array(direction) / np.linalg.norm(direction)
    radius, length, diffusivity = 4.0, 48.0, 1e-4
    exchanger, mesh, velocity = tube(radius, length, axis)
    wall = wall_sheet(exchanger, mesh, 1)
    shear = wall_shear(exchanger, mesh, velocity, wall.mesh)
    x = wall.mesh.centroids @ axis
    inwards = np.where(x[:, None] < length / 2, axis, -axis)
    layer = layer_thickness(wall.mesh, shear, diffusivity, inwards, -x, np.full(len(x), 3.0))
    inside = (x > 0.1 * length) & (x < 0.9 * length)
    exact = (diffusivity * x[inside] * radius / 4) ** (1 / 3) / LEVEQUE
    assert np.average(layer[inside] / exact, weights=wall.mesh.areas[inside]) == pytest.approx(1, rel=0.03)


def test_layer_at_a_stagnation_line_has_the_thickness_of_the_closed_form() -> None:
    # Shear a x away from a line x = 0 at which the flow meets the wall: δ³ = C α / a everywhere (Lighthill's integral).
    count, a, diffusivity = 40, 3.0, 1e-5
    i, j = np.meshgrid(np.arange(count), np.arange(5), indexing="ij")
    vertices = np.stack([i / (count - 1) - 0.5, j / (count - 1), 0 * i], axis=-1).reshape(-1, 3)
    corner = (5 * i + j)[:-1, :-1].ravel()
    faces = np.concatenate([corner[:, None] + [0, 5, 6], corner[:, None] + [0, 6, 1]])
    wall = TriangleMesh(vertices, faces)
    shear = np.zeros_like(vertices)
    shear[:, 0] = a * vertices[:, 0]
    layer = layer_thickness(
        wall, shear, diffusivity, np.zeros((len(faces), 3)), np.zeros(len(faces)), np.full(len(faces), 1.0)
    )
    # Sides: flow along the border edges neither leaves nor enters.
    assert np.allclose(layer, (GROWTH * diffusivity / a) ** (1 / 3), rtol=1e-3)


def test_growth_is_the_coefficient_of_lighthills_integral() -> None:
    # One streamline of shear γ: δ³ = 1.5 C α x / γ must be Lévêque's (x α / γ) / 0.5384³.
    assert abs(1.5 * GROWTH * 0.5384**3 - 1) < 1e-3


def test_where_nothing_flows_the_limit_holds() -> None:
    wall = TriangleMesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]]))
    layer = layer_thickness(wall, np.zeros((3, 3)), 1e-7, np.zeros((1, 3)), np.zeros(1), np.array([0.3]))
    assert layer == pytest.approx([0.3])
