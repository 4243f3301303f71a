from .chain import TRAIL as TRAIL, fast_length as fast_length, lead_s as lead_s, receive as receive
from .elements import switch_gain as switch_gain
from .front_end import (
    echo_gain_v as echo_gain_v,
    leak_per_vpp_v as leak_per_vpp_v,
    leak_v as leak_v,
    noise_v as noise_v,
    pulse_strength as pulse_strength,
    toneburst_echo_strength as toneburst_echo_strength,
)
from .record_noise import NoiseSource as NoiseSource, RecordNoise as RecordNoise
from .streams import RecordStream as RecordStream
from .timing import (
    STENCIL as STENCIL,
    has_clock_error as has_clock_error,
    jittered as jittered,
    sampled_with_clock_error as sampled_with_clock_error,
)
