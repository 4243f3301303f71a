"""Bench: who carries a plan out, on metal or on the twin; opened for what a scene needs and always left safe.

In the order of the flow:
    bench_file    instruments, cables, limits and calibration of one bench, as its TOML file says
    twin          what a scene declares of its simulation, as one typed value
    opening       drivers on VISA and the vendor's library, or on the twin
    instruments   the open instruments, and how they are made safe
    interrupts    Ctrl-C, SIGTERM and closed terminals while outputs may be on
    lock          one program at a time on a real bench
    inventory     every instrument identified, its settings read
    comparison    how two benches differ
    emulation     the simulated generators for any VISA program

Others read a bench file, open a bench, and ask what was found on it; drivers and twin are chosen here alone.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
