"""Simulated generators: SCPI text -> registers -> voltage steps or sine bursts.

scpi_text        numbers, keywords, strings; reply formats
headers          a message -> commands; headers in every spelling
models           limits of the 33250A and its siblings
registers        all settings
levels, timing   settings that change other settings
kinds            settings as numbers, keywords, switches
commands         the settings by header
apply            APPLy
state_names      names of the memory locations
status           error queue and status registers
machine          the generator as its commands see it
command_tree     every header of every model
emission         history of registers, trigger edges -> output
instrument       one generator
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
