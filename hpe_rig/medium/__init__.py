"""Physics of the specimen, stated once: material laws, push force, shear field, beam averaging and ensemble of media.

    material_laws.py    complex shear modulus G(s) of each law
    push_force.py       force f(r, z) of a Gaussian beam or of an aperture
    focal_field.py      displacement U at the focus of a Gaussian force, in closed form
    shear_field.py      displacement u(r, z) of any force, with derivatives
    gate_echoes.py      echo energy by depth in a range gate
    beam_averaging.py   tracked over peak displacement
    ensemble.py         displacement spectra of many media: the statistics behind the medium prior

Processing, prediction and moduli use these. The twin has its own physics, so that a mistake here shows as a wrong
measurement there.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
