"""Bench: the instruments that carry a plan out, real or simulated; opened for a scene and always left safe.

In the order of the flow:
    bench_file      sections of a bench file: instruments, cables, limits, calibration
    bench_loading   bench files from a path or text, their wiring and values checked
    twin            the simulation that a scene declares, as one typed value
    clocks          how far the clocks of motion, pulses and digitizer may differ
    push_scan       hydrophone scan of the push
    twin_checks     mistakes in [simulation], and settings that differ from the scene's
    interrupts      Ctrl-C, SIGTERM and closed terminals while outputs may be on
    resource_name   one name for each instrument, whatever spelling its address has
    conditions      readings of commands and plug-ins, such as the temperature of the water
    lock            one program at a time on a real bench
    output_limits   limits of the outputs that drive a transducer, on settings as read back
    instruments     the open instruments, made safe independently of each other
    identity        serial numbers and labels, compared with those of the bench file
    lines           lines to all instruments, used at the same time
    opening         drivers connected to VISA and the vendor's library, or to the twin
    inventory       every instrument identified, its settings read; roles on displays, serial numbers written
    comparison      differences between two benches
    emulation       the simulated generators for any VISA program

Other packages read a bench file, open a bench, and use its instruments; only this one connects drivers.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
