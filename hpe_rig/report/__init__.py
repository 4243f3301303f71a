"""HTML pages, and the page of a run: figures, residual tests, predictions and provenance.

    page_writer.py     writer of every HTML page: templates page.html, macros.html, sections.html, report.html
    views.py           one shot for pictures: echoes, displacement, fit
    residual_tests.py  tests of the residual of the fit
    sweep.py           curves over the varied quantity, means over repeats, straight lines
    figures.py         pictures of one shot and of a sweep
    depth_profile.py   pictures over depth, from gates of the same records
    moduli.py          moduli of the medium
    provenance.py      attributes, settings read back, fingerprint of the file
    badges.py          verdicts of the checks for the first screen
    page_tables.py     tables with formatted cells, also of the predicted errors
    page.py            run file -> page: `write_report`
    comparison.py      two runs side by side, with the significance of each difference

The live page uses the views; studies, designs and validation use the page writer.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
