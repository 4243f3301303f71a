from .choice import Method as Method, choices as choices
from .cumulative_sum import running_sum as running_sum
from .delays import Motion as Motion
from .direct_sum import direct as direct
from .engine import echoes as echoes, synthesise as synthesise
from .many_draws import DRAWS_AT_ONCE as DRAWS_AT_ONCE, batch as batch, drawn_echoes as drawn_echoes
from .pulse import (
    Pulse as Pulse,
    hann_pulse as hann_pulse,
    rectangular_burst as rectangular_burst,
    waveform as waveform,
)
from .scatterers import (
    depth_delay_s as depth_delay_s,
    draw_field as draw_field,
    field_at as field_at,
    noticeable as noticeable,
)
from .series import Resting as Resting
from .series_fast import available as available
from .thinned_draws import draw_thinned as draw_thinned
from .tracking_pulse import behind_the_way as behind_the_way, echo_pulse as echo_pulse
