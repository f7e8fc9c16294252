"""Writes two_boxes.*: the same small mesh in every form of VTK's and TetGen's files.

Needs meshio and vtk; what it wrote is committed beside it.
"""

from itertools import permutations
from pathlib import Path

import meshio
import numpy as np
import vtk

HERE = Path(__file__).parent

# Two cubes side by side, six tets each, labelled 3 and 5, with two triangles that readers skip.
points = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)]) / 8.0
points += 1 / 3  # no short decimals
number = {(x, y, z): x + 3 * y + 6 * z for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)}
tets, labels = [], []
for box in (0, 1):
    for axes in permutations(range(3)):
        place = [box, 0, 0]
        tet = [number[tuple(place)]]
        for axis in axes:
            place[axis] += 1
            tet.append(number[tuple(place)])
        a, b, c, d = points[tet]
        if np.dot(np.cross(b - a, c - a), d - a) < 0:
            tet[2], tet[3] = tet[3], tet[2]
        tets.append(tet)
        labels.append((3, 5)[box])
triangles = np.array([[0, 1, 3], [1, 4, 3]])
mesh = meshio.Mesh(
    points,
    [("triangle", triangles), ("tetra", np.array(tets))],
    point_data={"heat": np.linspace(0, 1, 12), "flow": points - 0.5},
    cell_data={"domain": [np.array([9, 9]), np.array(labels)], "noise": [np.zeros(2), np.ones(12)]},
)
meshio.vtk.write(HERE / "two_boxes_v42_ascii.vtk", mesh, fmt_version="4.2", binary=False)
meshio.vtk.write(HERE / "two_boxes_v42_binary.vtk", mesh, fmt_version="4.2", binary=True)
meshio.vtk.write(HERE / "two_boxes_v51_ascii.vtk", mesh, fmt_version="5.1", binary=False)
meshio.vtk.write(HERE / "two_boxes_v51_binary.vtk", mesh, fmt_version="5.1", binary=True)
meshio.vtu.write(HERE / "two_boxes_ascii.vtu", mesh, binary=False)
meshio.vtu.write(HERE / "two_boxes_inline.vtu", mesh, compression=None)
meshio.vtu.write(HERE / "two_boxes_inline_zlib.vtu", mesh, compression="zlib")
only_tets = meshio.Mesh(points, [("tetra", np.array(tets))], cell_data={"tetgen:ref": [np.array(labels)]})
only_tets.write(HERE / "two_boxes.node")

grid = vtk.vtkUnstructuredGrid()
shape = vtk.vtkPoints()
shape.SetDataTypeToDouble()
for point in points:
    shape.InsertNextPoint(point)
grid.SetPoints(shape)
domain = vtk.vtkIntArray()
domain.SetName("domain")
for triangle in triangles:
    grid.InsertNextCell(vtk.VTK_TRIANGLE, 3, triangle.tolist())
    domain.InsertNextValue(9)
for tet, label in zip(tets, labels):
    grid.InsertNextCell(vtk.VTK_TETRA, 4, tet)
    domain.InsertNextValue(label)
grid.GetCellData().AddArray(domain)
for name, set_up in {
    "appended_raw": lambda w: (w.SetDataModeToAppended(), w.EncodeAppendedDataOff(), w.SetCompressorTypeToNone()),
    "appended_raw_zlib": lambda w: (w.SetDataModeToAppended(), w.EncodeAppendedDataOff(), w.SetBlockSize(64)),
    "appended_base64_zlib": lambda w: (w.SetDataModeToAppended(), w.SetHeaderTypeToUInt32(), w.SetBlockSize(64)),
    "appended_base64": lambda w: (w.SetDataModeToAppended(), w.SetCompressorTypeToNone()),
    "inline_big_endian": lambda w: (w.SetDataModeToBinary(), w.SetByteOrderToBigEndian()),
}.items():
    writer = vtk.vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(HERE / f"two_boxes_{name}.vtu"))
    writer.SetInputData(grid)
    set_up(writer)
    writer.Write()
for name, write_text, version in [("ascii", True, 42), ("binary", False, 51)]:
    writer = vtk.vtkUnstructuredGridWriter()
    writer.SetFileName(str(HERE / f"two_boxes_vtk_{name}.vtk"))
    writer.SetInputData(grid)
    writer.SetFileTypeToASCII() if write_text else writer.SetFileTypeToBinary()
    writer.SetFileVersion(version)
    writer.Write()
