from .connection import VisaConnection as VisaConnection
from .prologix import PrologixAdapter as PrologixAdapter
from .resources import NoVisaError as NoVisaError
