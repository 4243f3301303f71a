from .acoustics import Acoustics as Acoustics
