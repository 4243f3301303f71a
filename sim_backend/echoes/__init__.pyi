from .aperture import BeamResponse as BeamResponse, beam_response as beam_response
from .choice import Method as Method, method_times_s as method_times_s
from .delays import EchoDelays as EchoDelays, distinct_echoes as distinct_echoes
from .engine import synthesise as synthesise
from .exact_sums import direct_sum as direct_sum, running_sum as running_sum
from .many_draws import DRAWS_AT_ONCE as DRAWS_AT_ONCE, batch as batch, drawn_echoes as drawn_echoes
from .pulse import (
    Pulse as Pulse,
    attenuated_to_focus as attenuated_to_focus,
    echo_pulse as echo_pulse,
    hann_pulse as hann_pulse,
    rectangular_burst as rectangular_burst,
    waveform as waveform,
)
from .scatterers import (
    ScattererField as ScattererField,
    depth_delay_s as depth_delay_s,
    draw_field as draw_field,
    draw_thinned as draw_thinned,
    field_at as field_at,
    gaussian_weight as gaussian_weight,
    noticeable as noticeable,
)
from .series import ScattererRows as ScattererRows
