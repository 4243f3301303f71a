"""Agilent 33250A function generators and their siblings over SCPI: task -> registers -> messages -> read-back.

models      limits and headers, one row a model
limits      check of a task against a model's limits
read_back   registers, and their comparison with replies
programs    the registers of a task, in groups and in order
scpi        one session: messages, replies, error queue
generator   the driver
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
