from .connection import VisaConnection as VisaConnection, VisaInterface as VisaInterface
