"""Generators as programs see them: SCPI text -> registers -> voltage steps or sine bursts.

In the order of the flow:
    scpi_text    messages into commands, numbers, reply formats
    commands     what every header sets and answers
    models       what tells the 33250A and its siblings apart
    registers    everything that can be set
    levels, timing   how settings bend one another
    status       error queue and status registers
    instrument   one generator: messages in, replies out, registers with their history
    emission     from that history and trigger edges to what is put out

Others use ``Generator33250A``, the ``MODELS`` by name, and what its trigger input is like.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
