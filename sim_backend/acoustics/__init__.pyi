from .acoustics import Acoustics as Acoustics, transmitted_fraction as transmitted_fraction
