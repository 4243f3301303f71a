from .front_end import (
    echo_gain_v as echo_gain_v,
    leak_per_vpp_v as leak_per_vpp_v,
    leak_v as leak_v,
    noise_v as noise_v,
    pulse_strength as pulse_strength,
    toneburst_echo_strength as toneburst_echo_strength,
)
from .reception import Physics as Physics, with_reception as with_reception
from .streams import RecordStream as RecordStream
