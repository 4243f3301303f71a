"""Motion map as a NetCDF file, which is an HDF5 file with named axes; ``verify`` knows its checksums."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import h5py

from hpe_rig.store.atomic import write_file
from hpe_rig.store.checksum import seal, seal_heap
from hpe_rig.store.format import MAP_FORMAT
from hpe_rig.store.layout import LIBVER, name_axes

if TYPE_CHECKING:
    import xarray


def write_map(path: Path, motion_map: xarray.Dataset) -> None:
    """Write the dataset of a motion map with axes, attributes and checksums; raise ``StoreError`` if impossible."""
    # Written to memory first: a disk error inside the HDF5 library can crash the program.
    memory = io.BytesIO()
    with h5py.File(memory, "w", libver=LIBVER) as file:
        file.attrs.update({"format": MAP_FORMAT, **motion_map.attrs})
        for quantity in motion_map.data_vars:
            file[str(quantity)] = motion_map[quantity].values
        name_axes(file, {str(axis): motion_map[axis].values for axis in motion_map.dims}, {})
        for name, variable in motion_map.variables.items():
            file[str(name)].attrs.update(variable.attrs)
        seal(file)
        seal_heap(file, memory)
    write_file(path, memory.getvalue())
