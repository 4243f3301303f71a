"""The HDF5 run file: written while the run goes on, readable at every moment, distrusted when read.

Layout, format version 2 (``store_layout``)::

    /                      attributes: format, format_version, title, scene_name, bench_name, simulated, status, seed,
                           predecessor, predecessor_shots, version_*
    /scene, /bench         TOML text; /snapshot (shot,) JSON of the settings read back
    /records               echo (shot, pulse, sample) int16 with scale_factor and add_offset to volts; recorded
                           (shot, pulse) 1 where a record is there, written after it; trigger_time_s and pulse_onset_s
                           (shot, pulse); shot_complete and clipped (shot,); burst_length_s, force_fraction, repeat
                           (shot,); scales shot, pulse, sample
    /run_time              run_time_s (stage,) of the acquisition, NaN where nobody asked for it; scale stage: names
    /truth                 displacement_m (shot, pulse), simulated runs only
    /true_harmonics        A cos(phase) and A sin(phase) of the true motion (shot, frequency), simulated runs only

Promises: ``status`` is running, complete, aborted or failed. Everything stands at its final size before the first
record (``store_writer``), so that a file whose writer was killed opens, in HDF5's single-writer-multiple-reader mode,
and holds every record whose mark stands. Within a format version things are added, never renamed or redefined; a reader
refuses a newer version with a message and keeps on reading every version from 2 on (``store_reader``).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
