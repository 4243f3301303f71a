from .acoustics import Acoustics as Acoustics, transmitted_share as transmitted_share
from .reception import with_reception as with_reception
