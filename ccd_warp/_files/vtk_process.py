"""Reads VTK files in processes of their own: damaged ones can end the process of VTK's readers.

It is run by its path, imports NumPy and VTK alone, and takes and gives pickles; each file is read by a child.
"""

import os
import pickle
import resource
import sys
from typing import Any

import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow, vtkVersion
from vtkmodules.vtkIOLegacy import vtkPolyDataReader, vtkUnstructuredGridReader
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

_XML: dict[str, Any] = {"UnstructuredGrid": vtkXMLUnstructuredGridReader, "PolyData": vtkXMLPolyDataReader}
_LEGACY: dict[str, Any] = {"UNSTRUCTURED_GRID": vtkUnstructuredGridReader, "POLYDATA": vtkPolyDataReader}
_DUPLICATE = 1  # the bit of a cell that belongs to another piece


def _read(kind: str, data: bytes, field: str | None) -> tuple[Any, ...] | str | None:
    """The content of a file, or the first error of VTK; None where its readers do not notice that a text is cut."""
    if (vtkVersion.GetVTKMajorVersion(), vtkVersion.GetVTKMinorVersion()) < (9, 7):
        return None
    errors: list[str] = []

    def note(window: Any, event: str, message: str) -> None:
        errors.append(message)

    note.CallDataType = "string0"  # type: ignore[attr-defined]
    window: Any = vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(window)
    window.AddObserver("ErrorEvent", note)
    reader: Any = (_XML | _LEGACY)[kind]()  # of which not all stubs say what it takes
    reader.ReadFromInputStringOn()
    if kind in _XML:
        reader.SetInputString(data)
    else:
        reader.SetBinaryInputString(data, len(data))
    reader.Update()
    grid = reader.GetOutput()
    if errors or reader.GetErrorCode() or grid.GetPoints() is None:
        return errors[0] if errors else "there are no points"
    if kind in ("PolyData", "POLYDATA"):  # VTK's types of several points, of a polyline, a polygon and a strip
        groups = {2: grid.GetVerts(), 4: grid.GetLines(), 7: grid.GetPolys(), 6: grid.GetStrips()}
        types = np.repeat(list(groups), [group.GetNumberOfCells() for group in groups.values()])
    else:
        groups = {0: grid.GetCells()}
        types = vtk_to_numpy(grid.GetCellTypesArray()) if grid.GetNumberOfCells() else np.zeros(0, dtype=np.int64)
    sizes = [np.diff(vtk_to_numpy(group.GetOffsetsArray())) for group in groups.values()]
    corners = [vtk_to_numpy(group.GetConnectivityArray()) for group in groups.values()]
    ghosts, fields = grid.GetCellData().GetArray("vtkGhostType"), grid.GetPointData()
    values = None if field is None else fields.GetArray(field)
    return (
        vtk_to_numpy(grid.GetPoints().GetData()),
        types.astype(np.int64),
        np.concatenate(sizes).astype(np.int64),
        np.concatenate(corners).astype(np.int64),
        None if values is None else vtk_to_numpy(values),
        [fields.GetArrayName(k) for k in range(fields.GetNumberOfArrays())],
        np.zeros(len(types), dtype=bool) if ghosts is None else (vtk_to_numpy(ghosts) & _DUPLICATE) != 0,
    )


def _serve() -> None:
    """Answer requests until there are no more; what native code prints goes the way of the errors."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    while True:
        try:
            request = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        if not (child := os.fork()):  # the one that a file may end
            pickle.dump(_read(*request), answers, protocol=5)
            answers.flush()
            os._exit(0)
        if os.waitpid(child, 0)[1]:
            pickle.dump("its reader ends the process", answers)
            answers.flush()


if __name__ == "__main__":
    _serve()
