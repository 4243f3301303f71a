"""Motion map as a NetCDF file, which is an HDF5 file with named axes; ``verify`` knows its checksums."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import h5py

from hpe_rig.store.atomic import write_file
from hpe_rig.store.checksum import sealed_file
from hpe_rig.store.format import MAP_FORMAT
from hpe_rig.store.layout import name_axes

if TYPE_CHECKING:
    import xarray


def write_map(path: Path, motion_map: xarray.Dataset) -> None:
    """Write the dataset of a motion map with axes, attributes and checksums; raise ``StoreError`` if impossible."""

    def write(file: h5py.File) -> None:
        """Write the content of the map."""
        file.attrs.update({"format": MAP_FORMAT, **motion_map.attrs})
        for quantity in motion_map.data_vars:
            file[str(quantity)] = motion_map[quantity].values
        name_axes(file, {str(axis): motion_map[axis].values for axis in motion_map.dims}, {})
        for name, variable in motion_map.variables.items():
            file[str(name)].attrs.update(variable.attrs)

    write_file(path, sealed_file(write))
