"""Moduli of the medium: its shear field fitted to vibrations at several lateral offsets, depths and frequencies.

    vibration_model.py   data: vibrations with the uncertainties of their positions, and the push
    scene_geometry.py    push, gates and position uncertainties that a scene states
    run_vibrations.py    vibrations of stored runs
    map_vibrations.py    vibrations at the lines of a motion map
    problem.py           least-squares problem: y_pn = g_p S_n exp(-j w_n tau) U(w_n, r_p, z_p; G, A_p, B)
    inversion.py         the fit: minima, covariance, evidence of each material law, contributions of the data
    wavenumber_fit.py    phase velocity and attenuation: of a fitted law, and fitted frequency by frequency
    outcome.py           results of all laws as text and JSON
    figure.py            figure of measured and fitted vibrations
    wave_methods.py      phase gradient, 2-D FT, GST-SFK, LPVI and amplitude decay, for comparison
    dispersion.py        dispersion of runs: near-field fit beside these methods, with their predicted bias
    dispersion_figure.py figure of dispersion
    forecast.py          expected uncertainties of a scene, by the Cramer-Rao bound

Callers use ``moduli_of`` and ``dispersion_of`` for stored runs, ``moduli_of_map`` for maps, ``moduli_forecast`` for
scenes, ``fit_medium``, ``dispersion_of_vibrations`` and ``bound`` for vibrations. Derivation:
docs/explanation/moduli.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
