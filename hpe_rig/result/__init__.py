"""Result of a measurement: amplitude and phase with uncertainty budget, units, provenance and run time.

    interval.py       95 % interval from uncertainties and degrees of freedom
    influence.py      errors of a shot by source, and the shots with the same error
    phase.py          uncertainty of a phase, and of an amplitude that may be noise
    motion.py         displacement of a shot, pulse by pulse
    motion_map.py     amplitude, phase and velocity of every line and depth
    provenance.py     who measured when and where, and the time of each stage
    values.py         estimate of a frequency, and the results of a shot and of a gate
    conditions.py     range of each condition over a run
    repeats.py        mean over repeats, tested against the stated uncertainties
    result_data.py    contents of a result, and their plain form for JSON
    covariance.py     complex values of all shots with their covariance
    grid.py           arrays over (shot, frequency) and (shot, pulse): result file, xarray
    tables.py         rows as CSV and as text
    uncertain_numbers.py  complex values as uncertain numbers of GTC
    rows.py           one row for each shot and frequency: CSV, pandas, print
    sentence.py       the result in one sentence
    print_symbols.py  typographic units and symbols
    svg.py            palette, panels and pictures of every page, with page.css
    setting_text.py   settings as texts: titles, legends, columns
    panels.py         panels of a figure for papers, new or the caller's
    figure_kind.py    kinds of figures
    figure.py         figures for papers and notebooks, for matplotlib
    spectra.py        amplitude and phase over frequency, for pages
    html_repr.py      display in a notebook
    result.py         `Result`: contents with all tables and figures
    json_schema.py    JSON schema of the output of ``--json``

It depends on ``scene`` alone. Every higher layer may use it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
