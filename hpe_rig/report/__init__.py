"""Report of a run: one HTML page with figures, tests of the residual, predictions and provenance.

page.py             run file -> page: ``write_report``
views.py            one shot as people look at it: echoes, displacement, fit; the live page's too
badges.py           verdicts of the checks, for the first screen
residual_tests.py   whether the fit leaves nothing but noise
foreseen.py         what the error model predicts for the amplitudes found
sweep.py            many shots as curves, means over repeats, straight lines
comparison.py       two runs side by side, with the significance of each difference
provenance.py       attributes, settings read back, fingerprint of the file
depth_profile.py    pictures over depth, of gates in the same records
moduli.py           the medium's moduli, of a run at several places
figures.py          pictures of one shot and of many; spectra are the result's, timing the plan's
report.html         the page's template

Others use ``write_report``; the live page takes the views.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
