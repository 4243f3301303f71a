from .acoustics import Acoustics as Acoustics, transmitted_fraction as transmitted_fraction
from .reception import with_reception as with_reception
