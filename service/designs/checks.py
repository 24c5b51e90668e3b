"""What a domain's record tells about a specification at once, so that a hopeless design is refused at submission.

Only what is certain is refused here; everything else is left to the first step, which has the mesh.
"""

from __future__ import annotations

import math

from dualms.errors import InvalidSpec, PortNotOnBoundary, WallTooThick
from dualms.spec import BoxPort, DiskPort, FacetPort, PortSpec, Spec, Unit, Vector, WallThickness

Bounds = tuple[Vector, Vector]


def check_against_domain(spec: Spec, units: Unit, bounds: Bounds, facets: int) -> None:
    """Refuse what cannot fit.

    Parameters
    ----------
    spec
        As the client sent it.
    units
        Unit of the domain's record.
    bounds
        Corners of the domain, in those units.
    facets
        Number of planar facets.

    Raises
    ------
    InvalidSpec
        If the units contradict the domain's.
    PortNotOnBoundary
        If a port lies outside the domain's box, or names a facet that is not there.
    WallTooThick
        If the wall, or twice the shell, exceeds the domain's smallest side.
    """
    if spec.units is not None and spec.units != units:
        raise InvalidSpec(
            f"The domain was uploaded in {units.value}, the specification says {spec.units.value}.",
            advice="Upload the domain again with the right units, or leave units out of the specification.",
            measured={"domain": units.value, "spec": spec.units.value},
        )
    for fluid in ("hot", "cold"):
        for role in ("inlets", "outlets"):
            for i, port in enumerate(getattr(getattr(spec.fluids, fluid), role)):
                _check_port(f"spec.fluids.{fluid}.{role}.{i}", port, units, bounds, facets)
    _check_thickness(spec, units, bounds)


def _check_port(where: str, port: PortSpec, units: Unit, bounds: Bounds, facets: int) -> None:
    low, high = bounds
    advice = "POST /v1/domains and dualms inspect list the domain's bounds and facets."
    if isinstance(port, FacetPort):
        if port.facet >= facets:
            raise PortNotOnBoundary(
                f"{where} names facet {port.facet}; the domain has {facets} planar facets.",
                advice=advice,
                measured={"facet": port.facet, "facets": facets},
            )
        return
    away = _distance(port, low, high)
    reach = port.radius if isinstance(port, DiskPort) else 0.0
    if away > reach + 1e-9 * math.dist(low, high):
        raise PortNotOnBoundary(
            f"{where} lies {away:.4g} {units.value} outside the domain's box {list(low)} … {list(high)}.",
            advice=advice,
            measured={"distance": away, "bounds": [list(low), list(high)]},
        )


def _distance(port: DiskPort | BoxPort, low: Vector, high: Vector) -> float:
    """Between the domain's box and a disk's centre or a port's box."""
    first, last = (port.center, port.center) if isinstance(port, DiskPort) else port.box
    gaps = [max(lo - b, a - hi, 0.0) for a, b, lo, hi in zip(first, last, low, high, strict=True)]
    return math.hypot(*gaps)


def _check_thickness(spec: Spec, units: Unit, bounds: Bounds) -> None:
    smallest = min(high - low for low, high in zip(*bounds, strict=True))
    wall = spec.wall.thickness if isinstance(spec.wall, WallThickness) else 0.0
    for what, thickness in (("wall", wall), ("shell, on both sides,", 2 * spec.shell.thickness if spec.shell else 0.0)):
        if thickness >= smallest:
            raise WallTooThick(
                f"The {what} takes {thickness:g} {units.value}; the domain's smallest side is {smallest:.4g}.",
                advice="Give a thinner one, and check the units.",
                measured={"thickness": thickness, "smallest_side": smallest},
            )
