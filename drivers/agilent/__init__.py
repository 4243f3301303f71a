"""Agilent 33250A function generators and their siblings over SCPI: task -> registers -> messages -> read-back.

In the order of the flow:
    models      what each model can do, and how it spells its headers
    limits      what a model cannot do of a task
    programs    the registers of a task, in groups and in order
    read_back   a register as programmed against the reply
    scpi        one session: messages, replies, error queue
    generator   the driver

Others use ``Agilent33250A`` to drive, ``model_named`` and ``mistakes`` to ask what a model can do.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
