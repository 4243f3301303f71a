from .acoustics import Acoustics as Acoustics
from .reception import with_reception as with_reception
