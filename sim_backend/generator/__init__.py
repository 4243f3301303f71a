"""Generators as programs see them: SCPI text -> registers -> voltage steps or sine bursts.

In the order of the flow:
    scpi_text    numbers, keywords, strings; reply formats
    headers      a message into commands, headers in every spelling
    models       what tells the 33250A and its siblings apart
    registers    everything that can be set
    levels, timing   how settings bend one another
    kinds        settings as numbers, keywords, switches
    inactive     settings of modulation, sweep and arbitrary waveforms, which the twin never puts out
    commands     what every setting's header sets and answers
    apply        APPLy
    arbitrary, stored_states   what survives a reset
    command_tree   every header of every model
    status       error queue and status registers
    instrument   one generator: messages in, replies out, registers with their history
    emission     from that history and trigger edges to what is put out

Others use ``Generator33250A``, the ``MODELS`` by name, the commands of each, ``tree_of``, and what its trigger input
is like.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
