from .wire import VisaInterface as VisaInterface, VisaWire as VisaWire
