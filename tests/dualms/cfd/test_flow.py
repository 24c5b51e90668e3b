import numpy as np
import pytest

from dualms.cfd.case import FlowControl
from dualms.cfd.flow import FlowSolution, solve_flow, state_of
from dualms.cfd.mesh import ChannelMesh, channel_mesh
from dualms.cfd.openfoam import OpenFoam
from dualms.errors import EvaluationFailed
from dualms.progress import Cancelled
from tests.dualms.cfd.conftest import SIDE_M, slow_fluid, two_ducts

SQUARE = (
    28.454  # -dp/dx · a² / (μ U) of a square duct (Shah and London 1978: f·Re = 56.908 with the hydraulic diameter)
)
PLATES = 12.0  # the same of parallel plates, with their gap
SECTIONS = (1.5, 2.5)  # of the length in sides: past the entry, before the outlet


def slope(mesh: ChannelMesh, flow: FlowSolution, spacing: float) -> float:
    """-dp/dx between two sections."""
    x = (mesh.cells[:, 0] - mesh.cells[:, 0].min() + 0.5) * spacing / SIDE_M
    between = (x > SECTIONS[0]) & (x < SECTIONS[1])
    return -float(np.polyfit(x[between] * SIDE_M, flow.pressure_pa[between], 1)[0])


@pytest.mark.cfd
@pytest.mark.parametrize(("side_walls", "exact"), [(True, SQUARE), (False, PLATES)], ids=["square", "plates"])
def test_pressure_gradient_converges_to_the_closed_form_at_second_order(foam, tmp_path, side_walls, exact) -> None:
    errors = []
    for n in (4, 8, 16):
        width = n if side_walls else 2
        exchanger = two_ducts(n, width, 3 * n, side_walls)
        mesh = channel_mesh(exchanger, 1)
        fluid = slow_fluid(1.0, 50.0, SIDE_M * width * exchanger.spacing_m)
        control = FlowControl(steady=1e-6, drift=1e-7, envelope="noSlip" if side_walls else "slip")
        flow = solve_flow(foam, mesh, fluid, tmp_path / f"n{n}", control)
        assert flow.state == "steady"
        assert flow.flux_m3_s[mesh.patch("inlet")].sum() == pytest.approx(
            -flow.flux_m3_s[mesh.patch("outlet")].sum(), rel=1e-4
        )
        scale = fluid.viscosity_pa_s * 0.01 / SIDE_M**2
        errors.append(slope(mesh, flow, exchanger.spacing_m) / scale / exact - 1)
    assert abs(errors[-1]) < 0.02
    rates = np.log2(np.abs(np.array(errors[:-1]) / errors[1:]))
    assert (rates > 1.7).all(), (errors, rates)


@pytest.mark.cfd
def test_a_cancelled_flow_stops_its_solver(foam, tmp_path) -> None:
    exchanger = two_ducts(6, 6, 18, True)
    fluid = slow_fluid(1.0, 50.0, SIDE_M**2)

    def report(fraction: float, note: str) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        solve_flow(foam, channel_mesh(exchanger, 1), fluid, tmp_path / "case", FlowControl(), report)
    assert (tmp_path / "case" / "log.simpleFoam").read_text()


@pytest.mark.cfd
def test_a_diverging_flow_is_solved_by_the_robust_scheme_and_says_so(foam, tmp_path) -> None:
    exchanger = two_ducts(6, 6, 18, True)
    fluid = slow_fluid(200.0, 50.0, SIDE_M**2)
    control = FlowControl(pressure_relaxation=2.5)
    flow = solve_flow(foam, channel_mesh(exchanger, 1), fluid, tmp_path / "case", control)
    assert flow.scheme == "upwind"
    assert "diverged" in flow.notes[0]
    assert flow.pressure_drop_pa > 0


def test_a_solver_that_does_not_run_is_a_stated_failure(tmp_path) -> None:
    program = tmp_path / "simpleFoam"
    program.write_text("#!/bin/sh\nexit 3\n")
    program.chmod(0o755)
    exchanger = two_ducts(4, 4, 8, True)
    fluid = slow_fluid(1.0, 50.0, SIDE_M**2)
    with pytest.raises(EvaluationFailed, match="code 3") as caught:
        solve_flow(
            OpenFoam("none", tmp_path, tmp_path), channel_mesh(exchanger, 1), fluid, tmp_path / "case", FlowControl()
        )
    assert caught.value.advice


def test_states_of_pressure_histories() -> None:
    control = FlowControl(window=20, drift=0.01, steady=1e-4)
    k = np.arange(200)
    assert state_of(np.full(19, 5.0), control) is None
    assert state_of(np.full(20, 5.0), control) == "steady"
    assert state_of(100 + 5 * np.sin(k * np.pi / 5)[:60], control) == "wandering"
    assert state_of(100 + 2.0 * k, control) is None
