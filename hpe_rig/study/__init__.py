"""Studies: Monte Carlo runs of the twin's physics that give bias and jitter, each with its standard error.

In the order of the flow: `definition` (what the TOML says) -> `cases` (checked scenes with their random numbers;
`measured_case` of those that are measured whole) -> `run` (what is not finished, by `executor`) -> `engine` (draws and
noise of a gate, on `kernels`, to `statistics`) or `measured` (whole measurements of any scene) -> `results` (on disk)
-> `series` -> `curve_figures`, `map_figures` -> `page`, `report`. Others run studies (`run_study`), read their curves
and maps, and write pages of their own.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
