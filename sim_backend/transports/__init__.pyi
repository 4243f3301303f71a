from .emulator import Emulator as Emulator, Transport as Transport
