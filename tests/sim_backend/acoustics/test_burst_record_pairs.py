"""Which bursts meet which records: against the plain double loop."""

import numpy as np
from hypothesis import given, strategies as st

from sim_backend.acoustics.acoustics import burst_record_pairs, sample_span
from sim_backend.wiring import Capture


@given(
    st.lists(st.integers(0, 400), max_size=6),
    st.lists(st.tuples(st.integers(-50, 450), st.integers(0, 120)), max_size=6),
    st.integers(1, 12),
    st.integers(1, 9),
)
def test_pairs_and_samples_are_those_of_the_plain_loop(firsts, intervals, samples, period_ps):
    capture = Capture(0, 0, np.array(sorted(firsts), dtype=np.int64), period_ps, samples)
    start_ps = np.array([start for start, _ in intervals], dtype=np.int64)
    end_ps = np.array([start + length for start, length in intervals], dtype=np.int64)
    burst, record = burst_record_pairs(start_ps, end_ps, capture)
    plain = {
        (b, r)
        for b in range(len(start_ps))
        for r, first in enumerate(capture.first_sample_ps)
        if start_ps[b] <= first + (samples - 1) * period_ps and end_ps[b] >= first
    }
    assert set(zip(burst.tolist(), record.tolist(), strict=True)) == plain
    assert len(burst) == len(plain)
    for b, r in plain:
        first = int(capture.first_sample_ps[r])
        span = sample_span(int(start_ps[b]) - first, int(end_ps[b]) - first, capture)
        inside = [i for i in range(samples) if start_ps[b] <= first + i * period_ps <= end_ps[b]]
        assert list(range(samples))[span] == inside
