from .connection import NoVisaError as NoVisaError, VisaConnection as VisaConnection, VisaInterface as VisaInterface
