"""The least case that OpenFOAM's snappyHexMesh meshes a fluid of the box of 80 x 60 x 40 mm with, lengths in mm."""

from __future__ import annotations

from pathlib import Path

VOXEL_MM = 2.0
LOW, HIGH = (-3, -3, -3), (83, 63, 43)

_HEAD = "FoamFile {{ version 2.0; format ascii; class dictionary; object {name}; }}\n"
_FILES = {
    "controlDict": "startFrom startTime; startTime 0; stopAt endTime; endTime 1; deltaT 1; writeInterval 1;",
    "fvSchemes": "divSchemes {} gradSchemes {} laplacianSchemes {}",
    "fvSolution": "",
    "snappyHexMeshDict": """
castellatedMesh true; snap true; addLayers false;
geometry { %s { type triSurfaceMesh; name fluid; } }
castellatedMeshControls
{
    maxLocalCells 200000; maxGlobalCells 200000; minRefinementCells 0; nCellsBetweenLevels 1; resolveFeatureAngle 30;
    features (); refinementSurfaces { fluid { level (0 0); } } refinementRegions {}
    locationInMesh (%s); allowFreeStandingZoneFaces true;
}
snapControls { nSmoothPatch 3; tolerance 2; nSolveIter 20; nRelaxIter 5; }
addLayersControls
{
    relativeSizes true; layers {} expansionRatio 1; finalLayerThickness 0.3; minThickness 0.1; nGrow 0;
    featureAngle 60; nRelaxIter 3; nSmoothSurfaceNormals 1; nSmoothNormals 3; nSmoothThickness 10;
    maxFaceThicknessRatio 0.5; maxThicknessToMedialRatio 0.3; minMedianAxisAngle 90; nBufferCellsNoExtrude 0;
    nLayerIter 50;
}
meshQualityControls
{
    maxNonOrtho 65; maxBoundarySkewness 20; maxInternalSkewness 4; maxConcave 80; minVol 1e-13; minTetQuality 1e-15;
    minArea -1; minTwist 0.02; minDeterminant 0.001; minFaceWeight 0.05; minVolRatio 0.01; minTriangleTwist -1;
    nSmoothScale 4; errorReduction 0.75;
}
mergeTolerance 1e-6;
""",
}


def snappy_case(folder: Path, surface: str, inside: str) -> None:
    """Write the case for ``constant/triSurface/SURFACE``, with a point ``inside`` the fluid as ``"x y z"``."""
    (x, y, z), (a, b, c) = LOW, HIGH
    corners = (
        f"({x} {y} {z})({a} {y} {z})({a} {b} {z})({x} {b} {z})({x} {y} {c})({a} {y} {c})({a} {b} {c})({x} {b} {c})"
    )
    cells = " ".join(str(round((high - low) / VOXEL_MM)) for low, high in zip(LOW, HIGH, strict=True))
    block = f"vertices ({corners}); blocks (hex (0 1 2 3 4 5 6 7) ({cells}) simpleGrading (1 1 1)); boundary ();"
    (folder / "system").mkdir(parents=True)
    for name, text in (_FILES | {"blockMeshDict": block}).items():
        text = text % (surface, inside) if name == "snappyHexMeshDict" else text
        (folder / "system" / name).write_text(_HEAD.format(name=name) + text + "\n")
