"""Result of a measurement: amplitude and phase with covariance, units, provenance and run time.

    estimates.py   Estimate (one frequency) -> ShotResult -> Result
    repeats.py     mean over repeats, tested against the stated uncertainties
    phase.py       uncertainty of a phase, also of an amplitude that may be noise
    interval.py    half width of the 95 % interval, from u and degrees of freedom
    sentence.py    the result in one sentence
    rows.py        one row a shot and frequency: CSV, pandas, printed
    motion.py      displacement of a shot, pulse by pulse, with u and model
    grid.py        arrays over (shot, frequency) and (shot, pulse): result file, xarray
    json_schema.py what --json prints, as a JSON schema
    figure.py      amplitude and phase over frequency; the colours of every figure
    spectra.py     the same as the report's two pictures, beside ground truth and repeats
    svg.py         panels as SVG text, which every page draws
    print_symbols.py  units and symbols of print in plain texts
    html_repr.py   figure and tables, as a notebook shows a result
    tables.py      any rows as CSV and as text
    motion_map.py  amplitude, phase and velocity of every line and depth
    page.css       the style of every page
    provenance.py  who measured when, on which machine, and how long each stage took

All rooms but ``scene`` may use it; it uses ``scene`` alone.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
