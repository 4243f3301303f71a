"""Drivers of the bench's instruments, usable on their own in a script.

    interfaces   tasks, records and the abstract instruments; the only part that knows no vendor
    visa         text connections
    agilent      function generators
    alazar       digitizers

Each driver stands on what really talks to metal, a connection or the vendor's library; a twin can provide either.
A driver in a ``with`` statement identifies its instrument first and leaves it safe, proven by read-back:

>>> from drivers.agilent import Agilent33250A
>>> from drivers.visa import VisaConnection
>>> with Agilent33250A(VisaConnection("GPIB0::10::INSTR")) as generator:
...     generator.sine(frequency_hz=1e6, amplitude_vpp=0.5)
...     settings = generator.verify()
>>> settings["output_on"], settings["frequency_hz"], settings["amplitude_vpp"]
(True, 1000000.0, 0.5)

Bursts and pulse trains are ``Agilent33250A.configure`` with a task of ``drivers.interfaces``.
"""
