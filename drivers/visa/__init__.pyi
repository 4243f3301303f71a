from .bounded import within as within
from .connection import VisaConnection as VisaConnection
from .failures import OpenError as OpenError
from .prologix import PrologixAdapter as PrologixAdapter
from .resources import NoVisaError as NoVisaError
from .rs232 import Handshake as Handshake, SerialSettings as SerialSettings, Termination as Termination
